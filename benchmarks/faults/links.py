"""The other host: a network namespace with an address of its own, and one link to it, whole or lossy. Needs root."""

import fcntl
import os
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

CABLE = Path(__file__).with_name("cable.py")
TUNSETIFF = 0x400454CA
IFF_TAP, IFF_NO_PI = 0x0002, 0x1000
"""See linux/if_tun.h."""


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)


class Link:
    """A network namespace as the other host, and a link that may be cut.

    Raises:
        subprocess.CalledProcessError: this machine does not allow it.
    """

    def __init__(self):
        self.name = f"stressbot{os.getpid()}"
        here, self._there = f"sb{os.getpid()}h", f"sb{os.getpid()}t"
        try:
            _ip("netns", "add", self.name)
            self._lay(here, self._there)
            _ip("addr", "add", "10.213.77.1/30", "dev", here)
            _ip("link", "set", here, "up")
            _ip("-n", self.name, "addr", "add", "10.213.77.2/30", "dev", self._there)
            _ip("-n", self.name, "link", "set", "lo", "up")
            self.heal()
        except BaseException:
            self.close()
            raise

    def _lay(self, here: str, there: str) -> None:
        """Make two network devices, one of them on the other host, and join them."""
        _ip("link", "add", here, "type", "veth", "peer", "name", there, "netns", self.name)

    @property
    def prefix(self) -> tuple[str, ...]:
        """What makes a command run on the other host."""
        return "ip", "netns", "exec", self.name

    def cut(self) -> float:
        """Pull the plug, and return when."""
        now = time.monotonic()
        _ip("-n", self.name, "link", "set", self._there, "down")
        return now

    def heal(self) -> None:
        """Put the plug back."""
        _ip("-n", self.name, "link", "set", self._there, "up")
        _ip("-n", self.name, "route", "add", "default", "dev", self._there)

    def close(self) -> None:
        """Take the other host away, and the link with it."""
        with suppress(subprocess.CalledProcessError):
            _ip("netns", "del", self.name)


class LossyLink(Link):
    """A link on which a process (`cable.py`) hands every packet on, or not: this kernel may have no such queue of its own.

    Raises:
        OSError: /dev/net/tun cannot be opened.
    """

    def _lay(self, here: str, there: str) -> None:
        self._taps = _tap(here), _tap(there)
        _ip("link", "set", there, "netns", self.name)
        self._cable = subprocess.Popen(
            [sys.executable, str(CABLE), *map(str, self._taps)], stdin=subprocess.PIPE, pass_fds=self._taps, text=True
        )

    def spoil(self, loss: float = 0.0, doubled: float = 0.0, delay: float = 0.0) -> None:
        """Lose and double packets with these probabilities, and hold each back for a random time of up to `delay` s."""
        print(loss, doubled, delay, file=self._cable.stdin, flush=True)

    def close(self) -> None:
        """Take everything away."""
        if hasattr(self, "_cable"):
            self._cable.kill()
            self._cable.wait()
            self._cable.stdin.close()
        for tap in getattr(self, "_taps", ()):
            os.close(tap)
        super().close()


def _tap(name: str) -> int:
    """Make a network device whose other end is a file descriptor, and return that."""
    tap = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(tap, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TAP | IFF_NO_PI))
    return tap
