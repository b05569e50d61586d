"""ROS domains that nobody else on this machine uses."""

import random
import socket
from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager

from stressbot_msgs.errors import ErrorCode, StressbotError

LAST = 101
"""Domains above use ports that Linux hands out to others."""


def reserve(last: int = LAST) -> tuple[int, socket.socket]:
    """Return a domain from 1 to `last` in which no participant is, at random, and what keeps others from it until it is closed.

    Two systems in one domain hear each other's topics: what one reports of its robots is of the other's.

    Raises:
        StressbotError: BUSY, every domain is taken.
    """
    for domain in random.sample(range(1, last + 1), last):
        hold = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            hold.bind(f"\0stressbot_domain_{domain}")  # a name without a file, which the kernel forgets with the process
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first:
                first.bind(("", _first_port(domain)))
        except OSError:
            hold.close()
            continue
        return domain, hold
    raise StressbotError(
        ErrorCode.BUSY, "ROS_DOMAIN_ID", f"is not set, and domains 1 to {last} are taken on this machine: set it to share one"
    )


@contextmanager
def reserved(environment: MutableMapping[str, str]) -> Iterator[None]:
    """Name a reserved domain in an environment that names none, and keep others from it meanwhile. Raises as `reserve`."""
    if "ROS_DOMAIN_ID" in environment:
        yield
        return
    domain, hold = reserve()
    with hold:
        environment["ROS_DOMAIN_ID"] = str(domain)
        yield


def _first_port(domain: int) -> int:
    """Of a domain's first participant, for discovery from one to one (RTPS 2.2, 9.6.1.1)."""
    return 7400 + 250 * domain + 10
