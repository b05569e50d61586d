"""The system's Chromium, and what of the page tests look at."""

import math
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

STRESSBOT = Path(__file__).parents[2] / ".venv/bin/stressbot"
ADDRESS = re.compile(r"^http://127\.0\.0\.1:\d+/\S*$", re.MULTILINE)
RESULTS = Path(__file__).parents[2] / "results/view"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
QUIET = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
DEADLINE = 120_000
"""ms for anything that should happen soon, on however busy a machine."""

PIXEL = 8.0
"""µm, at most, that the mouse misses a place by."""

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium")


@contextmanager
def browser() -> Iterator:
    """A browser of this machine's, which fetches nothing by itself."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield chromium
        chromium.close()


class Page:
    """A page in a window of its own.

    Attributes:
        asked_for: every address that it has loaded something from.
        errors: what went wrong in its scripts.
    """

    def __init__(self, chromium, address: str, width: int = 1280, height: int = 800):
        self.context = chromium.new_context(viewport={"width": width, "height": height}, offline=address.startswith("file:"))
        self.page = self.context.new_page()
        self.page.set_default_timeout(DEADLINE)
        self.asked_for, self.errors = [], []
        self.page.on("request", lambda request: self.asked_for.append(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda line: self.errors.append(line.text) if line.type == "error" else None)
        self.page.goto(address)

    def wait(self, condition: str) -> None:
        """Wait until an expression holds in the page; what it speaks of may not be there yet."""
        deadline = time.monotonic() + DEADLINE / 1000
        look = f"() => {{ try {{ return Boolean({condition}); }} catch (error) {{ return String(error); }} }}"
        while (answer := self.page.evaluate(look)) is not True:  # wait_for_function takes eval, which the page's policy forbids
            said = self.get("[state.status, state.said, state.moving, state.motion, plane.seen?.errors]")
            assert time.monotonic() < deadline, f"{condition} did not come, but {answer}: {said}"
            self.page.wait_for_timeout(50)

    def get(self, expression: str):
        """Return the value of an expression in the page."""
        return self.page.evaluate(expression)

    def click(self, name: str) -> None:
        """Press a button, once it can be pressed."""
        self.page.click(f"#{name}:enabled")

    def drag(self, row: int, x: float, y: float) -> None:
        """Drag a robot's goal to a place, µm, with the mouse; again if the page was laid out anew meanwhile."""
        self.wait("plane.onGoal && plane.seen?.swarm && plane.origin")
        for _ in range(30):
            self._drawn()
            self._drag_once(row, x, y)
            if math.dist(self.get(f"state.goals[{row}]"), (x, y)) < PIXEL:
                return
        raise AssertionError(f"the goal of row {row} does not follow: {self.get('state.goals')}")

    def _drag_once(self, row: int, x: float, y: float) -> None:
        at = "([x, y]) => { const box = byId('swarm').getBoundingClientRect();"
        at += " return [box.left + plane.x(x) / plane.ratio, box.top + plane.y(y) / plane.ratio]; }"
        begin = self.page.evaluate(at, self.get(f"state.goals[{row}]"))
        end = self.page.evaluate(at, [x, y])
        mouse = self.page.mouse
        mouse.move(*begin)
        mouse.down()
        mouse.move(*end, steps=4)
        mouse.up()

    def _drawn(self) -> None:
        """Wait until all has been drawn as it is now."""
        drawn = "requestAnimationFrame(() => requestAnimationFrame(done))"
        self.page.evaluate(f"() => new Promise((done) => {{ plane.stale(); draw(); {drawn}; }})")

    def picture(self, name: str) -> None:
        """Keep what is to be seen, once it has been drawn."""
        self._drawn()
        RESULTS.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=RESULTS / f"{name}.png")

    def close(self) -> None:
        """Close the window; nothing may have gone wrong in it."""
        self.context.close()
        assert not [error for error in self.errors if "WebSocket connection" not in error], self.errors


def serve(system, name, *words):
    """Start `stressbot view` on the nodes of a system and return its address."""
    system.processes.start(name, [str(STRESSBOT), "view", "--no-open", "--namespace", system.namespace, *words])
    return system.wait_for(lambda: ADDRESS.search(system.log(name)), "the address")[0]
