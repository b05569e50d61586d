"""`ros2 run stressbot_planner calibrate`: measures the robots of whatever driver is up, and writes a scenario file."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rclpy.utilities import remove_ros_args
from stressbot_msgs.wording import sentence

from stressbot_planner.errors import StressbotError
from stressbot_planner.estimation.calibration import CONFIDENCE, Estimate, Interval, Record, look_alikes
from stressbot_planner.estimation.identification import Motion, identify
from stressbot_planner.formats import scenario, swarm_file
from stressbot_planner.model.swarm import check_positive
from stressbot_planner.problem.definition import Problem
from stressbot_planner.ros.client import SwarmClient
from stressbot_planner.ros.conversion import Scene
from stressbot_planner.ros.driving import driving
from stressbot_planner.ros.remote_bench import RemoteBench
from stressbot_planner.system import files, streams


def calibrate(client: SwarmClient, output: Path, precision: float, frequencies: Sequence[float] = ()) -> int:
    """Measure the robots, write the file, say what was found; return the exit code.

    Args:
        client: the topics and services.
        output: the scenario file that is written.
        precision: half of the intervals of speeds and radii, relative, that is good enough.
        frequencies: Hz, at which steps are measured after that.

    Raises:
        StressbotError, TimeoutError: with the reason.
    """
    bench = RemoteBench(client, "calibrate")
    scene = bench.scene
    print(f"{sentence(scene.name)}: {scene.swarm.n} robots in {scene.swarm.m} groups; driving", flush=True)
    for frequency in frequencies:
        scene.pulsed_at(frequency)  # refused before anything moves
    bench.measure()
    driven = 0.0

    def drive(motion: Motion) -> list[Record]:
        nonlocal driven
        records = bench.drive(motion)
        driven += client.driver.duration
        print(f"  {driven:.0f} s: groups {', '.join(map(str, motion[0]))}", flush=True)
        return records

    estimates, _ = identify(scene.swarm, scene.environment, bench.measure, drive, precision)
    places = bench.measure()[:, :2]
    described = scenario.Scenario(
        scene.name,
        scene.unit,
        Problem(
            scene.swarm, scene.environment, scene.starts, scene.goals, exchangeable=scene.exchangeable,
            goal_headings=scene.goal_headings, parked=scene.parked, waypoints=scene.waypoints,
            contacts=scene.contacts,
        ),
        scene.electrical,
    )
    swarm_file.write(output, swarm_file.calibrated(described, estimates, places, CONFIDENCE))
    print(*table(estimates, _step(scene)), f"{output}: calibrated in {driven:.0f} s on the substrate", sep="\n", flush=True)
    steps: dict[float, list[Interval | None]] = {}
    for frequency in frequencies:
        print(f"driving with {frequency:g} Hz", flush=True)
        bench.pulse_at(frequency)
        swept, _ = identify(bench.scene.swarm, scene.environment, bench.measure, drive, precision)
        nanometres = _step(bench.scene)
        steps[frequency] = [found.speed.scaled(nanometres) if found.speed and nanometres else None for found in swept]
    if steps:
        print(*step_table(steps), sep="\n")
    for one, two in look_alikes(estimates):
        streams.complain("calibrate", f"robots {one} and {two} answer to the same groups and turn alike: take one away")
    try:
        scenario.load(output)
    except StressbotError as error:
        streams.complain("calibrate", f"{output} must be changed before it is used: {error}")
        return streams.FAILED
    return streams.FAILED if look_alikes(estimates) else streams.SOLVED


def _step(scene: Scene) -> float | None:
    """Return the nm that a robot of 1 unit/s slides with a pulse; None: the drive is constant."""
    step = scene.electrical.pulse_length(scene.unit)
    return None if step is None else 1e9 * step


def step_table(steps: Mapping[float, Sequence[Interval | None]]) -> list[str]:
    """Return lines for people: of each robot the step, nm, with its 95 % interval, by the frequency of the pulses, Hz."""
    lines = ["step (nm) by the frequency of the pulses:"]
    lines.append("robot  " + "  ".join(f"{f'{frequency:g} Hz':>18}" for frequency in steps))
    for robot, found in enumerate(zip(*steps.values(), strict=True), 1):
        lines.append(f"{robot:>5}  " + "  ".join(f"{str(step or 'unknown'):>18}" for step in found))
    return lines


def table(estimates: Sequence[Estimate], step: float | None = None) -> list[str]:
    """Return lines for people, units of the scenario and degrees, 95 % intervals; step: nm for each unit/s, of pulses."""
    steps = [] if step is None else [f"{'step (nm)':>18}"]
    names = [f"{'speed':>18}", *steps, f"{'turning radius':>18}", f"{'heading bias (deg)':>18}", f"{'missed':>9}"]
    lines = [f"{'robot':>5}  " + "  ".join(names) + "  fault"]
    for found in estimates:
        bias = found.heading_bias
        cells = [
            str(found.speed or "unknown"),
            *([] if step is None else [str(found.speed.scaled(step) if found.speed else "unknown")]),
            str(found.turning_radius or "unknown"),
            f"{np.degrees(bias.value):.2f} ± {np.degrees(bias.half_width):.2f}" if bias else "unknown",
        ]
        missed = f"{found.missed}/{found.trials.sum()}"
        fault = str(found.fault) + (f": {found.codeword}" if found.fault and found.trials.any() else "")
        lines.append(f"{found.robot:>5}  " + "  ".join(f"{cell:>18}" for cell in cells) + f"  {missed:>9}  {fault}".rstrip())
    return lines


def main() -> None:
    """Entry point of `ros2 run stressbot_planner calibrate`."""
    parser = argparse.ArgumentParser(
        prog="calibrate",
        description="Measure speed, turning radius, heading bias and group faults of the robots of the driver that is up: "
        "drives them through a short sequence, on and off their places, and writes a scenario file. Driver and sequencer must "
        "be running.",
    )
    parser.add_argument("--output", type=Path, default=Path("swarm.yaml"), metavar="FILE", help="default: %(default)s")
    parser.add_argument(
        "--precision", type=float, default=0.005, metavar="P",
        help="half of the 95 %% interval of speeds and radii, relative, that is good enough (default: %(default)s)",
    )
    parser.add_argument(
        "--frequencies", type=float, nargs="+", default=(), metavar="HZ",
        help="of pulses: after that, measure the step of each robot at each of them, too",
    )
    sys.exit(streams.run("calibrate", lambda: _run(parser.parse_args(remove_ros_args(sys.argv)[1:]))))


def _run(args: argparse.Namespace) -> int:
    check_positive("--precision", args.precision)
    for frequency in args.frequencies:
        check_positive("--frequencies", frequency)
    files.check_output(args.output)
    return driving("calibrate", lambda client: calibrate(client, args.output, args.precision, args.frequencies))
