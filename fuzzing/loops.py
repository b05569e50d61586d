"""Closed loops: what the mover does with any assumption, any robots, goals, tolerances and paces of the substrate.

In this process, decision for decision, and over DDS, whole motions at running nodes. A run may end in any documented way, but never
with INTERNAL, and the substrate is at rest afterwards.
"""

import os
import random
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import yaml
from closed_loop import solver
from hypothesis import strategies as st
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from simulated_bench import SimulatedBench
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.domains import reserve
from stressbot_msgs.msg import DriverStatus
from system_rig import System

from fuzzing.generated import Tally
from fuzzing.interface import ACCEPTED, Interface, Violation, check_refusal
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.estimation.kalman_filters import Prior
from stressbot_planner.execution import closed_loop
from stressbot_planner.execution.closed_loop import ClosedLoop, State
from stressbot_planner.ros.mover_node import PARAMETERS

UNIT = 1e-4
"""m"""

DECISIONS = 25
"""Of a loop in this process."""

PLANNING = 0.02
"""s of processor time, of one attempt at a plan there."""

TIME_LIMIT = 5.0
"""s, of a motion over DDS."""

PATIENCE = 90.0
"""s for the result of one."""

SIZES = (1, 1, 2, 3, 4, 6, 10)
SIZES_OF_SYSTEMS = (1, 2, 3, 6, 14, 40)

ASSUMED = {number.name: number for number in PARAMETERS if number.name.startswith("assumed.")}

_EXACT = {"seed": 0, "speed_error": 0.0, "heading_bias": 0.0, "heading_noise": 0.0, "position_noise": 0.0, "lost_probability": 0.0}


class Run(NamedTuple):
    """One motion.

    Attributes:
        assumed: parameters of the mover.
        imperfections: of the simulated robots and their tracker.
        goals: units, shape (n, 2).
        tolerance: units.
        patience: moves without a gain before a plan is asked for.
        real_time_factor: of the driver.
    """

    assumed: dict[str, float]
    imperfections: dict[str, float]
    goals: np.ndarray
    tolerance: float
    patience: int
    real_time_factor: float


def scenario(n: int, rng: random.Random) -> str:
    """Return a scenario file of n robots on a grid: a disc in the middle or not, walls or none, alike or not."""
    side = int(np.ceil(np.sqrt(n)))
    places = [(2.0 + 2.0 * (k % side), 2.0 + 2.0 * (k // side)) for k in range(n)]
    size = 4.0 * side + 8.0
    robots = [
        {"start": [x, y, rng.choice((0.0, rng.uniform(-3.0, 3.0)))], "goal": [x + rng.choice((0.0, 2.0 * side)), y]}
        for x, y in places
    ]
    swarm: dict[str, Any] = {"speed": 1.0, "turning_radius": rng.choice((0.3, 1.0, 2.0)), "body_radius": 0.3, "groups": "binary"}
    if rng.random() < 0.3:
        swarm["turning_radius"] = [rng.choice((0.5, 1.0)) for _ in range(n)]
    content = {"name": f"fuzzed-{n}", "length_unit": UNIT, "swarm": swarm, "robots": robots}
    if rng.random() < 0.7:
        content["workspace"] = {"x": [0.0, size], "y": [0.0, size]}
        content["obstacles"] = [{"circle": {"center": [2.0 * side + 1.5, size - 2.0], "radius": 0.8}}]
    return yaml.safe_dump(content)


def run_of(n: int, starts: np.ndarray, rng: random.Random) -> Run:
    """Return a motion of robots at starts (n, 2)."""

    def one(number: Any) -> float:
        near = number.default * rng.uniform(0.2, 3.0)
        anywhere = 10 ** rng.uniform(np.log10(max(number.low, 1e-5)), np.log10(number.high))
        value = rng.choice((number.low, number.high, number.default, near, near, anywhere, anywhere))
        return float(np.clip(value, number.low, number.high))

    assumed = {name: number.default if rng.random() < 0.4 else one(number) for name, number in ASSUMED.items()}
    flaws = {"seed": rng.randrange(1000)}
    for name, most in (("speed_error", 0.1), ("heading_bias", 0.2), ("heading_noise", 0.1), ("lost_probability", 0.05)):
        if rng.random() < 0.5:
            flaws[name] = rng.uniform(0.0, most)
    if rng.random() < 0.3:
        flaws["position_noise"] = UNIT * rng.uniform(0.0, 0.02)
    if rng.random() < 0.1:
        flaws["always_turn"] = [rng.randint(1, n)]
    kind = rng.choice(("all to one x", "near", "near", "shifted", "same", "swapped", "anywhere"))
    goals = starts.copy()
    if kind == "all to one x":
        goals[:, 0] = goals[:, 0].min() + 1.0
    elif kind == "near":
        goals += np.array([[rng.uniform(-0.3, 0.3) for _ in range(2)] for _ in range(n)])
    elif kind == "shifted":
        goals += rng.uniform(0.0, 3.0)
    elif kind == "swapped":
        goals = goals[::-1].copy()
    elif kind == "anywhere":
        goals = np.array([[rng.uniform(0.5, goals.max() + 3.0) for _ in range(2)] for _ in range(n)])
    factor = rng.choice((0.0, 1.0, 10.0, 50.0, 50.0, 200.0, 10 ** rng.uniform(-0.3, 4)))
    return Run(assumed, flaws, goals, 10 ** rng.uniform(-2.5, 0.3), rng.choice((0, 2, 60)), factor)


def looped(number: int) -> str:
    """Decide and observe in this process, some decisions long; return how that ends."""
    rng = random.Random(number)
    n = rng.choice(SIZES)
    text = scenario(n, rng)
    starts = np.array([robot["start"][:2] for robot in yaml.safe_load(text)["robots"]])
    run = run_of(n, starts, rng)
    bench = SimulatedBench(text, **run.imperfections)
    assumed = Prior(**{name.removeprefix("assumed."): value for name, value in run.assumed.items()})
    with patch.object(closed_loop, "PATIENCE", run.patience):
        swarm, environment = bench.scenario.swarm, bench.scenario.problem.environment
        loop = ClosedLoop(swarm, environment, run.goals, run.tolerance, bench.true_poses(), solver(PLANNING), assumed)
        for _ in range(DECISIONS):
            decision = loop.decide()
            if decision.state is State.DONE:
                return ACCEPTED
            if decision.error is not None:
                check_refusal(decision.error.code, decision.error.field, decision.error.message)
                return decision.error.code.name
            if not len(decision.groups) or not np.all(decision.lengths > 0):
                raise Violation(f"activations of no length: {decision.groups}, {decision.lengths}")
            for group, length in zip(decision.groups.tolist(), decision.lengths.tolist(), strict=True):
                loop.observe(group, length, bench.execute(group, length))
    return "under way"


class Mover:
    """A mover with driver and sequencer, and a hand at its action."""

    def __init__(self, folder: Path, text: str):
        path = folder / "scenario.yaml"
        path.write_text(text)
        starts = [robot["start"][:2] for robot in yaml.safe_load(text)["robots"]]
        self.starts = np.array(starts)
        self.system = System(folder, ("driver", "sequencer", "mover"), scenario=path, pose_rate=200.0)
        self.client, self.node = self.system.client, self.system.client.node
        self.actions = ActionClient(self.node, MoveSwarm, "move_swarm")
        self.parameters = {name: AsyncParameterClient(self.node, f"{self.system.namespace}/{name}") for name in ("driver", "mover")}
        self.system.wait_for(self.client.is_bench_ready, "driver and sequencer")
        self.system.wait_for(lambda: all(client.services_are_ready() for client in self.parameters.values()), "parameters")
        self.system.wait_for(self.actions.server_is_ready, "move_swarm")
        self.system.wait_for(self.system.is_known_to_mover(self.actions), "first answer of the mover")

    def close(self) -> None:
        """End all nodes."""
        self.system.close()

    def move(self, run: Run, time_limit: float) -> str:
        """Put the robots back, drive one motion and return how it ends."""
        self.client.trigger("stop", PATIENCE)
        if not (answer := self.client.trigger("reset", PATIENCE)).success:
            raise Violation(f"no reset: {answer.message}")
        flaws = {f"imperfections.{name}": run.imperfections.get(name, default) for name, default in _EXACT.items()}
        self._set("driver", flaws | {"real_time_factor": run.real_time_factor})
        self._set("mover", run.assumed | {"planning_time": 0.1})
        goal = MoveSwarm.Goal(
            robots=list(range(1, len(run.goals) + 1)),
            goal_x=(UNIT * run.goals[:, 0]).tolist(),
            goal_y=(UNIT * run.goals[:, 1]).tolist(),
            tolerance=UNIT * run.tolerance,
            time_limit=time_limit,
        )
        handle = self._answer(self.system.asked(lambda: self.actions.send_goal_async(goal)), "acceptance")
        result = self._answer(self.system.asked(handle.get_result_async), "result").result
        status = self.client.driver_status
        if status.state == DriverStatus.RUNNING or status.output_level != 0.0:
            self.system.wait_for(lambda: self.client.driver_status.output_level == 0.0, "rest")
        if result.error_code == 0:
            return ACCEPTED
        check_refusal(result.error_code, *result.error_msg.partition(": ")[::2])
        return ErrorCode(result.error_code).name

    def _answer(self, future: Any, what: str) -> Any:
        self.system.wait_for(future.done, what, PATIENCE)
        return future.result()

    def _set(self, node: str, values: dict[str, Any]) -> None:
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        for result in self._answer(self.parameters[node].set_parameters(parameters), f"parameters of {node}").results:
            if not result.successful:
                raise Violation(f"{node} refuses its parameters: {result.reason}")


def campaign(
    count: int, number: int, only: str = "", sizes: tuple[int, ...] = SIZES_OF_SYSTEMS, time_limit: float = TIME_LIMIT
) -> Iterator[Tally]:
    """Drive about `count` motions at running nodes, an equal share for each size of swarm."""
    domain, hold = reserve()
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with hold:
        for index, n in enumerate(sizes):
            tally = Tally(f"closed loop, {n} robots", "DDS")
            share = (count + index) // len(sizes)
            if only not in tally.name or not share:
                continue
            rng, begin = random.Random(f"{number} {n}"), time.process_time()
            with TemporaryDirectory() as folder:
                mover = Mover(Path(folder), scenario(n, rng))
                try:
                    for _ in range(share):
                        _drive_one(mover, run_of(n, mover.starts, rng), tally, time_limit)
                finally:
                    mover.close()
            tally.seconds = time.process_time() - begin
            yield tally


def _drive_one(mover: Mover, run: Run, tally: Tally, time_limit: float) -> None:
    try:
        outcome = mover.move(run, time_limit)
    except (AssertionError, TimeoutError, StressbotError) as error:
        tally.violations.append(f"{error!r} at {run!r}; {mover.system.log('mover')[-2000:]}")
        outcome = "violation"
    tally.outcomes[outcome] += 1


INTERFACES = (Interface("closed loop", st.integers(0, 2**32), looped, 0.02),)
