"""Numbers on the command line, refused in the caller's words."""

import argparse
import math

from stressbot_planner.system import streams


def number(text: str, wanted: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"is '{text}': give {wanted}") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"is {value}: give a finite number")
    return value


def positive(text: str) -> float:
    value = number(text, wanted := "a number greater than 0")
    if value <= 0:
        raise argparse.ArgumentTypeError(f"is {value}: give {wanted}")
    return value


def not_negative(text: str) -> float:
    value = number(text, wanted := "a number of 0 or more")
    if value < 0:
        raise argparse.ArgumentTypeError(f"is {value}: give {wanted}")
    return value


def seed(text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 18:
        raise argparse.ArgumentTypeError(f"is '{text}': give a whole number from 0 to 10^18 - 1")
    return int(text)


def order(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 1 <= int(text[:9]) <= 99:
        raise argparse.ArgumentTypeError(f"is '{text}': give a whole number from 1")
    return int(text)


def count(text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 9 or int(text) < 1:
        raise argparse.ArgumentTypeError(f"is '{text}': give a whole number from 1")
    return int(text)


def whole(text: str) -> int:
    return 0 if text == "0" else count(text)


def usable_jobs(asked: int, work: str) -> int:
    """Return how many processes of those asked for can work side by side, and say so where these are fewer."""
    from stressbot_planner import planners

    jobs = planners.usable_jobs(asked)
    if jobs < asked:
        streams.complain("stressbot", f"--jobs: is {asked}, more than there are processors: {jobs} {work}")
    return jobs
