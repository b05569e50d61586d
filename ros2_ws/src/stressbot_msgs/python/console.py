"""A terminal that is stopped (Ctrl-S), or a pipe that nobody reads, holds up nobody who writes to it.

ROS writes its log lines to standard error while it holds the interpreter's lock: one that blocks would block all threads.
"""

import fcntl
import os
import select
import threading
from contextlib import suppress

WAITING = 1 << 20
"""Bytes that wait for a slow reader; what comes after is dropped, and counted."""

PATIENCE = 0.5
"""s for which the end of the process waits for the reader of its last words."""

_ATOMIC = select.PIPE_BUF  # bytes for which a pipe that can be written to has room


class Console:
    """Stands between this process and its standard output and error, for as long as the block lasts."""

    def __enter__(self) -> "Console":
        if os.isatty(2):
            os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")  # the pipe is no terminal, but leads to one
        self._streams = [_Stream(number) for number in (1, 2)]
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Hand on the last words, unless nobody reads them."""
        for stream in self._streams:
            stream.close()


class _Stream:
    """One file descriptor, replaced by a pipe that a thread empties to where the descriptor led before."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._target = os.dup(number)
        self._source, entrance = os.pipe()
        with suppress(PermissionError):  # more than a user may have
            fcntl.fcntl(entrance, fcntl.F_SETPIPE_SZ, WAITING)
        for descriptor in (self._source, entrance):
            os.set_blocking(descriptor, False)  # should the thread be held up as well, words are lost and nobody waits
        os.dup2(entrance, number)
        os.close(entrance)
        self._over, self._end = os.pipe()
        self._thread = threading.Thread(target=self._hand_on, name="console", daemon=True)
        self._thread.start()

    def close(self) -> None:
        if self._end < 0:
            return
        os.close(self._end)
        self._end = -1
        self._thread.join(PATIENCE)
        if not self._thread.is_alive():  # else what this process still has to say is better lost than waited for
            os.dup2(self._target, self._number)

    def _hand_on(self) -> None:
        words, dropped = b"", 0
        while True:
            readable, writable, _ = select.select([self._source, self._over], [self._target] if words or dropped else [], [])
            over = self._over in readable
            with suppress(BlockingIOError):
                while True:
                    heard = os.read(self._source, 65536)
                    room = max(WAITING - len(words), 0)
                    words, dropped = words + heard[:room], dropped + len(heard[room:])
                    over = over or not heard
                    if not over or not heard:
                        break
            if writable and not words and dropped:
                words, dropped = b"... %d bytes that nobody read in time are left out\n" % dropped, 0
            try:
                if writable:
                    words = words[os.write(self._target, words[:_ATOMIC]) :]
            except OSError:  # nobody is there any more
                words, dropped = b"", 0
            if over and not words and not dropped:
                return
