"""Everything, section after section, into one folder."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from stressbot_planner.execution.worker import warm_up
from stressbot_planner.formats import scenario
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reproduce import experiments, figures, published, switching, tables
from stressbot_planner.reproduce.experiments import Scale
from stressbot_planner.reproduce.progress import Display
from stressbot_planner.reproduce.report import Folder
from stressbot_planner.reproduce.runs import Record, Run, perform_all


def produce(output: Path, full: bool = False) -> None:
    """Run everything and write report.md, report.json, pictures, scenarios and plans into a folder."""
    begin = time.monotonic()
    folder = Folder(output, f"The paper, reproduced ({'full' if full else 'quick'})")
    with Display(sys.stdout) as show:
        _Production(folder, experiments.FULL if full else experiments.QUICK, show).all()
        show.say(f"results are in {output} ({time.monotonic() - begin:.0f} s)")


class _Production:
    """All sections, one after the other."""

    def __init__(self, folder: Folder, scale: Scale, show: Display):
        self.folder, self.scale, self.show = folder, scale, show

    def all(self) -> None:
        self.show.section("tables 1 and 2")
        self.folder.heading("Groups and brackets")
        self._table(tables.table_1(), tables.table_2())
        self.switching()
        self.show.section("compiling")
        warm_up()
        self.open_plane()
        self.discs()
        self.orders()
        self.growth()

    def switching(self) -> None:
        self.folder.heading("Switched and embedded system (section 3)")
        rows = switching.measure()
        self._table(tables.switching(rows))
        self.folder.picture(
            "switching", figures.switching(rows), "Error of activations that follow the embedded system, by the length of an epoch"
        )

    def open_plane(self) -> None:
        self.folder.heading("Open plane (section 6, EC1)")
        records = self._perform("table 3", experiments.table_3(self.scale))
        self._table(*tables.performance("Table 3, open plane", published.TABLE_3, records))
        titles = ("(a) Numerical optimisation", "(b) RRT with rotation", "(c) Original RRT")
        drawn = [
            figures.plan_panel(plan, title)
            for title, row in zip(titles, published.TABLE_3[:3], strict=True)
            if (plan := self._first(records, row.label))
        ]
        self._picture("ec1", drawn, 3, "EC1: (a) numerical optimisation, exact; (b) RRT with rotation; (c) original RRT")
        figure, measured = figures.primitive()
        lengths = "; ".join(f"{name}: path {path:.2f}, driving {time:.2f} s" for name, path, time in measured)
        self.folder.picture("primitive", figure, f"M(6, 2), the primitive of [h2, g1] moves robots 4 and 5 by 1. {lengths}")

    def discs(self) -> None:
        self.folder.heading("Two discs (section 6, EC2, EC1, IC3, IC4)")
        records = self._perform("table 4", experiments.table_4(self.scale))
        self._table(*tables.performance("Table 4, two discs", published.TABLE_4, records))
        cases = (("(a) EC2: pure control", "Pure control"), ("(b) EC1: RRT with rotation", "RRT with rotation"),
                 ("(c) IC3: parallel", "Subgroup parallel"))
        drawn = [figures.plan_panel(plan, title) for title, label in cases if (plan := self._first(records, label))]
        if record := _first_solved(records, "Subgroup sequential"):
            drawn += figures.subgroup_panels(self.folder.plan(record), record["subgroups"], "defghi")
        self._picture("discs", drawn, 3, "(a) EC2; (b) EC1; (c) IC3; (d) to (f) IC4, its subgroups in the order of the paper")

    def orders(self) -> None:
        self.folder.heading("Order of primitives")
        records = self._perform("order sweep", experiments.orders(self.scale))
        self._table(tables.orders(records))
        caption = "M(n, r): medians of solved runs; hollow: not all solved; no point: none solved, or refused"
        self.folder.picture("orders", figures.orders(records), caption)

    def growth(self) -> None:
        self.folder.heading("Growth")
        records = experiments.growth(self.scale, lambda runs: self._perform(f"growth, n = {_size(runs)}", runs))
        self._table(tables.growth(records))
        caption = "Growth: medians of solved runs; hollow: not all solved; a curve ends before the first n at which none was solved"
        self.folder.picture("growth", figures.growth(records), caption)

    def _perform(self, title: str, runs: Sequence[Run]) -> list[Record]:
        self.show.section(title, len(runs))
        records = perform_all(runs, self.show.record)
        self.folder.keep(runs, records)
        return records

    def _first(self, records: Sequence[Record], label: str) -> Plan | None:
        """Return the plan of the first solved run of a row, if there is one."""
        record = _first_solved(records, label)
        return None if record is None else self.folder.plan(record)

    def _table(self, *found) -> None:
        for table in found:
            self.folder.table(table)
            self.show.table(table)

    def _picture(self, name: str, drawn: list, columns: int, caption: str) -> None:
        if drawn:
            self.folder.picture(name, figures.panels(drawn, columns), caption)


def _first_solved(records: Sequence[Record], label: str) -> Record | None:
    return next((record for record in records if record["row"] == label and record["solved"]), None)


def _size(runs: Sequence[Run]) -> int:
    return scenario.parse(runs[0].text).swarm.n
