"""The grammar of SCPI as an instrument reads it: messages, headers in long and short form, parameters.

Shares nothing with what the driver sends from: the emulator is to understand the wire, not the sender.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

MAX_LINE = 100_000  # [bytes] of a message without its blocks
MAX_MESSAGE = 64_000_000  # [bytes]

ERRORS = {
    -101: "Invalid character",
    -102: "Syntax error",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -113: "Undefined header",
    -114: "Header suffix out of range",
    -121: "Invalid character in number",
    -151: "Invalid string data",
    -161: "Invalid block data",
    -200: "Execution error",
    -211: "Trigger ignored",
    -221: "Settings conflict",
    -222: "Data out of range",
    -223: "Too much data",
    -224: "Illegal parameter value",
    -350: "Queue overflow",
    -363: "Input buffer overrun",
    # Of the instrument: the first two as in this maker's E1441A, the last as seen on a 33600A.
    783: "Arb waveform name too long",
    785: "Specified arb waveform does not exist",
    880: "Arb: Out of memory",
}


class ScpiError(Exception):
    """Goes into the error queue."""

    def __init__(self, number: int, detail: str = "") -> None:
        super().__init__(number, detail)
        self.number = number
        self.detail = detail

    def __str__(self) -> str:
        text = ERRORS[self.number] + (f"; {self.detail}" if self.detail else "")
        return f'{self.number:+d},"{text}"'


class Reader:
    """Cuts a stream of bytes into messages. A definite-length block may hold any byte, line feeds too."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._scanned = 0
        self._blocks = 0  # [bytes] of blocks in what was scanned
        self._quote = 0

    def feed(self, data: bytes) -> list[bytes | ScpiError]:
        """Messages that `data` completes, without their line feeds, and errors of what cannot become one."""
        self._data += data
        found: list[bytes | ScpiError] = []
        while (message := self._next()) is not None:
            found.append(message)
        return found

    def _next(self) -> bytes | ScpiError | None:
        data = self._data
        while self._scanned < len(data):
            byte = data[self._scanned]
            if byte == 0x0A:
                message = bytes(data[: self._scanned])
                self._drop(self._scanned + 1)
                return message.rstrip(b"\r")
            if self._quote:
                if byte == self._quote:
                    self._quote = 0
            elif byte in b"\"'":
                self._quote = byte
            elif byte == 0x23:  # '#'
                size = _block_size(data, self._scanned)
                if size is None:
                    return None
                if size > MAX_MESSAGE:
                    self._drop(len(data))
                    return ScpiError(-223)
                if self._scanned + size > len(data):
                    return None
                self._scanned += size
                self._blocks += size
                continue
            self._scanned += 1
            if self._scanned - self._blocks > MAX_LINE:
                self._drop(len(data))
                return ScpiError(-363)
        return None

    def _drop(self, count: int) -> None:
        del self._data[:count]
        self._scanned = self._blocks = self._quote = 0


def _block_size(data: bytes | bytearray, start: int) -> int | None:
    """Bytes of the block at `start`, header included; 1 if it is none; None if too little has come to know."""
    if start + 1 >= len(data):
        return None
    digits = data[start + 1] - 0x30
    if not 1 <= digits <= 9:
        return 1
    if start + 2 + digits > len(data):
        return None
    length = bytes(data[start + 2 : start + 2 + digits])
    if not length.isdigit():
        return 1
    return 2 + digits + int(length)


def split(message: bytes, separator: int) -> list[bytes]:
    """Parts of a message between separators outside of strings and blocks. Raises ScpiError."""
    parts, begin, position, quote = [], 0, 0, 0
    while position < len(message):
        byte = message[position]
        if quote:
            if byte == quote:
                quote = 0
        elif byte in b"\"'":
            quote = byte
        elif byte == 0x23:
            size = _block_size(message, position)
            if size is None or position + size > len(message):
                raise ScpiError(-161)
            position += size
            continue
        elif byte == separator:
            parts.append(message[begin:position])
            begin = position + 1
        position += 1
    if quote:
        raise ScpiError(-151)
    parts.append(message[begin:])
    return parts


@dataclass(frozen=True)
class Unit:
    """One command or query with its parameters."""

    header: str
    parameters: tuple[bytes, ...]


def parse_units(message: bytes) -> list[Unit]:
    """Commands of a message. Those after a semicolon begin anew with ':' or '*'. Raises ScpiError."""
    units = []
    for index, part in enumerate(split(message, 0x3B)):
        part = part.strip(b" \t")
        if not part:
            if index:
                raise ScpiError(-102)
            continue
        header, _, rest = part.partition(b" ")
        if not re.fullmatch(rb"[:*]?[A-Za-z][A-Za-z0-9_:]*\??", header):
            raise ScpiError(-101 if re.search(rb"[^\x21-\x7e]", header) else -113)
        if index and not header.startswith((b":", b"*")):
            raise ScpiError(-113, "begin the next command with a colon")
        rest = rest.strip(b" \t") if b"#" not in rest else rest.lstrip(b" \t")
        parameters = tuple(split(rest, 0x2C)) if rest else ()
        units.append(Unit(header.decode().removeprefix(":"), parameters))
    return units


@cache
def header_pattern(header: str) -> re.Pattern[str]:
    """What a header such as "[SOURce#:]FUNCtion[:SHAPe]" matches, in long or short form; # is an optional number."""

    signs = {"[": "(?:", "]": ")?", "*": r"\*", "?": r"\?"}

    def token(match: re.Match[str]) -> str:
        word = match.group(0)
        if word in signs:
            return signs[word]
        name = word.removesuffix("#")
        suffix = r"(?P<suffix>\d*)" if name != word else ""
        return f"(?:{name}|{short_form(name)}){suffix}"

    return re.compile(re.sub(r"[A-Za-z]+#?|[][*?]", token, header), re.IGNORECASE)


def short_form(name: str) -> str:
    """SOUR of SOURce."""
    return "".join(letter for letter in name if not letter.islower())


def number(parameter: bytes, names: dict[str, Callable[[], float]] | None = None) -> float:
    """A decimal number, or one that has a name such as MAXimum. Raises ScpiError."""
    text = parameter.strip().decode("latin-1")
    for name, value in (names or {}).items():
        if is_word(text, name):
            return value()
    if re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", text):
        return float(text)
    raise ScpiError(-121 if re.match(r"[+-]?\.?\d", text) else -104)


def is_word(text: str, name: str) -> bool:
    """Whether `text` is the long or the short form of `name`."""
    return text.upper() in (name.upper(), short_form(name))


def choice(parameter: bytes, *names: str) -> str:
    """The short form of one of `names`. Raises ScpiError."""
    text = parameter.strip().decode("latin-1")
    for name in names:
        if is_word(text, name):
            return short_form(name)
    raise ScpiError(-224)


def boolean(parameter: bytes) -> bool:
    """ON, OFF, 1 or 0. Raises ScpiError."""
    text = parameter.strip().upper()
    if text in (b"ON", b"1"):
        return True
    if text in (b"OFF", b"0"):
        return False
    raise ScpiError(-224)


def label(parameter: bytes) -> str:
    """A name, quoted or not. Raises ScpiError."""
    text = parameter.strip().decode("latin-1")
    match = re.fullmatch(r"""(["']?)([A-Za-z0-9_]+)\1""", text)
    if not match:
        raise ScpiError(-151)
    return match.group(2)


def block(parameter: bytes) -> bytes:
    """The content of a definite-length block. Raises ScpiError."""
    parameter = parameter.lstrip(b" ")
    size = _block_size(parameter, 0) if parameter.startswith(b"#") else None
    if size is None or size == 1:
        raise ScpiError(-161 if parameter.startswith(b"#") else -104)
    if parameter[size:].strip():
        raise ScpiError(-161)
    return parameter[2 + parameter[1] - 0x30 : size]
