"""What is true now, one word a kind: whoever looks later sees the same, and who is slow misses what is old."""

import json
import threading
from collections.abc import Callable
from typing import Any


class Board:
    """Holds the newest content of each kind. Any thread may put and read; contents are plain data that nobody changes."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._contents: dict[str, Any] = {}
        self._texts: dict[str, str] = {}
        self._listeners: set[Callable[[str], None]] = set()

    def put(self, kind: str, content: Any, quietly: bool = False) -> None:
        """Put a content in the place of the one before, and tell the listeners its kind, on this thread, unless quietly."""
        with self._lock:
            self._contents[kind] = content
            self._texts.pop(kind, None)
            listeners = [] if quietly else list(self._listeners)
        for listener in listeners:
            listener(kind)

    def get(self, kind: str) -> Any:
        """Return a content, or None."""
        with self._lock:
            return self._contents.get(kind)

    def kinds(self) -> list[str]:
        """Return the kinds that there are, in the order in which they came first."""
        with self._lock:
            return list(self._contents)

    def text(self, kind: str) -> str:
        """Return a content as JSON, with its kind; it is made once, and only if somebody reads it."""
        with self._lock:
            content, text = self._contents[kind], self._texts.get(kind)
        if text is None:
            text = f'{{"kind":{json.dumps(kind)},"is":{compact(content)}}}'
            with self._lock:
                if self._contents[kind] is content:
                    self._texts[kind] = text
        return text

    def listen(self, listener: Callable[[str], None]) -> None:
        """Tell a listener the kind of whatever is put from now on. It must return at once."""
        with self._lock:
            self._listeners.add(listener)

    def forget(self, listener: Callable[[str], None]) -> None:
        """Tell a listener nothing any more."""
        with self._lock:
            self._listeners.discard(listener)


def compact(content: Any) -> str:
    """Return plain data as JSON without spaces; numbers that are not finite raise ValueError."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False)
