"""The real session, client, gate and simulated backend, as threads of one scheduler, with a clock that obeys the test."""

import select
import socket
from collections import deque
from collections.abc import Callable
from contextlib import contextmanager, suppress
from types import SimpleNamespace

from driver_support import bench, sequence
from scheduling import Scheduler, Task, pair

from stressbot_driver import session as session_module
from stressbot_driver.backends import playback, simulated
from stressbot_driver.backends.base import Listener, Pacing
from stressbot_driver.backends.simulated import SimulatedBackend
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.gate import client as client_module
from stressbot_driver.gate import gate as gate_module
from stressbot_driver.gate.client import GateClient
from stressbot_driver.gate.gate import Gate, Opening, Sockets
from stressbot_driver.session import Session, State
from stressbot_driver.simulation.substrate import Poses

BENCH = bench(2)
SEQUENCE = sequence(BENCH, [90.0, 0.0], [0.1, 0.1])
POSES = Poses(*BENCH.start.T[[0, 0, 1, 2]])
TIMEOUT = 0.06
MODULES = (session_module, client_module, gate_module, playback, simulated)
FILES = tuple(module.__file__ for module in MODULES)
LOSS = StressbotError(ErrorCode.PEER_LOST, "sequencer_status", "silent: start it again, then call reset")


class Substrate:
    """What an instrument's output would be: it outlives the gate, and an opening brings it to rest."""

    def __init__(self, history: list[float]):
        self.history = history

    def apply(self, level: float) -> None:
        self.history.append(level)

    def advance(self, _time: float) -> None:
        pass

    def poses(self, _after: float = 0.0) -> Poses:
        return POSES

    def reset(self) -> None:
        pass


class World:
    """Everything, up to a driver whose gate is open.

    Attributes:
        history: levels [V] on the substrate.
        clock: [s] of all; stands unless told otherwise.
        lasting: a sequence does not end by itself.
        errors: what requests were refused with, by request.
    """

    def __init__(self, choices: list[int] = (), files: tuple[str, ...] = (), broken: tuple[str, ...] = ()):
        self.scheduler = Scheduler(list(choices), files)
        self.clock, self.lasting, self.broken = 1000.0, True, set(broken)
        self.history: list[float] = [0.0]
        self.gates: list[Process] = []
        self._memory: list[object] = []
        self._patch()
        self.session: Session = None
        self.client: GateClient = None
        self._quietly("setup", self._set_up)

    @property
    def level(self) -> float:
        return self.history[-1]

    @property
    def gate(self) -> Gate:
        return self.gates[-1].gate

    @property
    def state(self) -> State:
        return self.session._status.state

    def _set_up(self) -> None:
        def make(listener: Listener) -> GateClient:
            return GateClient("simulated", SimulatedBackend, BENCH, listener, timeout=TIMEOUT, process=Process(self))

        self.session = Session(make, lambda: None, lambda *_: None)
        self.client = self.session.backend
        self.client.beat()

    def _quietly(self, name: str, run: Callable[[], object]) -> Task:
        """Let something happen and everybody come to rest, without other orders being tried."""
        task = self.scheduler.spawn(name, run)
        self.scheduler.run(quietly=True)
        return task

    def do(self, name: str) -> StressbotError | None:
        """One request or event, to its end; what it was refused with."""
        task = self._quietly(name, getattr(self, name))
        assert task.done, f"{name} waits for ever, as do {self.scheduler.waiting}"
        if task.error is not None and not isinstance(task.error, StressbotError):
            raise task.error
        return task.error

    # Requests and events

    def load(self) -> None:
        self.lasting = True
        self.session.load(SEQUENCE)

    def start(self) -> None:
        self.session.start(Pacing(1.0, 0.1))

    def stop(self) -> None:
        self.session.stop()

    def reset(self) -> None:
        self.session.reset()

    def look(self) -> None:
        self.session.poses()

    def close(self) -> None:
        self.session.close()

    def loss(self) -> bool:
        return self.session.lost(LOSS)

    def found(self) -> None:
        self.session.found(LOSS.field)

    def end(self) -> None:
        """The sequence may run to its end now."""
        self.scheduler.point()
        self.lasting = False

    def beat(self) -> None:
        self.client.beat()

    def silence(self) -> None:
        """The driver is frozen for longer than the gate waits, and goes on."""
        self.scheduler.point()
        self.clock += 1.2 * TIMEOUT

    def later(self) -> None:
        """Time enough for the gate to try again what has failed."""
        self.scheduler.point()
        self.clock += 2.0 * gate_module.AGAIN

    def death(self) -> None:
        """The gate is killed."""
        self.scheduler.point()
        self.gates[-1].kill()

    def nonsense(self) -> None:
        """Something sends the gate what is no message."""
        with suppress(OSError, AttributeError):  # it has ended, or there is none
            self.client._link.process.beats.send(b"x")

    # What the modules find instead of threads, sockets, memory and time

    def _patch(self) -> None:
        threading, sockets = (
            self.scheduler.threading,
            SimpleNamespace(
                send_fds=lambda connection, messages, descriptors: connection.send_fds(messages, list(descriptors)),
                recv_fds=lambda connection, size, most: connection.recv_fds(size, most),
                **{name: getattr(socket, name) for name in ("MSG_DONTWAIT", "SHUT_RDWR", "socket")},
            ),
        )
        memory = SimpleNamespace(
            sealed_sequence=self._kept, sealed_object=lambda _name, value: self._kept(value), Ring=self._ring,
            read_sequence=self._memory.__getitem__, read_object=self._memory.__getitem__,
        )  # fmt: skip
        time = SimpleNamespace(monotonic=lambda: self.clock, sleep=self._sleep)
        for module in (session_module, client_module, gate_module, playback):
            module.threading = threading
        for module in (client_module, gate_module):
            module.socket, module.memory, module.os = sockets, memory, SimpleNamespace(close=lambda _: None)
        client_module.time = gate_module.time = time
        client_module.GateProcess = lambda: Process(self)
        gate_module.select = SimpleNamespace(poll=lambda: _Poll(self), POLLIN=select.POLLIN)
        gate_module.real_time = lambda _priority: None

    def _kept(self, value: object) -> int:
        self._memory.append(value)
        return len(self._memory) - 1

    def _ring(self, _robots: int, descriptor: int | None = None) -> "_Ring":
        return _Ring(self) if descriptor is None else self._memory[descriptor]

    def _sleep(self, seconds: float) -> None:
        self.scheduler.point()
        self.clock += max(seconds, 1.0)


@contextmanager
def worlds():
    """The modules are as they were afterwards."""
    before = {module: dict(vars(module)) for module in MODULES}
    try:
        yield
    finally:
        for module, names in before.items():
            vars(module).update(names)


class Process:
    """A gate's process, as `GateProcess`."""

    def __init__(self, world: World):
        world.scheduler.point()
        if "process" in world.broken:
            raise OSError("no more processes")
        self._world = world
        names = ("beats", "stops", "requests", "reports")
        pairs = [pair(world.scheduler) for _ in names]
        self.beats, self.stops, self.requests, self.reports = (ours for ours, _ in pairs)
        self._theirs = [their for _, their in pairs]
        self.pid, self._killed = 100 + len(world.gates), False
        world.gates.append(self)
        self.gate = Gate(Sockets(*self._theirs), self._opening, now=lambda: world.clock)
        self._main = world.scheduler.spawn("gate", self.gate.run)

    def _opening(self, _configuration: int) -> Opening:
        return Opening(self._make, TIMEOUT, len(BENCH.ids), [])

    def _make(self, listener: Listener) -> SimulatedBackend:
        clock = _Clock(self._world)
        backend = SimulatedBackend(BENCH, clock, listener, substrate=Substrate(self._world.history))
        for name in ("upload", "start", "stop", "reset"):
            setattr(backend, name, self._breakable(name, getattr(backend, name)))
        return backend

    def _breakable(self, name: str, call: Callable) -> Callable:
        def called(*arguments: object) -> object:
            if name in self._world.broken:
                raise OSError("cable unplugged")
            return call(*arguments)

        return called

    def kill(self) -> None:
        """Its threads, which are all but the driver's, do nothing any more."""
        self._killed = True
        for task in self._world.scheduler.tasks:
            if not task.done and self._is_mine(task):
                task.ready = lambda: False
        for their in self._theirs:
            their.close()

    def _is_mine(self, task: Task | None) -> bool:
        return task is not None and (task is self._main or self._is_mine(task.parent))

    def close(self, _patience: float = 0.0) -> str | None:
        for ours in (self.beats, self.stops, self.requests, self.reports):
            if not ours.closed:
                ours.shutdown(0)
        self._world.scheduler.point(lambda: self._killed or self._main.done)
        return "signal 9" if self._killed else "exit code 0"


class _Clock:
    """Of the backend: who waits for a moment may go on at once, unless sequences last."""

    def __init__(self, world: World):
        self._world = world

    def now(self) -> float:
        return self._world.clock

    def wait_until(self, _deadline: float, wake) -> bool:
        self._world.scheduler.point(lambda: wake._set or not self._world.lasting)
        return wake._set


class _Poll:
    def __init__(self, world: World):
        self._world, self._sockets = world, []

    def register(self, connection, _events: int) -> None:
        self._sockets.append(connection)

    def poll(self, milliseconds: float) -> None:
        until = self._world.clock + 1e-3 * milliseconds
        self._world.scheduler.point(lambda: any(one.readable for one in self._sockets) or self._world.clock >= until)


class _Ring:
    def __init__(self, world: World):
        self._poses: deque = deque()
        self.put_so_far, self.descriptor = 0, world._kept(self)

    def put(self, time: float, poses: Poses) -> bool:
        self._poses.append((time, poses))
        self.put_so_far += 1
        return True

    def take(self):
        return self._poses.popleft() if self._poses else None

    def put_aside(self, poses: Poses) -> None:
        self._aside = poses

    def taken_aside(self) -> Poses:
        return self._aside
