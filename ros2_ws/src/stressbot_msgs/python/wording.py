"""How messages quote what a user has written: on one line, short, and nothing that a terminal takes for an order."""

import re

LONGEST_QUOTE, LONGEST_WORD, LONGEST_SENTENCE = 60, 120, 1000
"""Characters at most: of a value that a message quotes, and of any word and of the whole whatever stands there."""


def printable(text: str) -> str:
    """Return text in which an escape stands for each character that is not printable, such as a line break."""
    return "".join(character if character.isprintable() else _escape(character) for character in text)


def shortened(text: str, most: int = LONGEST_QUOTE) -> str:
    """Return text of at most so many characters: of a longer one the beginning and the end."""
    head, tail = most // 2, (most - 1) // 2
    return text if len(text) <= most else f"{text[:head]}…{text[-tail:]}"


def quoted(text: str) -> str:
    """Return text as a message quotes it: shortened, printable, in single quotes."""
    return f"'{printable(shortened(text))}'"


def sentence(text: str) -> str:
    """Return a message on one line, printable, long words shortened."""
    text = re.sub(r"\S+", lambda word: shortened(word[0], LONGEST_WORD), shortened(text, LONGEST_SENTENCE))
    return printable(text)


def why_no_ros(error: Exception) -> tuple[str, str]:
    """Return what `rclpy.init` refuses, and what to change."""
    reason = str(error).splitlines()[0] if str(error) else repr(error)
    if folder := re.search("log directory '(.*?)'", reason):
        return "ROS_LOG_DIR", f"the folder {folder[1]} for logs cannot be made or written to: set ROS_LOG_DIR to one that can"
    return "--ros-args", f"{reason}: correct the command line"


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
