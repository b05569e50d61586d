"""What every backend offers, what it reports, and how one is found by name."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

from stressbot_driver.bench import Bench
from stressbot_driver.clock import Clock
from stressbot_driver.declaration import Declaration
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.sequence import Limits, VoltageSequence
from stressbot_driver.simulation.imperfections import Imperfections
from stressbot_driver.simulation.substrate import Poses

ENTRY_POINT_GROUP = "stressbot_driver.backends"


@dataclass(frozen=True)
class Pacing:
    """How fast a sequence is played, and how often poses are reported meanwhile."""

    real_time_factor: float = 1.0  # substrate seconds per wall second; 0: as fast as possible
    pose_rate: float = 50.0  # [Hz] in wall time, at most


@dataclass(frozen=True)
class Progress:
    """Where playback stands."""

    time: float = 0.0  # [s] substrate time since the sequence started
    epoch: int = 0  # epochs completed
    level: float = 0.0  # [V] on the substrate now


class Listener(ABC):
    """Hears from a backend, on the backend's own thread. Must return soon: playback waits meanwhile."""

    @abstractmethod
    def poses_measured(self, time: float, poses: Poses) -> None:
        """The robots at substrate time `time` [s]."""

    @abstractmethod
    def finished(self) -> None:
        """The sequence ran to its end; the output is at rest."""

    @abstractmethod
    def failed(self, error: StressbotError) -> None:
        """Playback broke off; the output is at rest."""


class Backend(ABC):
    """One output onto one substrate. At rest level whenever no sequence runs, and after `close` for good.

    Calls come from one thread at a time. Failures are raised as StressbotError with code BACKEND_FAILURE.
    """

    OPTIONS: ClassVar[tuple[Declaration, ...]] = ()
    """What can be set. The driver node declares option `x` of backend `b` as its parameter `b.x`."""

    RESOURCE: ClassVar[str] = ""
    """The option that names what only one driver can hold, such as an instrument's address; empty: there is no such thing."""

    NOTICE: ClassVar[str] = ""
    """What a user must know before the first volt; the driver node says it at start."""

    def __init__(self, bench: Bench, clock: Clock, listener: Listener, options: Mapping[str, Any] | None = None) -> None:
        """`options` are checked values by name; what they leave out has its default."""
        self.bench = bench
        self.clock = clock
        self.listener = listener
        self.options = {**{option.name: option.default for option in self.OPTIONS}, **(options or {})}

    @property
    @abstractmethod
    def limits(self) -> Limits:
        """What the output can do; a sequence is checked against it before `upload`."""

    @abstractmethod
    def upload(self, sequence: VoltageSequence) -> None:
        """Take a checked sequence, in place of an earlier one; the output stays at rest.

        One that the output cannot play is refused with another code than BACKEND_FAILURE, and the earlier one stays.
        """

    @abstractmethod
    def start(self, pacing: Pacing) -> None:
        """Start the uploaded sequence and return; its end is reported to the listener."""

    @abstractmethod
    def stop(self) -> None:
        """Rest level at once, from any thread, at any time; on return the output is at rest."""

    @abstractmethod
    def reset(self) -> None:
        """Robots back at their starts, if the backend can move them; forget the sequence. Not while one runs."""

    @abstractmethod
    def close(self) -> None:
        """Rest level and release of everything held; may be called twice."""

    @abstractmethod
    def progress(self) -> Progress:
        """Where playback stands; may be called from any thread."""

    def poses(self) -> Poses | None:
        """The robots now, or None from a backend that does not see them. Not while a sequence runs."""
        return None

    def impair(self, imperfections: Imperfections) -> None:
        """Give robots and tracker imperfections, in place of earlier ones. Not while a sequence runs.

        Raises StressbotError UNSUPPORTED from a backend of real robots, WRONG_COUNT or UNKNOWN_ROBOT if they are for other robots.
        """
        raise StressbotError(ErrorCode.UNSUPPORTED, "backend", "drives real robots, which have imperfections of their own")


def backend_class(name: str) -> type[Backend]:
    """The backend registered as `name`. Raises StressbotError: UNKNOWN_BACKEND, naming the known ones, or BACKEND_FAILURE."""
    from importlib.metadata import entry_points  # slow to import, and the gate has no need of it

    known = {entry.name: entry for entry in entry_points(group=ENTRY_POINT_GROUP)}
    if name not in known:
        raise StressbotError(
            ErrorCode.UNKNOWN_BACKEND,
            "backend",
            f"{name!r} is not known: choose one of {', '.join(sorted(known)) or '(none is installed)'}",
        )
    with broken_installation(name):
        return known[name].load()


def make_backend(name: str, bench: Bench, clock: Clock, listener: Listener, options: Mapping[str, Any] | None = None) -> Backend:
    """A backend of the class registered as `name`. Raises StressbotError as `backend_class` and the backend itself do."""
    return construct(name, backend_class(name), bench, clock, listener, options)


def construct(
    name: str, backend: type[Backend], bench: Bench, clock: Clock, listener: Listener, options: Mapping[str, Any] | None = None
) -> Backend:
    """A `backend`, which is registered as `name`. Raises StressbotError as the backend itself does, or BACKEND_FAILURE."""
    with broken_installation(name):
        return backend(bench, clock, listener, options)


@contextmanager
def broken_installation(name: str) -> Iterator[None]:
    """Whatever fails in the block is a StressbotError."""
    try:
        yield
    except StressbotError:
        raise
    except Exception as error:
        raise StressbotError(
            ErrorCode.BACKEND_FAILURE, "backend", f"{name!r} does not start ({error!r}): check its installation"
        ) from error
