"""What several tests of the driver need. The encoder and the closed form know nothing of the simulation."""

import copy
import math
import threading

import numpy as np
import yaml

from stressbot_driver.backends.base import Listener
from stressbot_driver.bench import parse_bench
from stressbot_driver.clock import Clock
from stressbot_driver.sequence import VoltageSequence

DEADLINE = 120.0  # [s] for anything that should happen soon, on however busy a machine


def scenario(count=6, **changes):
    """A valid scenario as a mapping; dots in a key descend: scenario(**{"swarm.speed": 2.0})."""
    content = {
        "name": "test",
        "length_unit": 1.0e-4,
        "swarm": {"speed": 1.0, "turning_radius": 1.0, "body_radius": 0.3, "groups": "binary"},
        "robots": [{"start": [0.0, 2.0 * k, 0.0], "goal": [12.0, 2.0 * k]} for k in range(count)],
    }
    for path, value in changes.items():
        target = content
        *parents, last = path.split(".")
        for part in parents:
            target = target[int(part)] if isinstance(target, list) else target.setdefault(part, {})
        if isinstance(target, list):
            target[int(last)] = value
        elif value is ...:
            del target[last]
        else:
            target[last] = value
    return content


def scenario_text(count=6, **changes):
    return yaml.safe_dump(copy.deepcopy(scenario(count, **changes)), sort_keys=False)


def bench(count=6, **changes):
    return parse_bench(scenario_text(count, **changes))


def encode(bench, activations, plan_id="plan"):
    """The volts that select each group and drive for a time: activations are (group 1..m, seconds).

    Where the drive pulses, that is the nearest whole number of pulses.
    """
    electrical = bench.electrical
    if electrical.drive is not None:
        counts = [(group, round(seconds * electrical.drive.frequency)) for group, seconds in activations]
        return pulsed(bench, counts, plan_id=plan_id)
    levels, dwells, ends = [], [], []
    for group, seconds in activations:
        levels += [electrical.reset_level, electrical.rest_level]
        dwells += [electrical.reset_dwell, electrical.guard_dwell]
        for symbol in electrical.codes[group - 1]:
            levels += [electrical.symbol_levels[symbol], electrical.rest_level]
            dwells += [electrical.symbol_dwell, electrical.guard_dwell]
        levels += [electrical.drive_level, electrical.rest_level]
        dwells += [seconds, electrical.guard_dwell]
        ends.append(len(levels))
    return sequence(bench, levels, dwells, ends, plan_id)


def pulsed(bench, activations, **changes):
    """The volts that select each group and then drive: activations are (group 1..m, pulses)."""
    electrical, drive = bench.electrical, bench.electrical.drive
    rows, ends = [], []
    for group, count in activations:
        rows += [(electrical.reset_level, electrical.reset_dwell, 0, 0.0), (0.0, electrical.guard_dwell, 0, 0.0)]
        for symbol in electrical.codes[group - 1]:
            rows += [(electrical.symbol_levels[symbol], electrical.symbol_dwell, 0, 0.0), (0.0, electrical.guard_dwell, 0, 0.0)]
        rows += [(electrical.drive_level, count / drive.frequency, count, drive.low_level), (0.0, electrical.guard_dwell, 0, 0.0)]
        ends.append(len(rows))
    levels, dwells, pulses, lows = zip(*rows, strict=True)
    trains = {"pulses": np.array(pulses, dtype=np.uint64), "low_levels": np.array(lows), "duty": drive.duty}
    return sequence(bench, levels, dwells, ends, **trains | {"alternating": drive.alternating} | changes)


def sequence(bench, levels, dwells, ends=None, plan_id="plan", **changes):
    values = {
        "plan_id": plan_id,
        "swarm_id": bench.swarm_id,
        "levels": np.array(levels, dtype=float),
        "dwells": np.array(dwells, dtype=float),
        "epoch_ends": np.array([len(levels)] if ends is None else ends, dtype=np.int64),
        "duration": float(np.sum(np.array(dwells, dtype=float))),
    }
    return VoltageSequence(**{**values, **changes})


def play(substrate, sequence):
    """Put a sequence on a simulated substrate, and return that."""
    for k, (level, dwell) in enumerate(zip(sequence.levels.tolist(), sequence.dwells.tolist(), strict=True)):
        train = sequence.train(k)
        if train is None:
            substrate.apply(level)
            substrate.advance(dwell)
        else:
            substrate.repeat(train.pattern, train.repeats, train.duration)
    return substrate


def closed_form(bench, activations):
    """Poses (n, 3) [m, m, rad], heading unwrapped, after activations (group, seconds): the paper's model, summed exactly."""
    poses = []
    for j, codeword in enumerate(bench.codewords):
        x0, y0, heading0 = bench.start[j]
        xs, ys, turns, heading = [x0], [y0], [heading0], heading0
        for group, seconds in activations:
            if group < bench.group_count and codeword[group - 1] == "1":
                xs.append(bench.speed[j] * seconds * math.cos(heading))
                ys.append(bench.speed[j] * seconds * math.sin(heading))
            else:
                turns.append(bench.speed[j] * seconds / bench.turning_radius[j])
                heading = math.fsum(turns)
        poses.append((math.fsum(xs), math.fsum(ys), heading))
    return np.array(poses)


class FakeClock(Clock):
    """Time passes at once while somebody waits; `at` lets something happen on the way."""

    def __init__(self):
        self.time = 100.0
        self._happenings = []

    def at(self, time, action):
        """Call `action` when the clock reaches `time` [s] from its start."""
        self._happenings.append((100.0 + time, action))
        self._happenings.sort(key=lambda happening: happening[0])

    def now(self):
        return self.time

    def wait_until(self, deadline, wake):
        while not wake.is_set() and self._happenings and self._happenings[0][0] <= deadline:
            time, action = self._happenings.pop(0)
            self.time = max(self.time, time)
            action()
        if wake.is_set():
            return True
        self.time = max(self.time, deadline)
        return False


class Recorder(Listener):
    """A listener that remembers, and can be waited for."""

    def __init__(self):
        self.samples = []
        self.error = None
        self.done = False
        self.ended = threading.Event()

    def poses_measured(self, time, poses):
        self.samples.append((time, poses))

    def finished(self):
        self.done = True
        self.ended.set()

    def failed(self, error):
        self.error = error
        self.ended.set()
