"""Closed loop through the camera alone: pictures of simulated robots, the tracker, the controller, volts; one process, no clock."""

import time
from dataclasses import replace
from typing import NamedTuple

import closed_loop
import cv2
import numpy as np
from joblib import Parallel, delayed
from simulated_bench import SimulatedBench

from stressbot_driver.bench import Bench
from stressbot_driver.sequence import VoltageSequence
from stressbot_driver.vision.activations import Activations
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.detection import Detector
from stressbot_driver.vision.microscope import Microscope
from stressbot_driver.vision.optics import Optics
from stressbot_driver.vision.outline import Outline
from stressbot_driver.vision.planar import wrapped
from stressbot_driver.vision.tracking import Robots, SwarmTracker
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.estimation.recognition import Bodies, recognise
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table

FRAME_RATE = 15.0
"""Hz. A real camera has 30; each picture costs more here than all else."""

LOST = 0.05
"""Share of pictures that never arrive."""

LOOKS, MOST_LOOKS = 6, 45
"""Pictures at rest before each decision; and at most, where robots are missed."""

SIDE = 500
"""Pixels of a picture, for what the robots need and a margin."""

OPTICS = {"drift_x": 3e-7, "drift_y": -2e-7, "drift_turn": 2e-5, "wander": 2e-7}
"""m/s, rad/s, m/s^0.5."""


class Run(NamedTuple):
    """What became of one run; units, counts, s on the substrate, s of processor time of the tracker for one picture."""

    error: float
    gap: float
    swapped: int
    left_out: int
    pictures: int
    position: float
    heading: float
    activations: int
    seconds: float
    each: float
    reason: str


def robots_of(bench: Bench, known: bool = True) -> Robots:
    """Return what `swarm_description` tells the tracker."""
    return Robots(bench.ids, bench.speed, bench.speed / bench.turning_radius, bench.membership, bench.start if known else None)


def activations_of(sequence: VoltageSequence, bench: Bench) -> Activations:
    """Return what a sequence does when."""
    electrical = bench.electrical
    return Activations.of(
        sequence.levels, sequence.dwells, sequence.epoch_ends, sequence.trains, electrical.symbol_levels, electrical.drive_level,
        electrical.codes,
    )


class CameraBench(SimulatedBench):
    """A bench whose only tracker is a camera.

    Attributes:
        swapped: poses so far that were told under the id of another robot, or beside where it was by more than a body's radius.
        nameless: poses of what else the last picture showed, shape (k, 3), units.
    """

    def __init__(self, text: str, known: bool = True, side: int = SIDE, optics: dict | None = None, **imperfections):
        super().__init__(text, **imperfections)
        bench = self.bench
        places = np.vstack([bench.start[:, :2], bench.goal])
        if bench.workspace is not None:
            places = np.vstack([places, bench.workspace.reshape(2, 2).T])
        margin = 0.04 * float(np.ptp(places, axis=0).max()) + 2 * float(bench.body_radius.max())
        self.camera = replace(Camera.over(places, margin, side), rotation=0.02, distortion=0.01)
        outlines = [Outline.of(float(radius)) for radius in bench.body_radius]
        pivot = 0.1 * outlines[0].length
        outlines = [Outline(outline.length, outline.width, (pivot, 0.0)) for outline in outlines]
        seed = imperfections.get("seed", 0)
        self.microscope = Microscope(self.camera, outlines, Optics(**(OPTICS if optics is None else optics)), seed)
        self.tracker_by_eye = SwarmTracker(robots_of(bench, known), self.camera, outlines)
        self._random = np.random.default_rng([seed, 5])
        self.clock = self._ended = 0.0
        self.swapped = self.left_out = self.pictures = 0
        self.spent = 0.0
        self.errors: list[np.ndarray] = []
        self.notes: list[str] = []
        self._shown = np.full((len(bench.ids), 3), np.nan)
        self.nameless = np.empty((0, 3))

    def _take(self, truth, stamp: float, at: float) -> None:
        """Let the camera take a picture of true poses, which may never arrive."""
        poses = np.column_stack([truth.x, truth.y, truth.heading])
        picture = self.microscope.picture(poses, stamp)
        if self._random.random() < LOST:
            return
        begin = time.process_time()
        seen = self.tracker_by_eye.look(picture, stamp, at)
        self.spent += time.process_time() - begin
        self.pictures += 1
        self.notes += [f"{stamp:.2f} s: {note}" for note in seen.notes]
        rows = seen.ids.astype(int) - 1
        away = seen.poses - poses[rows]
        away[:, 2] = wrapped(away[:, 2])
        self.swapped += int(np.sum(np.hypot(away[:, 0], away[:, 1]) > self.bench.body_radius[rows]))
        self.left_out += len(poses) - len(rows)
        self.errors.append(np.column_stack([away[:, :2] / self.bench.body_radius[rows, None], away[:, 2]]))
        unit = self.scenario.length_unit
        self._shown = np.full((len(poses), 3), np.nan)
        self._shown[rows] = seen.poses / (unit, unit, 1.0)
        self.nameless = seen.nameless / (unit, unit, 1.0)

    def measure(self) -> np.ndarray:
        return self.rest(LOOKS)

    def rest(self, pictures: int) -> np.ndarray:
        """Let so many pictures be taken at rest; return the poses of the last, NaN where a robot was not seen in it."""
        for _ in range(pictures):
            self.clock += 1.0 / FRAME_RATE
            self._take(self.substrate.poses(), self.clock, self._ended)
        return self._shown.copy()

    def execute(self, group: int, length: float) -> np.ndarray:
        """Drive one activation, look at it, and return the poses at rest after it."""
        sequence = self._encoded(np.array([group]), np.array([length]))
        self.tracker_by_eye.play(activations_of(sequence, self.bench))
        begin = at = self._ended = 0.0
        next_picture = 1.0 / FRAME_RATE
        for index, (level, dwell) in enumerate(zip(sequence.levels.tolist(), sequence.dwells.tolist(), strict=True)):
            train = sequence.train(index)
            if train is None:
                self.substrate.apply(level)
            while next_picture <= begin + dwell:
                at = next_picture
                look = self.substrate
                after = at - begin
                truth = look.poses(after) if train is None else look.poses_during(train.pattern, train.repeats, after)
                self._take(truth, self.clock + at, at)
                next_picture += 1.0 / FRAME_RATE
            self._play(dwell, train)
            begin += dwell
        self._ended = begin
        self.clock += begin
        return self.rest(LOOKS)


def run(text: str, seed: int, time_limit: float, longest: float = closed_loop.LONGEST, **more) -> Run:
    """Drive one scenario in closed loop, by what the camera shows alone."""
    cv2.setNumThreads(1)
    bench = CameraBench(text, seed=seed, **(closed_loop.IMPERFECTIONS | more))
    problem = bench.scenario.problem
    measured = bench.measure()
    reason, activations = "", 0
    if np.isnan(measured).any():
        reason = f"robots are not known at the start: {bench.tracker_by_eye.missing}"
    else:
        brought = closed_loop.brought(bench, measured, time_limit, longest)
        reason, activations = brought.reason, brought.activations
        if bench.time >= longest:
            reason = str(StressbotError(ErrorCode.TIMED_OUT, "run", f"takes longer than {longest:g} s"))
    error = float(np.hypot(*(bench.true_poses()[:, :2] - problem.goals).T).max())
    off = np.concatenate(bench.errors) if bench.errors else np.full((1, 3), np.nan)
    position, heading = float(np.sqrt(np.mean(off[:, :2] ** 2))), float(np.degrees(np.sqrt(np.mean(off[:, 2] ** 2))))
    return Run(
        error, float(bench.gap), bench.swapped, bench.left_out, bench.pictures, position, heading, activations, bench.time,
        bench.spent / max(bench.pictures, 1), reason or "; ".join(bench.notes[-3:]),
    )


class Recognition(NamedTuple):
    """s on the substrate, the smallest true gap, units, poses under a wrong id, and why robots are not known."""

    seconds: float
    gap: float
    swapped: int
    reason: str


def recognised(text: str, seed: int) -> Recognition:
    """Let robots of which nobody knows who they are be known by how they move."""
    cv2.setNumThreads(1)
    bench = CameraBench(text, known=False, seed=seed, **closed_loop.IMPERFECTIONS)
    swarm, environment = bench.scenario.swarm, bench.scenario.problem.environment
    bench.rest(LOOKS)

    def look() -> Bodies:
        for _ in range(MOST_LOOKS):
            shown = bench.rest(1)
            if np.isfinite(shown[:, 0]).sum() + len(bench.nameless) >= swarm.n:
                break
        return Bodies(shown, bench.nameless)

    reason = ""
    try:
        recognise(swarm, environment, look, bench.execute)
    except StressbotError as error:
        reason = str(error)
    return Recognition(bench.clock, float(bench.gap), bench.swapped, reason)


CASES = (("paper's six, two discs", lambda seed: instances.paper(True)), ("14 across a band of 7 discs", instances.band))


LENGTHS = (3.0, 6.0, 10.0, 20.0, 40.0, 60.0)
"""Pixels of a robot."""


class Scene:
    """Robots at random places in front of a microscope, as large as wanted."""

    def __init__(self, seed: int, count: int, side: int, length: float):
        self.random = np.random.default_rng(seed)
        pixel = 1e-6
        self.camera = Camera(side, side, pixel, (3e-4, 2e-4), 0.3, 0.01)
        self.outline = Outline(length * pixel, 0.5 * length * pixel, (0.1 * length * pixel, 0.05 * length * pixel))
        places = np.empty((0, 2))
        while len(places) < count:
            point = self.random.uniform(0.8 * length, side - 0.8 * length, 2)
            if not len(places) or np.hypot(*(places - point).T).min() > 1.3 * length:
                places = np.vstack([places, point])
        self.poses = np.column_stack([self.camera.to_substrate(places), self.random.uniform(-np.pi, np.pi, count)])
        optics = Optics(dust=1 + 20 * side**2 // 1_000_000)
        self.microscope = Microscope(self.camera, [self.outline] * count, optics, seed)
        robots = Robots(
            np.arange(1, count + 1), np.full(count, 1e-4), np.full(count, 1.0), np.ones((count, 1), dtype=bool), self.poses
        )
        self.tracker = SwarmTracker(robots, self.camera, [self.outline] * count)


def accuracy(length: float, runs: int) -> tuple[float, float]:
    """Return errors of what one picture shows, from guesses a twentieth of a length and 6 degrees off: body radii, degrees; rms."""
    off = []
    for seed in range(runs):
        scene = Scene(seed, 8, max(120, int(8 * length)), length)
        detector = Detector(scene.camera, [scene.outline])
        away = scene.random.normal(0.0, 1.0, scene.poses.shape) * (0.05 * scene.outline.length, 0.05 * scene.outline.length, 0.1)
        found = detector.measure(scene.microscope.picture(scene.poses, 0.0), scene.poses + away, np.zeros(8, dtype=int))
        error = found.poses - scene.poses
        error[:, 2] = wrapped(error[:, 2])
        off.append(error / (0.5 * np.hypot(1.0, 0.5) * scene.outline.length * np.array([1.0, 1.0, 0.0]) + (0.0, 0.0, 1.0)))
    rms = np.sqrt(np.mean(np.square(np.concatenate(off)), axis=0))
    return float(np.hypot(rms[0], rms[1]) / np.sqrt(2)), float(np.degrees(rms[2]))


def effort(count: int, pictures: int = 60) -> tuple[float, float]:
    """Return s of processor time for a picture of 1000 x 1000 with so many robots of 20 pixels: median, and of the first."""
    scene = Scene(0, count, 1000, 20.0)
    spent = []
    for k in range(pictures):
        picture = scene.microscope.picture(scene.poses, k / 30.0)
        begin = time.process_time()
        scene.tracker.look(picture, k / 30.0, 0.0)
        spent.append(time.process_time() - begin)
    return float(np.median(spent)), spent[0]


def pictured(full: bool) -> Table:
    """Return what one picture shows, by the size of robots, and what it costs."""
    rows = []
    for length in LENGTHS:
        place, heading = accuracy(length, 50 if full else 12)
        rows.append((f"{length:g} pixels", f"{place:.4f}", f"{heading:.2f}", "", ""))
    for count, rate in ((14, 30), (62, 10)):
        median, first = effort(count)
        cost = f"{1e3 * median:.1f} ({1e3 * first:.0f})"
        rows.append((f"{count} robots of 20 pixels", "", "", cost, f"{100 * median * rate:.0f} %"))
    header = ("robots", "places (body radii rms)", "headings (deg rms)", "a picture; the first (ms, CPU)", "of a core")
    note = (
        "- Errors of one picture, without a filter. Pictures of 1000 x 1000 pixels; of a core with 14 robots at 30, with 62 at 10 "
        "pictures a second."
    )
    return Table("Robots in pictures", header, tuple(rows), note)


def tables(full: bool) -> list[Table]:
    """Return what pictures show, and a row for six and one for fourteen robots in closed loop."""
    return [pictured(full), named(full), driven(full)]


def named(full: bool) -> Table:
    """Return how long it takes until robots are known of which nobody knew who they are."""
    rows = []
    for name, text in CASES:
        seeds = range(closed_loop.FIRST_SEED, closed_loop.FIRST_SEED + (100 if full else 4))
        runs = Parallel()(delayed(recognised)(text(seed), seed) for seed in seeds)
        seconds = [run.seconds for run in runs if not run.reason]
        rows.append((
            name, f"{len(seconds)}/{len(runs)}", f"{np.median(seconds or np.nan):.0f} ({max(seconds, default=np.nan):.0f})",
            str(sum(run.swapped for run in runs)), f"{min(run.gap for run in runs):.3f}",
        ))
    header = ("robots", "all known", "on the substrate (s), median (max)", "swapped", "smallest gap")
    note = "- From robots that may be anywhere, by `recognise`; pictures and robots as in the next table."
    return Table("Robots known by how they move", header, tuple(rows), note)


def driven(full: bool) -> Table:
    """Return the closed loop's table."""
    rows = []
    for name, text in CASES:
        seeds = range(closed_loop.FIRST_SEED, closed_loop.FIRST_SEED + (100 if full else 2))
        runs = Parallel()(delayed(run)(text(seed), seed, closed_loop.PLANNING_TIME) for seed in seeds)
        there, apart = [run.error <= closed_loop.TOLERANCE for run in runs], [run.gap >= 0 for run in runs]
        both = sum(a and b for a, b in zip(there, apart, strict=True))
        rows.append((
            name, f"{both}/{len(runs)}", f"{max(run.error for run in runs):.2f}", f"{min(run.gap for run in runs):.3f}",
            str(sum(run.swapped for run in runs)), f"{sum(run.left_out for run in runs)}",
            str(sum(run.pictures for run in runs)), f"{np.median([run.position for run in runs]):.3f}",
            f"{np.median([run.heading for run in runs]):.2f}", f"{np.median([run.seconds for run in runs]):.0f}",
            f"{1e3 * np.median([run.each for run in runs]):.1f}",
        ))
    header = (
        "robots", "at their goals, no touch", "largest error", "smallest gap", "swapped", "left out", "pictures",
        "places (body radii rms)", "headings (deg rms)", "on the substrate (s)", "a picture (ms, CPU)",
    )
    note = (
        f"- {SIDE} x {SIDE} pixels, {FRAME_RATE:g} a second, {100 * LOST:g} % of them lost; robots imperfect as in the table "
        "above; noise, dust, electrodes, uneven light; the stage drifts, turns and wanders, which is in the errors. Swapped: poses "
        "under a wrong id. Left out: robots that a picture did not show for sure, of all pictures."
    )
    return Table("Closed loop through a camera", header, tuple(rows), note)
