"""How large a compressed picture is, by its first bytes: before anything is decoded, which a few bytes may ask gigabytes for."""

from collections.abc import Sequence

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"
_BARE = {0x01, *range(0xD0, 0xD9)}
"""Markers of JPEG without a length."""

_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of JPEG that begin a frame, and say its size."""

_MOST_SEGMENTS = 1000
"""Before the frame."""


def picture_size(data: Sequence[int]) -> tuple[int, int] | None:
    """Return width and height, pixels, of a JPEG or PNG; None if it is none."""
    if bytes(data[:8]) == _PNG:
        size = _number(data[16:20]), _number(data[20:24])
        return size if len(data) >= 24 and all(size) else None
    return _size_of_jpeg(data) if bytes(data[:2]) == _JPEG else None


def _size_of_jpeg(data: Sequence[int]) -> tuple[int, int] | None:
    at = 2
    for _ in range(_MOST_SEGMENTS):
        if at + 4 > len(data) or data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker in _FRAMES:
            height, width = _number(data[at + 5 : at + 7]), _number(data[at + 7 : at + 9])
            return (width, height) if width and height else None
        at += 1 if marker == 0xFF else 2 if marker in _BARE else 2 + _number(data[at + 2 : at + 4])
    return None


def _number(data: Sequence[int]) -> int:
    return int.from_bytes(bytes(data), "big")
