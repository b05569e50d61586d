"""Playing one sequence at a time on a thread of its own: what backends that do so have in common."""

import threading
from collections.abc import Callable, Mapping
from typing import Any

from stressbot_driver.backends.base import Backend, Listener
from stressbot_driver.bench import Bench
from stressbot_driver.clock import Clock
from stressbot_driver.errors import ErrorCode, StressbotError


class PlaybackBackend(Backend):
    """A backend whose `start` begins a thread, which ends by itself or once `_halt` is set.

    The thread clears `_playing` when the output is at rest, before it reports its end.
    """

    def __init__(self, bench: Bench, clock: Clock, listener: Listener, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(bench, clock, listener, options)
        self._thread: threading.Thread | None = None
        self._playing = False
        self._halt = threading.Event()
        self._beginning = threading.Lock()  # whoever halts finds a thread that runs, or none

    def _begin(self, run: Callable[..., None], *arguments: Any) -> None:
        self._join()  # an earlier thread has reported its end but may not have returned yet
        with self._beginning:
            self._halt.clear()
            self._playing = True
            thread = threading.Thread(target=run, args=arguments, name="playback", daemon=True)
            try:
                thread.start()
            except BaseException:  # no more threads
                self._playing = False
                raise
            self._thread = thread

    def _stop_playing(self) -> None:
        """Halt what has begun; `_join` waits for its end. What begins later is for the caller to stop again."""
        with self._beginning:
            self._halt.set()

    def _join(self) -> None:
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _refuse_while_running(self, what: str) -> None:
        if self._playing:
            raise StressbotError(ErrorCode.BUSY, what, "a sequence is running: stop it first")
