"""The scripts and notebooks of examples/ run, and the notebooks are stored with what they show."""

import os
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from notebooks import LARGEST, execute

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
DEADLINE = 550


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_every_script_runs_and_says_something(script, tmp_path):
    picture = tmp_path / "picture.png"
    arguments = [picture] if "[" in script.read_text(encoding="utf-8").split('"""')[1] else []
    done = subprocess.run([sys.executable, script, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) > 1
    assert not arguments or picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_every_notebook_runs_and_is_stored_with_its_outputs(path, monkeypatch, tmp_path):
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")
    stored, fresh = nbformat.read(path, as_version=4), execute(path)
    assert path.stat().st_size <= LARGEST
    assert [kinds(cell) for cell in stored.cells] == [kinds(cell) for cell in fresh.cells], "run `make notebook`"
    assert any("image/png" in kind for cell in stored.cells for kind in kinds(cell))


def kinds(cell) -> list[tuple[str, ...]]:
    """What a cell shows: types of its outputs. Their figures may differ from processor to processor."""
    return [tuple(sorted(output.get("data", {output["output_type"]: None}))) for output in cell.get("outputs", [])]


def test_there_are_scripts_and_notebooks():
    assert len(SCRIPTS) >= 2 and len(NOTEBOOKS) == 2
    assert all(os.access(path, os.R_OK) for path in SCRIPTS)
