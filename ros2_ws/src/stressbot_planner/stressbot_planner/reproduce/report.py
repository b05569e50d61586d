"""The folder of results: report.md, report.json, pictures, and every scenario and plan behind them."""

import json
import os
import platform
import re
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from matplotlib.figure import Figure

from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import read_plan_file, write_plan_file
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reproduce.runs import Record, Run
from stressbot_planner.reproduce.tables import Table
from stressbot_planner.system import files


class Folder:
    """A report that grows section by section; what is there is written at once, so that an early end loses little."""

    def __init__(self, path: Path, title: str):
        self.path = path
        self._markdown = [f"# {title}\n", _machine_line(), ""]
        self._json: dict = {"title": title, "machine": machine(), "tables": [], "runs": []}
        for name in ("plans", "instances"):
            files.make_folder(path / name)

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._markdown.append(f"## {text}\n")

    def table(self, table: Table) -> None:
        """Append a table."""
        self._markdown.append(table.markdown())
        self._json["tables"].append(vars(table))
        self._write()

    def picture(self, name: str, figure: Figure, caption: str) -> None:
        """Write a picture and append it."""
        with files.replacing(self.path / f"{name}.png") as stream:
            figure.savefig(stream, format="png")
        self._markdown.append(f"![{caption}]({name}.png)\n\n*{caption}*\n")
        self._write()

    def keep(self, runs: Sequence[Run], records: Sequence[Record]) -> None:
        """Write the scenario and the plan of each run; report.json names their files."""
        for run, record in zip(runs, records, strict=True):
            entry: Record = record | {"scenario_file": f"instances/{record['scenario']}.yaml"}
            files.write_text(self.path / entry["scenario_file"], run.text)
            plan = entry.pop("plan")
            if plan is not None:
                entry["plan_file"] = f"plans/{_slug(entry)}.json"
                write_plan_file(self.path / entry["plan_file"], plan)
            self._json["runs"].append(entry)
        self._write()

    def plan(self, record: Record) -> Plan:
        """Return the plan of a record that was kept."""
        loaded = scenario.load(self.path / "instances" / f"{record['scenario']}.yaml", record["tolerance"])
        return read_plan_file(self.path / "plans" / f"{_slug(record)}.json", loaded.problem, loaded.name).plan

    def _write(self) -> None:
        files.write_text(self.path / "report.md", "\n".join(self._markdown))
        files.write_text(self.path / "report.json", json.dumps(self._json, indent=1) + "\n")


def machine() -> dict:
    """Return what the figures depend on besides the code."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    packages = {name: version(name) for name in ("numpy", "scipy", "numba", "joblib")}
    return {"python": platform.python_version(), "processor": _processor(), "cores": os.cpu_count(), "load": load, **packages}


def _machine_line() -> str:
    here = machine()
    return (
        f"{here['processor']}, {here['cores']} cores, load {here['load']:.1f} at the start; "
        f"Python {here['python']}, numpy {here['numpy']}, scipy {here['scipy']}, numba {here['numba']}."
    )


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.machine()
    found = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return found.group(1).strip() if found else platform.machine()


def _slug(record: Record) -> str:
    order = f"-order-{record['order']}" if record["order"] else ""
    text = f"{record['section']}-{record['scenario']}-{record['planner']}-{record['objective']}{order}-seed-{record['seed']}"
    return re.sub(r"[^\w-]+", "-", text)
