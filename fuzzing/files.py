"""Files: scenarios as driver and planner read them, swarm files of `calibrate`, plan files."""

import json
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import yaml
from hypothesis import strategies as st

from fuzzing import ROOT
from fuzzing.interface import Interface, outcome
from fuzzing.strategies import damaged, spliced
from stressbot_driver import bench
from stressbot_driver.ros.conversions import description_message
from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import _primitive, read_plan_file
from stressbot_planner.primitives.expansion import expand
from stressbot_planner.ros.conversion import scene_from_description

FOLDER = ROOT / "scenarios"
TEXTS = [path.read_text() for path in sorted(FOLDER.glob("*.yaml")) if path.stat().st_size < 4000]

FULL = {
    **yaml.safe_load((FOLDER / "paper-six-two-discs.yaml").read_text()),
    "length_unit": 1e-4,
    "workspace": {"x": [-50, 50], "y": [-50, 50]},
    "obstacles": [{"circle": {"center": [30, 30], "radius": 1.5}}, {"polygon": [[-40, -40], [-38, -40], [-39, -38]]}],
    "electrical": {
        **bench.ELECTRICAL_DEFAULTS,
        "thresholds": [20.0, 50.0, 75.0, 115.0],
        "codes": [[0, 0], [0, 1], [1, 0], [1, 1]],
    },
}
"""Every section that a scenario may have, but for the next two."""

ASSIGNED = {
    **FULL,
    "robots": [{**robot, "goal": "assign"} for robot in FULL["robots"]],
    "goals": [robot["goal"] for robot in FULL["robots"]],
}

CALIBRATED = {
    **FULL,
    "swarm": {
        **FULL["swarm"],
        "speed": [1.0] * 6,
        "turning_radius": [1.0, 1.01, 0.99, 1.0, 1.0, 1.0],
        "body_radius": [0.3] * 6,
        "groups": ["001", "010", "011", "100", "101", "110"],
    },
    "calibration": {
        "confidence": 0.95,
        "robots": [
            {
                "robot": k,
                "now": k,
                "speed": [1.0, 0.01],
                "turning_radius": [1.0, 0.01],
                "heading_bias": [0.0, 0.1],
                "selections": 9,
                "missed": 0,
            }
            for k in range(1, 7)
        ],
    },
}
"""As `calibrate` writes it."""

YAML_TOKENS = [
    "!!bool x",
    "!!int x",
    "!!int ''",
    "!!float x",
    "!!timestamp x",
    "!!timestamp 0001-01-01 00:00:00+23:59",
    "!!set {a}",
    "!!omap [a]",
    "!!pairs [a: b]",
    "!!binary x",
    "!!python/object:os.system",
    "!!null x",
    "!!str",
    "!<x>",
    "&a",
    "*a",
    "<<: ",
    "<<: [{a: 1}]",
    "? ",
    "{",
    "}",
    "[",
    "]",
    ": ",
    "- ",
    "\n",
    "\n  ",
    "\t",
    "|",
    ">",
    "'",
    '"',
    "\\x",
    "%YAML 1.3\n",
    "---\n",
    "...\n",
    "~",
    ".inf",
    ".nan",
    "1e-4",
    "0x1F",
    "0b1",
    "1:30",
    "2001-02-30",
    "1_000",
    "1e999",
    "=",
    "null",
    "{{}: 1}",
    "[[]: 1]",
    "\u2028",
    "\ufeff",
    "#",
    "assign",
    "parked",
]

JSON_TOKENS = [
    "NaN",
    "Infinity",
    "-Infinity",
    "1e999",
    "{",
    "}",
    "[",
    "]",
    ":",
    ",",
    '"',
    "\\ud800",
    "\\u0000",
    "null",
    "true",
    "[" * 2000,
    "1" * 5000,
    '"kind": "Orient"',
    '"robots": [1, 1]',
    '"excursion": 1e-9',
    '"group": 0',
    "\ufeff",
]

_scenario = scenario.load(FOLDER / "paper-six-two-discs.yaml")

PRIMITIVES = [
    {"kind": "Activate", "group": 1, "length": 1.0},
    {"kind": "Turn", "group": 2, "angle": 1.0, "excursion": 0.5},
    {"kind": "TurnAll", "angle": 0.5},
    {"kind": "Translate", "group": 1, "distance": -1.0, "excursion": 1.0},
    {"kind": "Orient", "robots": [1, 2, 3], "angles": [0.1, 0.2, 0.3]},
    {"kind": "Subgroup", "group": 1, "distance": 1.0, "inside": [2], "outside": [3]},
    {"kind": "Isolate", "robot": 4, "distance": 1.0, "group": 1},
    {"kind": "Extract", "robots": [4], "group": 1, "distance": 1.0},
]

PLAN = {
    "scenario": _scenario.name,
    "planner": "rrt",
    "seed": 1,
    "success": False,
    "primitives": PRIMITIVES[:1],
    "activations": [[1, 1.0]],
    "goals": _scenario.problem.goals.tolist(),
}


def _plans() -> st.SearchStrategy[str]:
    good = st.lists(st.sampled_from(PRIMITIVES), max_size=4).map(_plan_of)
    return st.one_of(good.flatmap(damaged).map(_json), spliced([json.dumps(_plan_of(PRIMITIVES[:k])) for k in (1, 8)], JSON_TOKENS))


def _plan_of(primitives: list[dict]) -> dict[str, Any]:
    """A plan file of some primitives, as `write_plan_file` has it."""
    values = [_primitive("primitives", item) for item in primitives]
    groups, lengths = expand(_scenario.swarm, values)
    pairs = [list(pair) for pair in zip(groups.tolist(), lengths.tolist(), strict=True)]
    return {**PLAN, "primitives": primitives, "activations": pairs}


def _json(data: Any) -> str:
    return json.dumps(data, default=str)


def as_yaml(data: Any) -> str:
    return yaml.dump(data, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper), sort_keys=False, allow_unicode=True)


def scenario_texts() -> st.SearchStrategy[str]:
    """Texts of scenario files, most of them nearly right."""
    return st.one_of(damaged(FULL).map(as_yaml), damaged(ASSIGNED).map(as_yaml), spliced(TEXTS, YAML_TOKENS))


def read_by_planner(text: str) -> str:
    """As `stressbot` reads a scenario."""
    return outcome(lambda: scenario.parse(text))


def read_by_driver(text: str) -> str:
    """As the driver reads a scenario, and as planner and sequencer read what it then tells of it."""
    return outcome(lambda: scene_from_description(description_message(bench.parse_bench(text))))


_scratch = Path(mkdtemp(prefix="stressbot-fuzz-"))


def written(content: bytes) -> Path:
    path = _scratch / "input"
    path.write_bytes(content)
    return path


def read_bytes(content: bytes) -> str:
    """Both readers on a file."""
    path = written(content)
    results = [outcome(lambda: scenario.load(path)), outcome(lambda: bench.load_bench(path))]
    return results[0]


def read_plan(text: str) -> str:
    """As `stressbot plot` reads a plan file: with its poses and clearance."""
    path = written(text.encode("utf-8", "surrogatepass"))

    def read() -> None:
        stored = read_plan_file(path, _scenario.problem, _scenario.name)
        assert stored.plan.poses.shape[1:] == (6, 3)

    return outcome(read)


INTERFACES = (
    Interface("scenario file, planner", scenario_texts(), read_by_planner, 3),
    Interface("scenario file, driver and its description", scenario_texts(), read_by_driver, 3),
    Interface(
        "swarm file of calibrate", damaged(CALIBRATED).map(as_yaml), lambda text: min(read_by_planner(text), read_by_driver(text))
    ),
    Interface(
        "scenario file, bytes",
        st.one_of(
            st.binary(max_size=80),
            spliced(TEXTS, YAML_TOKENS).map(lambda text: text.encode("utf-16" if len(text) % 2 else "utf-8", "replace")),
        ),
        read_bytes,
    ),
    Interface("plan file", _plans(), read_plan, 3),
)
