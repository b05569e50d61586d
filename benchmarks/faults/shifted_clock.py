"""Clocks of processes that can be set: the machine's own is not ours to set."""

import mmap
import shutil
import struct
import subprocess
from pathlib import Path

SOURCE = Path(__file__).with_name("shifted_clock.c")


def compiler() -> str | None:
    """Return the C compiler of this machine, if there is one."""
    return shutil.which("cc") or shutil.which("gcc")


class Clocks:
    """One clock for each name, which its process reads instead of the machine's."""

    def __init__(self, folder: Path, names: tuple[str, ...]):
        self._library, self._maps = folder / "shifted_clock.so", {}
        subprocess.run([compiler(), "-shared", "-fPIC", "-O2", "-o", self._library, SOURCE, "-ldl", "-lpthread"], check=True)
        for name in names:
            self._file(name).write_bytes(struct.pack("q", 0))
            with self._file(name).open("r+b") as file:
                self._maps[name] = mmap.mmap(file.fileno(), 8)

    def _file(self, name: str) -> Path:
        return self._library.with_name(f"{name}.clock")

    def prefix(self, name: str) -> tuple[str, ...]:
        """Return what makes a command read this clock."""
        return "env", f"LD_PRELOAD={self._library}", f"STRESSBOT_CLOCK={self._file(name)}"

    def set(self, ahead: float, *names: str) -> None:
        """Set clocks, all if none is named, ahead of the machine's by a number of seconds."""
        for name in names or self._maps:
            self._maps[name][:] = struct.pack("q", round(1e9 * ahead))
