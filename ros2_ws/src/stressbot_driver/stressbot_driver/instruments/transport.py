"""Bytes to an instrument and lines back: over a socket, or through PyVISA for whatever is no socket."""

import re
import socket
import time
from abc import ABC, abstractmethod

from stressbot_driver.errors import ErrorCode, StressbotError

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


def connect(resource: str, timeout: float) -> Transport:
    """A connection to a VISA resource, every exchange of which takes at most `timeout` [s]. Raises what goes wrong."""
    raw = re.fullmatch(r"TCPIP\d*::([^:]+)::(\d+)::SOCKET", resource.strip(), re.IGNORECASE)
    return SocketTransport(raw[1], int(raw[2]), timeout) if raw else VisaTransport(resource, timeout)


class SocketTransport(Transport):
    """SCPI over TCP. The time is that of a whole answer, however it trickles in; a cut connection is noticed at once."""

    RATE = 1e5  # [bytes/s] that a large message may take besides

    def __init__(self, host: str, port: int, timeout: float) -> None:
        self._timeout = timeout
        self._socket = socket.create_connection((host, port), timeout)
        # A command and the query after it are two packets: without this, each query waits 40 ms for the receipt of the first.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._received = b""

    def send(self, message: bytes) -> None:
        self._socket.settimeout(self._timeout + len(message) / self.RATE)  # of `sendall` as a whole
        self._socket.sendall(message)

    def receive(self) -> str:
        deadline = time.monotonic() + self._timeout
        while b"\n" not in self._received:
            if len(self._received) >= MAX_LINE:
                raise ConnectionError(f"an answer of {MAX_LINE} bytes or more")
            if (left := deadline - time.monotonic()) <= 0.0:
                raise TimeoutError(f"no whole answer within {self._timeout:g} s")
            self._socket.settimeout(left)
            piece = self._socket.recv(MAX_LINE)
            if not piece:
                raise ConnectionError("the instrument has closed the connection")
            self._received += piece
        line, _, self._received = self._received.partition(b"\n")
        return line.decode("ascii").strip()

    def close(self) -> None:
        self._socket.close()


class VisaTransport(Transport):
    """Any other VISA resource (USB, VXI-11), through the library pyvisa-py, which needs nothing of a vendor."""

    def __init__(self, resource: str, timeout: float) -> None:
        """Open `resource` (USB0::0x0957::0x2807::MY1::INSTR); every exchange takes at most `timeout` [s].

        Raises StressbotError BACKEND_FAILURE if PyVISA is not installed, UNSUPPORTED if the resource takes no text, and what PyVISA
        raises.
        """
        try:
            import pyvisa
            import pyvisa_py  # noqa: F401 # loaded by name later: better to miss it here
            from pyvisa.resources import MessageBasedResource
        except ImportError as error:
            raise StressbotError(
                ErrorCode.BACKEND_FAILURE,
                "backend",
                f"PyVISA is missing ({error}): install python3-pyvisa and python3-pyvisa-py",
            ) from error
        opened = pyvisa.ResourceManager("@py").open_resource(
            resource, timeout=round(1000 * timeout), open_timeout=round(1000 * timeout), read_termination="\n"
        )
        if not isinstance(opened, MessageBasedResource):
            opened.close()
            raise StressbotError(
                ErrorCode.UNSUPPORTED, "visa_resource", f"{resource} takes no messages: give the address of a generator"
            )
        self._resource = opened

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
