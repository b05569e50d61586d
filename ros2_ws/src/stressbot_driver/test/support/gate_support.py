"""Backends behind a gate: one that obeys the test, and one that writes down what the substrate sees."""

import os
import threading
import time

from driver_support import DEADLINE

from stressbot_driver.backends.base import Backend, Progress
from stressbot_driver.gate.client import GateClient
from stressbot_driver.gate.protocol import PERIOD
from stressbot_driver.sequence import Limits

WATCHED = """
import os, time
from stressbot_driver.backends.simulated import SimulatedBackend
from stressbot_driver.simulation.substrate import Substrate


class WatchedSubstrate(Substrate):
    def apply(self, level):
        super().apply(level)
        os.write(LOG, b"%.6f %.1f\\n" % (time.monotonic(), level))


LOG = os.open(os.environ["WATCHED_LOG"], os.O_WRONLY | os.O_CREAT | os.O_APPEND)


class Watched(SimulatedBackend):
    def __init__(self, bench, clock, listener, options=None):
        super().__init__(bench, clock, listener, options, substrate=WatchedSubstrate(bench))
"""


class Watch:
    """A backend `watched` for processes that are started with `environment`, and when it applied which level."""

    def __init__(self, folder):
        (folder / "watched.py").write_text(WATCHED)
        information = folder / "watched-0.dist-info"
        information.mkdir()
        (information / "METADATA").write_text("Metadata-Version: 2.1\nName: watched\nVersion: 0\n")
        (information / "entry_points.txt").write_text("[stressbot_driver.backends]\nwatched = watched:Watched\n")
        self.log = folder / "watched.log"
        paths = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
        self.environment = {"WATCHED_LOG": str(self.log), "PYTHONPATH": paths}

    def levels(self):
        """When [s, monotonic] which level [V] was applied, in order."""
        if not self.log.exists():
            return []
        return [tuple(map(float, line.split())) for line in self.log.read_text().splitlines()]

    def at_rest(self, since, patience=DEADLINE):
        """Wait for rest after `since`; how long it took [s]."""
        limit = time.monotonic() + patience
        while time.monotonic() < limit:
            for moment, level in reversed(self.levels()):
                if moment >= since and level == 0.0:
                    return moment - since
            time.sleep(0.001)
        raise AssertionError(f"no rest within {patience} s: {self.levels()[-3:]}")


class PuppetBackend(Backend):
    """Volts are on from `start` until `stop`, or until the test ends the run; calls named in `broken` fail."""

    def __init__(self, bench, listener):
        super().__init__(bench, None, listener)
        self.volts = False
        self.broken = set()
        self.calls = []

    limits = Limits(min_level=0.0, max_level=200.0)

    def _call(self, name):
        self.calls.append(name)
        if name in self.broken:
            raise OSError("cable unplugged")

    def upload(self, sequence):
        self._call("upload")

    def start(self, pacing):
        self.volts = True
        self._call("start")

    def stop(self):
        self._call("stop")
        self.volts = False

    def reset(self):
        self._call("reset")

    def close(self):
        self._call("close")
        self.volts = False

    def progress(self):
        return Progress(level=140.0 if self.volts else 0.0)

    def finish(self):
        self.volts = False
        self.listener.finished()


class Beating:
    """A gate's client and somebody who keeps saying that all is well."""

    def __init__(self, client: GateClient):
        self.client = client
        self.silent = threading.Event()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._beat)
        self._thread.start()

    def _beat(self):
        while not self._over.wait(PERIOD):
            if not self.silent.is_set():
                self.client.beat()

    def close(self):
        self._over.set()
        self._thread.join()
        self.client.close()
