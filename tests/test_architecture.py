"""docs/architecture.md holds true: its pictures are the imports, its tables the folders; and no class name means two things."""

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
PACKAGES = ("stressbot_planner", "stressbot_driver")

UNRELATED = {"Entry"}
"""What the emulated instrument is told has the name that its manual gives it; the emulator knows nothing of who speaks to it."""


def sources(package):
    base = ROOT / "ros2_ws/src" / package / package
    modules = {".".join((package, *path.relative_to(base).with_suffix("").parts)): path for path in base.rglob("*.py")}
    return {module.removesuffix(".__init__"): path for module, path in modules.items()}


def room(module):
    return module.split(".")[1] if "." in module else module


def imports(package):
    """Room -> the rooms of the same package that it imports."""
    modules, arrows = sources(package), defaultdict(set)
    for module, path in modules.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names = [full if (full := f"{node.module}.{alias.name}") in modules else node.module for alias in node.names]
            for name in names:
                if name.startswith(f"{package}.") and module != package and room(name) != room(module):
                    arrows[room(module)].add(room(name))
    return arrows


def reduced(arrows):
    """The arrows without those that a longer way implies (transitive reduction)."""

    def reached(begin, without):
        seen, left = set(), [end for end in arrows[begin] if end != without]
        while left:
            at = left.pop()
            if at not in seen:
                seen.add(at)
                left += arrows[at]
        return seen

    return {(begin, end) for begin in list(arrows) for end in arrows[begin] if end not in reached(begin, end)}


def drawn(package):
    block = re.search(rf"%% {package}\n(.*?)```", PAGE, re.S)[1]
    return {(begin, end) for begin, ends in re.findall(r"^ *(\w+) --> ([\w &]+)$", block, re.M) for end in ends.split(" & ")}


@pytest.mark.parametrize("package", PACKAGES)
def test_the_picture_is_the_imports(package):
    found = reduced(imports(package))
    ends = defaultdict(list)
    for begin, end in sorted(found):
        ends[begin].append(end)
    picture = "\n".join(f"    {begin} --> {' & '.join(those)}" for begin, those in ends.items())
    assert drawn(package) == found, f"docs/architecture.md, {package}:\n{picture}"


@pytest.mark.parametrize("package", PACKAGES)
def test_rooms_have_no_circle(package):
    arrows = imports(package)
    order = {}

    def height(at, above=()):
        assert at not in above, f"circle: {' -> '.join((*above, at))}"
        if at not in order:
            order[at] = 1 + max((height(end, (*above, at)) for end in arrows[at]), default=0)
        return order[at]

    assert max(height(at) for at in list(arrows)) <= 10


@pytest.mark.parametrize("package", PACKAGES)
def test_the_table_names_every_room(package):
    rooms = {room(module) for module in sources(package)} - {package}
    table = PAGE.split(f"### {package}")[1].split("###")[0]
    assert set(re.findall(r"^\| `(\w+?)(?:/|\.py)` \|", table, re.M)) == rooms


def test_each_word_leads_to_a_module_that_says_it():
    rows = re.findall(r"^\| ([^|`]+) \| (`[^|]+) \|$", PAGE.split("## Where to look")[1], re.M)
    assert len(rows) >= 20
    for words, places in rows:
        for place in re.findall(r"`([^`]+)`", places):
            found = [path for base in PACKAGES if (path := ROOT / "ros2_ws/src" / base / base / place).exists()]
            assert found, f"{words}: {place} is not there"
        files = [found[0]] if found[0].is_file() else found[0].rglob("*.py")
        texts = [path.read_text(encoding="utf-8") for path in files]
        first = re.split("[,:]| [(]", words)[0].strip().lower().replace("-", " ")
        assert any(first in re.sub(r"[-_\s]+", " ", text.lower()) for text in texts), f"{places} does not say {first!r}"


@pytest.mark.parametrize("package", PACKAGES)
def test_no_class_name_means_two_things(package):
    homes = defaultdict(set)
    for module, path in sources(package).items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].add(module)
    assert not {name: where for name, where in homes.items() if len(where) > 1 and name not in UNRELATED}
