"""Tables of the report: the paper's values beside ours."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from stressbot_planner.model import allocation
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.brackets import bracket_robots
from stressbot_planner.reproduce import published
from stressbot_planner.reproduce.runs import Record
from stressbot_planner.reproduce.switching import Switching, order_of

LEAST_MEMORY_NOTED = 2e9


@dataclass(frozen=True)
class Table:
    """A title, a header, rows of text of the same width, and a note."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def markdown(self) -> str:
        """Return the table in Markdown, with columns aligned so that it can also be read as it is."""
        lines = [self.header, *self.rows]
        widths = [max(3, *(len(line[k]) for line in lines)) for k in range(len(self.header))]
        first, *rest = ("| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |" for line in lines)
        rule = "|" + "|".join("-" * (width + 2) for width in widths) + "|"
        note = f"\n{self.note}\n" if self.note else ""
        return "\n".join([f"### {self.title}\n", first, rule, *rest, note])


def table_1() -> Table:
    """Return who belongs to which group, and whether the paper says the same."""
    swarm = Swarm(1.0, 1.0, 0.3, allocation.binary(6))
    rows = []
    for group, paper in published.TABLE_1.items():
        ours = swarm.membership[group - 1].astype(int)
        rows.append((f"G{group}", *map(str, ours), _same(tuple(ours) == paper)))
    return Table("Table 1: groups of six robots", ("group", *(f"R{k}" for k in range(1, 7)), "paper"), tuple(rows))


def table_2() -> Table:
    """Return which robots each bracket moves, and whether the paper says the same."""
    rows = []
    for row in published.table_2(Swarm(1.0, 1.0, 0.3, allocation.binary(6))):
        robots = bracket_robots(row.first, row.second)
        rows.append((row.text, ", ".join(map(str, robots)), ", ".join(map(str, row.robots)), _same(robots == row.robots)))
    return Table("Table 2: robots that a Lie bracket moves", ("bracket", "ours", "paper", "verdict"), tuple(rows))


def switching(rows: Sequence[Switching]) -> Table:
    """Return how far activations end from the embedded system, for both cycles and ever shorter epochs."""
    plain, symmetric = ([row for row in rows if row.symmetric == wanted] for wanted in (False, True))
    lines = [
        (
            str(one.epochs), f"{one.epoch_length:.4f}", str(one.activations), f"{one.error:.2e}", str(two.activations),
            f"{two.error:.2e}",
        )
        for one, two in zip(plain, symmetric, strict=True)
    ]
    header = ("epochs", "length", "G1 … Gm: activations", "error", "G1 … Gm … G1: activations", "error")
    note = f"- order in the length of an epoch: {order_of(plain):.2f} and {order_of(symmetric):.2f}; headings agree to round-off"
    return Table("Activations that follow the embedded system", header, tuple(lines), note)


def performance(title: str, rows: Sequence[published.Row], records: Sequence[Record]) -> list[Table]:
    """Return two tables of records by row: how plans were found, and the plans."""
    found, plans = [], []
    for row in rows:
        mine = [record for record in records if record["row"] == row.label]
        solved = [record for record in mine if record["solved"]]
        times = statistics(record["planning_time"] for record in solved)
        found.append((
            row.label, row.planner, row.solved or "–", f"{len(solved)}/{len(mine)}", number(row.time), *times,
            number(row.nodes), statistics((record["nodes"] for record in solved), 0)[0], _seeds(mine),
        ))
        plans.append((
            row.label,
            number(row.path), *statistics(r["path_length"] for r in solved), ratio(solved, "path_length"),
            number(row.execution), *statistics(r["execution_time"] for r in solved), ratio(solved, "execution_time"),
            statistics((r["activations"] for r in solved), 0)[0],
        ))
    header = (
        "row", "planner", "paper: solved", "solved", "paper: time (s)", "median", "mean", "max", "paper: nodes", "nodes", "seeds",
    )
    plan_header = (
        "row", "paper: path", "median", "mean", "max", "÷ bound",
        "paper: execution (s)", "median", "mean", "max", "÷ bound", "activations",
    )
    return [
        Table(f"{title}: planning", header, tuple(found), _notes(records)),
        Table(f"{title}: plans", plan_header, tuple(plans)),
    ]


def orders(records: Sequence[Record]) -> Table:
    """Return the sweep over the order of primitives."""
    rows = []
    for key in _keys(records, "scenario", "row", "order"):
        mine = _of(records, key, "scenario", "row", "order")
        rows.append((key[0], key[1], f"M({mine[0]['n']}, {key[2]})", *_figures(mine)))
    header = ("instance", "planner", "problem", *_FIGURES)
    return Table("Order sweep: M(n, r)", header, tuple(rows), _notes(records))


def growth(records: Sequence[Record]) -> Table:
    """Return how everything grows with the number of robots."""
    rows = []
    for key in sorted(_keys(records, "section", "row", "n")):
        mine = _of(records, key, "section", "row", "n")
        memory = max((record["peak_memory"] or 0 for record in mine), default=0)
        rows.append((
            "discs" if key[0].endswith("discs") else "open", key[1], str(key[2]), *_figures(mine),
            f"{memory / 1e6:.0f}{' (!)' if memory > LEAST_MEMORY_NOTED else ''}" if memory else "–",
        ))
    header = ("plane", "planner", "n", *_FIGURES, "memory (MB)")
    return Table("Growth with the number of robots", header, tuple(rows), _notes(records))


_FIGURES = (
    "solved", "time (s): median", "max", "path", "÷ bound", "execution (s)", "÷ bound", "nodes", "activations",
)


def _figures(records: Sequence[Record]) -> tuple[str, ...]:
    solved = [record for record in records if record["solved"]]
    if records and all(record["refused"] for record in records):
        return ("refused", *["–"] * (len(_FIGURES) - 1))
    time = statistics(record["planning_time"] for record in solved)
    return (
        f"{len(solved)}/{len(records)}", time[0], time[2],
        statistics(r["path_length"] for r in solved)[0], ratio(solved, "path_length"),
        statistics(r["execution_time"] for r in solved)[0], ratio(solved, "execution_time"),
        statistics((r["nodes"] for r in solved), 0)[0], statistics((r["activations"] for r in solved), 0)[0],
    )


def statistics(values: Iterable[float | None], digits: int = 2) -> tuple[str, str, str]:
    """Return median, mean and maximum as text."""
    known = [value for value in values if value is not None]
    if not known:
        return ("–", "–", "–")
    median, mean, largest = (f"{value:.{digits}f}" for value in (np.median(known), np.mean(known), np.max(known)))
    return median, mean, largest


def ratio(records: Sequence[Record], figure: str) -> str:
    """Return the median of a figure over its lower bound."""
    return statistics(r[figure] / r["lower_bounds"][figure] for r in records if r["lower_bounds"][figure] > 0)[0]


def number(value: float | None) -> str:
    """Return a published value as text."""
    return "–" if value is None else f"{value:.2f}"


def _same(is_same: bool) -> str:
    return "same" if is_same else "DIFFERS"


def _seeds(records: Sequence[Record]) -> str:
    seeds = sorted({record["seed"] for record in records})
    if len(seeds) < 2:
        return str(seeds[0]) if seeds else "–"
    return f"{seeds[0]}–{seeds[-1]}"


def _keys(records: Sequence[Record], *names: str) -> list[tuple]:
    return list(dict.fromkeys(tuple(record[name] for name in names) for record in records))


def _of(records: Sequence[Record], key: tuple, *names: str) -> list[Record]:
    return [record for record in records if tuple(record[name] for name in names) == key]


def _notes(records: Sequence[Record]) -> str:
    """Return the limit, what was refused, and what was not solved, each once."""
    lines = []
    limits = sorted({record["time_limit"] for record in records})
    if limits:
        lines.append(
            f"Seeds: {_seeds(records)}. Time limit: {', '.join(f'{limit:g}' for limit in limits)} s of processor time; a run that "
            "exceeds it counts as failed. Statistics are over solved runs, as the paper's are."
        )
    refused = [record for record in records if record["refused"]]
    lines += [f"{row} refuses: {reason}" for row, reason in dict.fromkeys((r["row"], r["reason"]) for r in refused)]
    failed = [record for record in records if not record["solved"] and not record["refused"]]
    for row, scenario in _keys(failed, "row", "scenario"):
        reason = _of(failed, (row, scenario), "row", "scenario")[0]["reason"]
        lines.append(f"{row} on {scenario}, not solved: {reason if len(reason) <= 120 else reason[:117] + '…'}")
    return "\n".join(f"- {line}" for line in lines)
