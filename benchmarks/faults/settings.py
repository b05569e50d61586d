"""Systems for faults to happen to: context managers that start one and end it."""

import os
import random
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from ament_index_python.packages import get_package_prefix
from gate_support import Watch
from rclpy.action import ActionClient
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.msg import SwarmPoses
from system_rig import SCENARIOS, System
from three_robots import SCENARIO as THREE_ROBOTS

from faults.failing_calls import Calls
from faults.film import Film
from faults.links import Link, LossyLink
from faults.shifted_clock import Clocks
from faults.stage import Stage, Start
from stressbot_driver.bench import load_bench
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.camera_file import write_camera
from stressbot_planner.ros.qos import NEWEST

Setting = Callable[[Path, random.Random], AbstractContextManager[Stage]]

PEER_TIMEOUT = 0.08
"""s, the driver's default."""

GATE_TIMEOUT = 0.06
"""s, the driver's default."""

EXCHANGE_TIMEOUT = 2.0
"""s, the waveform generator's default."""

PATIENT = 2.0
"""s, instead of it: where a busy machine's false alarms would hide what a fault does."""

POSE_TIMEOUT = 0.5
"""s; 25 poses of the emulator: they are handed on by this process, which a busy machine may hold up for longer than 0.2 s."""

FILM_TIMEOUT = 3.0
"""s, where poses come from pictures: a search of a whole picture holds them up, the longer the busier the machine."""

SIDE, RATE, MARGIN = 500, 15.0, 4e-4
"""Of pictures: pixels, Hz, and m around what the scenario names."""

UNREAD = """
import os, sys
unread, full = os.pipe()
os.set_inheritable(unread, True)
os.set_blocking(full, False)
try:
    while True:
        os.write(full, bytes(65536))
except BlockingIOError:
    os.set_blocking(full, True)
for number in (1, 2):
    os.dup2(full, number)
os.execv(sys.argv[1], sys.argv[1:])
"""

GAIN = 20.0
SIX = SCENARIOS / "paper-six.yaml"


@contextmanager
def simulated(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """Three nodes and the simulated substrate, which writes down what it sees."""
    watch = Watch(folder)
    with _environment(watch.environment), closing(System(folder, nodes=())) as system:
        stage = Stage(system, rng, {"driver": _driver(backend="watched"), "sequencer": Start(), "planner": Start()})
        stage.watch, stage.folder = watch, folder
        yield stage


@contextmanager
def moving(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """The mover, and three imperfect robots in fast motion."""
    with closing(System(folder, nodes=())) as system:
        yield _with_mover(system, rng, _three_robots(folder))


@contextmanager
def moving_with_shifted_clocks(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """As `moving`, each node with a clock that can be set."""
    clocks = Clocks(folder, ("driver", "sequencer", "mover"))
    with closing(System(folder, nodes=())) as system:
        stage = _with_mover(system, rng, _three_robots(folder), clocks.prefix)
        stage.clocks = clocks
        yield stage


@contextmanager
def shifted_clocks(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """As `simulated`, each node with a clock that can be set."""
    clocks, watch = Clocks(folder, ("driver", "sequencer", "planner")), Watch(folder)
    with _environment(watch.environment), closing(System(folder, nodes=())) as system:
        starts = {"driver": _driver(backend="watched", prefix=clocks.prefix("driver"))}
        starts |= {name: Start(prefix=clocks.prefix(name)) for name in ("sequencer", "planner")}
        stage = Stage(system, rng, starts)
        stage.clocks, stage.watch = clocks, watch
        yield stage


@contextmanager
def blocked(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """As `simulated`, and nobody reads what the driver writes: its standard output and error are a pipe that is full."""
    watch = Watch(folder)
    with _environment(watch.environment), closing(System(folder, nodes=())) as system:
        prefix = (sys.executable, "-c", UNREAD)
        stage = Stage(system, rng, {"driver": _driver(backend="watched", prefix=prefix), "sequencer": Start()})
        stage.watch = watch
        yield stage


@contextmanager
def failing_calls(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """Driver and sequencer; calls of the driver's gate can be made to fail."""
    calls = Calls(folder)
    with closing(System(folder, nodes=())) as system:
        stage = Stage(system, rng, {"driver": _driver(prefix=calls.prefix), "sequencer": Start()})
        stage.calls = calls
        yield stage


@contextmanager
def instrument(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """Sequencer, driver and an emulated generator."""
    with closing(System(folder, nodes=())) as system:
        port = start_emulator(system, folder)
        stage = Stage(system, rng, {"driver": _generator(folder, port), "sequencer": Start()})
        stage.folder, stage.port = folder, port
        yield stage


@contextmanager
def tracked(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """As `instrument`, and a mover; poses come from a tracker that falls silent when told so, and the driver watches it."""
    with closing(System(folder, nodes=())) as system:
        node, silent = system.client.node, []
        tracker = node.create_publisher(SwarmPoses, "swarm_poses", 10)
        node.create_subscription(SwarmPoses, "seen_poses", lambda message: silent or tracker.publish(message), NEWEST)
        port = start_emulator(system, folder, remaps=("swarm_poses:=seen_poses",))
        driver = _generator(folder, port, PATIENT, pose_timeout=POSE_TIMEOUT)
        stage = _with_mover(system, rng, driver)
        stage.silence = silent
        yield stage


@contextmanager
def filmed(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """Driver and sequencer; poses come from pictures of a simulated microscope, which this process hands on as it is told to."""
    with closing(System(folder, nodes=())) as system:
        place, bench = folder / "camera.yaml", load_bench(SIX)
        camera = Camera.over(np.vstack([bench.start[:, :2], bench.goal]), MARGIN, SIDE)
        write_camera(place, replace(camera, rotation=0.5 * np.pi))  # robots start one above the other: now from left to right
        starts = {"driver": _driver(peer_timeout=PATIENT, tracked=True, pose_timeout=FILM_TIMEOUT), "sequencer": Start()}
        starts["simulated_camera"] = Start({"camera": place, "rate": RATE}, remaps=("image_raw:=seen_raw",))
        starts["camera_tracker"] = Start({"camera": place})
        stage = Stage(system, rng, starts)
        stage.film = Film(stage)
        stage.film.wait_for_all()
        yield stage


@contextmanager
def two_hosts(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """Driver here, sequencer and planner on another host."""
    with closing(Link()) as link, _on_the_network(), closing(System(folder, nodes=())) as system:
        yield _apart(system, rng, link, _driver())


@contextmanager
def lossy_hosts(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """As `two_hosts`, with a link that can be spoilt."""
    with closing(LossyLink()) as link, _on_the_network(), closing(System(folder, nodes=())) as system:
        yield _apart(system, rng, link, _driver(peer_timeout=PATIENT, real_time_factor=20.0))


def _three_robots(folder: Path) -> Start:
    scenario = folder / "three.yaml"
    scenario.write_text(THREE_ROBOTS)
    flaws = {"imperfections.heading_bias": 0.087, "imperfections.heading_noise": 0.035}
    return _driver(scenario, PATIENT, real_time_factor=20.0, pose_rate=400.0, **flaws)


def _with_mover(
    system: System, rng: random.Random, driver: Start, prefix: Callable[[str], tuple[str, ...]] = lambda _: ()
) -> Stage:
    starts = {"driver": driver, "sequencer": Start(), "mover": Start()}
    stage = Stage(system, rng, {name: replace(start, prefix=prefix(name)) for name, start in starts.items()})
    stage.actions = ActionClient(stage.node, MoveSwarm, "move_swarm")
    return stage


def _apart(system: System, rng: random.Random, link: Link, driver: Start) -> Stage:
    there = Start(prefix=link.prefix)
    stage = Stage(system, rng, {"driver": driver, "sequencer": there, "planner": there})
    stage.link = link
    return stage


def _on_the_network() -> AbstractContextManager[None]:
    """UDP between addresses, no shared memory."""
    return _environment({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"})


@contextmanager
def _environment(changes: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in changes}
    os.environ |= changes
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)


def _driver(scenario: Path = SIX, peer_timeout: float | None = None, prefix: tuple[str, ...] = (), **parameters) -> Start:
    timeout = PEER_TIMEOUT if peer_timeout is None else peer_timeout
    return Start({"scenario": scenario, "peer_timeout": timeout, "gate_timeout": GATE_TIMEOUT, **parameters}, prefix)


def _generator(folder: Path, port: str, peer_timeout: float | None = None, **parameters) -> Start:
    options = {
        "visa_resource": f"TCPIP0::127.0.0.1::{port}::SOCKET",
        "amplifier_gain": GAIN,
        "amplifier_max_voltage": 200.0,
        "record_folder": folder,
        "timeout": EXCHANGE_TIMEOUT,
    }
    named = {f"waveform_generator.{name}": value for name, value in options.items()}
    return _driver(peer_timeout=peer_timeout, backend="waveform_generator", **named, **parameters)


def start_emulator(system: System, folder: Path, port: str = "0", remaps: tuple[str, ...] = ()) -> str:
    """Start an emulated instrument; return its port."""
    executable = Path(get_package_prefix("stressbot_driver"), "lib/stressbot_driver/instrument_emulator")
    parameters = {"scenario": SIX, "port": port, "amplifier_gain": GAIN}
    arguments = [item for name, value in parameters.items() for item in ("-p", f"{name}:={value}")]
    arguments += [item for remap in (f"__ns:={system.namespace}", *remaps) for item in ("-r", remap)]
    said = len(system.log("instrument_emulator")) if port != "0" else 0
    system.processes.start("instrument_emulator", [str(executable), "--ros-args", *arguments])
    return system.wait_for(
        lambda: re.search(r"listens on TCPIP0::127\.0\.0\.1::(\d+)::", system.log("instrument_emulator")[said:]), "the emulator"
    ).group(1)
