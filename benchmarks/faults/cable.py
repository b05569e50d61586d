"""A cable between two network devices that loses, doubles, delays and so reorders packets. Each line of stdin says how much.

    python cable.py FD FD
"""

import heapq
import os
import random
import select
import sys
import time
from contextlib import suppress

LONGEST = 65536


def main() -> None:
    """Hand packets on until stdin ends."""
    ends = int(sys.argv[1]), int(sys.argv[2])
    other = dict(zip(ends, reversed(ends), strict=True))
    rng, number = random.Random(0), 0
    loss = doubled = delay = 0.0
    waiting: list[tuple[float, int, int, bytes]] = []  # when, order, to which end, packet
    while True:
        patience = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        ready, _, _ = select.select([sys.stdin, *ends], [], [], patience)
        for end in ready:
            if end is sys.stdin:
                if not (line := sys.stdin.readline()):
                    return
                loss, doubled, delay = map(float, line.split())
                continue
            with suppress(BlockingIOError, OSError):
                packet = os.read(end, LONGEST)
                for _ in range((rng.random() >= loss) * (1 + (rng.random() < doubled))):
                    number += 1
                    heapq.heappush(waiting, (time.monotonic() + delay * rng.random(), number, other[end], packet))
        while waiting and waiting[0][0] <= time.monotonic():
            _, _, end, packet = heapq.heappop(waiting)
            with suppress(OSError):  # a device that is down
                os.write(end, packet)


if __name__ == "__main__":
    main()
