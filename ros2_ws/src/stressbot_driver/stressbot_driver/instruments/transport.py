"""Bytes to an instrument and lines back, through PyVISA."""

import socket
from abc import ABC, abstractmethod

from stressbot_driver.errors import BenchError, ErrorCode

MAX_LINE = 4096  # [bytes] of an answer; no query asks for more than a line


class Transport(ABC):
    """One connection. Whatever fails is raised as an exception of any class; the connection is then of no more use."""

    @abstractmethod
    def send(self, message: bytes) -> None:
        """Send a whole message, terminator included."""

    @abstractmethod
    def receive(self) -> str:
        """The next line, without its terminator."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the connection; may be called twice."""


class VisaTransport(Transport):
    """A VISA resource, through the library pyvisa-py, which needs nothing of a vendor."""

    def __init__(self, resource: str, timeout: float) -> None:
        """Open `resource` (TCPIP0::192.168.1.5::5025::SOCKET); every exchange takes at most `timeout` [s].

        Raises BenchError BACKEND_FAILURE if PyVISA is not installed, and what PyVISA raises.
        """
        try:
            import pyvisa
            import pyvisa_py  # noqa: F401 # loaded by name later: better to miss it here
        except ImportError as error:
            raise BenchError(
                ErrorCode.BACKEND_FAILURE,
                "backend",
                f"PyVISA is missing ({error}): install python3-pyvisa and python3-pyvisa-py",
            ) from error
        self._resource = pyvisa.ResourceManager("@py").open_resource(
            resource, timeout=round(1000 * timeout), open_timeout=round(1000 * timeout), read_termination="\n"
        )
        # A command and the query after it are two packets: without this, each query waits 40 ms for the receipt of the first.
        # pyvisa-py has the VISA attribute for it, but its setter does nothing (0.8.1).
        session = self._resource.visalib.sessions[self._resource.session]
        if isinstance(connection := getattr(session, "interface", None), socket.socket):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, message: bytes) -> None:
        self._resource.write_raw(message)

    def receive(self) -> str:
        # `read` would go on for as long as something comes.
        line = self._resource.read_bytes(MAX_LINE, break_on_termchar=True)
        if len(line) >= MAX_LINE:
            raise ConnectionError(f"an answer of {MAX_LINE} bytes or more")
        return line.decode("ascii").strip()

    def close(self) -> None:
        self._resource.close()
