"""The pages in docs/ name what exists, and their examples work."""

import pkgutil
import re
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import get_args

import pytest
from stressbot_msgs import scenario_text

from stressbot_planner.errors import ErrorCode
from stressbot_planner.formats import scenario
from stressbot_planner.primitives.expansion import Primitive

ROOT = Path(__file__).resolve().parents[4]
DOCS = ROOT / "docs"
PAPER = DOCS / "paper.md"


@cache
def test_names() -> frozenset[str]:
    paths = [*ROOT.glob("ros2_ws/src/*/test/**/test_*.py"), *ROOT.glob("tests/**/test_*.py")]
    return frozenset(name for path in paths for name in re.findall(r"^\s*def (test_\w+)", path.read_text(), re.MULTILINE))


test_names.__test__ = False


def quoted(path: Path) -> list[str]:
    return re.findall(r"`([^`\n]+)`", path.read_text())


@pytest.mark.parametrize("name", sorted({name for name in quoted(PAPER) if re.fullmatch(r"test_\w+", name)}))
def test_every_test_that_the_paper_page_names_exists(name):
    assert name in test_names()


@pytest.mark.parametrize("name", sorted({name for name in quoted(PAPER) if re.fullmatch(r"[a-z_]+(\.[A-Za-z_]+)+", name)}))
def test_every_function_that_the_paper_page_names_exists(name):
    if not name.endswith((".yaml", ".md")):
        pkgutil.resolve_name(f"stressbot_planner.{name}")


def test_the_paper_page_leaves_no_claim_without_evidence():
    text = PAPER.read_text()
    assert len({name for name in quoted(PAPER) if name.startswith("test_")}) > 40
    for line in text[text.index("## Errata") :].splitlines():
        if line.startswith("|") and not line.startswith(("|---", "| the paper says", "| printed")):
            assert "`test_" in line or "planned" in line, line


def test_the_paper_page_says_where_the_paper_is_found():
    assert "WAFR) 2024" in PAPER.read_text()
    assert "arXiv:2406.13829" in PAPER.read_text()


@pytest.mark.parametrize("path", sorted(DOCS.glob("*.md")), ids=lambda path: path.name)
def test_links_lead_somewhere(path):
    for target in re.findall(r"\]\(([^)#:]+)\)", path.read_text()):
        assert (path.parent / target).exists(), target


@pytest.mark.parametrize("path", [*DOCS.glob("*.md"), *DOCS.glob("tutorials/*.md")], ids=lambda path: path.name)
def test_lines_are_short(path):
    """Rows of tables and pictures cannot be wrapped."""
    lines = path.read_text().splitlines()
    assert not [line for line in lines if len(line) > 120 and not line.startswith(("|", "!["))]


def test_every_measurement_has_its_date_commit_machine_and_command():
    _, *sections = re.split(r"^## ", (DOCS / "measurements.md").read_text(), flags=re.MULTILINE)
    assert len(sections) > 8
    head = re.compile(
        r".*\n\n\| date \| commit \| machine \| command \|\n\|---\|---\|---\|---\|\n\| .*\b20\d\d\b.* \| .*\b[0-9a-f]{7}\b"
    )
    for section in sections:
        assert head.match(section), section[:200]


def test_decision_records_are_numbered_in_a_row():
    records = sorted(DOCS.joinpath("decisions").glob("*.md"))
    assert [path.name[:5] for path in records] == [f"{number:04d}-" for number in range(1, len(records) + 1)]


def test_the_examples_of_the_scenario_page_load():
    page = (DOCS / "scenario-file.md").read_text()
    example, goals, headings, parked, stages, contacts = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert scenario.parse(example).swarm.n == 2
    assert scenario.parse(example[: example.index("robots:")] + headings).problem.headed.tolist() == [0]
    assert scenario.parse(example[: example.index("robots:")] + goals).problem.exchangeable == (0, 2)
    assert scenario.parse(example[: example.index("swarm:")] + parked).problem.parked == (0,)
    assert scenario.parse(example[: example.index("robots:")] + stages).problem.waypoints.shape == (2, 2, 2)
    assert scenario.parse(example[: example.index("robots:")] + contacts).problem.contacts == ((0, 1),)


def test_codes_on_the_file_pages_exist():
    known = {code.name for code in ErrorCode}
    for name in ("scenario-file.md", "plan-file.md"):
        words = set(re.findall(r"\b[A-Z]+(?:_[A-Z]+)+\b", (DOCS / name).read_text()))
        assert words <= known
        assert len(words) >= 6


def test_the_plan_page_lists_every_primitive_with_its_fields():
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*?) \|", (DOCS / "plan-file.md").read_text(), re.MULTILINE))
    for kind in get_args(Primitive):
        wanted = {entry.name for entry in fields(kind)} - {"excursion"}
        assert set(re.findall(r"`(\w+)`", rows[kind.__name__])) == wanted


def test_the_scenario_page_lists_every_field_of_the_schema():
    text = (DOCS / "scenario-file.md").read_text()
    schema = scenario_text.schema()["properties"]
    for name in schema:
        assert f"`{name}" in text
    for name in schema["swarm"]["properties"]:
        assert f"`swarm.{name}`" in text
