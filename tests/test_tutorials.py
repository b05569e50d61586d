"""Every block of a tutorial works as it stands: files are written, commands run in order, and what they say is what the page shows.

A block with a title is a file. A block of bash is run. A block of text after it is what that prints: `…` stands for anything
within a line, and alone in a line for any lines.
"""

import contextlib
import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.md"))
BLOCK = re.compile(r'^```(\w*)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
DEADLINE = 550
END = "--- end of block"


@dataclass
class Step:
    """A command, and what its page says that it prints."""

    command: str
    printed: str = ""


def steps_of(page: Path) -> list[Step]:
    steps: list[Step] = []
    for kind, title, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if title:
            steps.append(Step(f"cat >'{title}' <<'END OF FILE'\n{text}END OF FILE\n"))
        elif kind == "bash":
            steps.append(Step(text))
        else:
            assert kind == "text" and not steps[-1].printed, f"{page.name}: a block of {kind or 'nothing'} that nobody tries"
            steps[-1].printed = text
    return steps


def pattern(printed: str) -> str:
    """Return the regular expression of a block of text."""
    lines = (
        r"(?:.*\n)*?" if line == "…" else ".*?".join(map(re.escape, line.split("…"))) + r"[ ]*\n" for line in printed.splitlines()
    )
    return "".join(lines)


def run(script: str, folder: Path, **environment: str) -> str:
    """Return what a script of bash prints; whatever it has started ends with it."""
    with open(folder / "output", "w+", encoding="utf-8") as output:
        process = subprocess.Popen(
            ["bash", "-c", script], cwd=folder, env=os.environ | environment, stdin=subprocess.DEVNULL, stdout=output,
            stderr=subprocess.STDOUT, start_new_session=True,
        )
        try:
            code = process.wait(DEADLINE)
        finally:
            end_session(process.pid)
        output.seek(0)
        text = output.read()
    assert code == 0, text
    return text


def end_session(leader: int) -> None:
    """End what a shell with job control has left behind; each of its jobs is a group of its own."""
    for process in psutil.process_iter():
        with contextlib.suppress(ProcessLookupError, psutil.NoSuchProcess):
            if os.getsid(process.pid) == leader:
                process.kill()


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda path: path.stem)
def test_every_block_works(page, tmp_path):
    for path in ROOT.iterdir():
        if path.name != "results":
            (tmp_path / path.name).symlink_to(path)
    steps = steps_of(page)
    assert len(steps) > 5
    script = "set -e -m\n" + "".join(f"{step.command}\necho '{END}'\n" for step in steps)
    outputs = run(script, tmp_path, COLUMNS="100").split(f"{END}\n")
    for step, output in zip(steps, outputs, strict=False):
        if step.printed:
            assert re.fullmatch(pattern(step.printed), output), f"{step.command}printed\n{output}"


def test_text_that_is_not_printed_is_noticed():
    assert re.fullmatch(pattern("a … c\n…\nd\n"), "a b c\nx\ny\nd\n")
    assert not re.fullmatch(pattern("a … c\n"), "a b d\n")
    assert not re.fullmatch(pattern("a\nc\n"), "a\nb\nc\n")


def test_there_are_five_tutorials():
    assert {page.stem for page in TUTORIALS} == {"first-plan", "own-scenario", "own-planner", "bench", "closed-loop"}
