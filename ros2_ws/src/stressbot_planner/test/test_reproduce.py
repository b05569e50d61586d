"""The report: instances, runs, tables, figures, and the command that makes them."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from joblib import parallel_config

from stressbot_planner.cli import tool as cli
from stressbot_planner.formats import scenario
from stressbot_planner.reproduce import experiments, figures, instances, published, runs, switching, tables
from stressbot_planner.reproduce.experiments import QUICK
from stressbot_planner.reproduce.progress import Display
from stressbot_planner.reproduce.report import Folder
from stressbot_planner.reproduce.runs import Run

SCENARIOS = Path(__file__).parents[1] / "scenarios"
SMALL = replace(QUICK, table_3=1, table_4=1, orders=1, growth=1, table_limit=20.0)


def run_of(planner="pure_control", **changes):
    values = {"section": "s", "row": "r", "text": instances.paper(True), "planner": planner, "time_limit": 20.0, "seed": 0}
    return Run(**values | {"tolerance": 1.5} | changes)


@pytest.fixture(scope="module")
def table_4():
    """One run of each row of Table 4 with a goal radius, and its record."""
    planned = [run for run in experiments.table_4(SMALL) if run.planner != "optimize"]
    return planned, [runs.perform(run) for run in planned]


# --- instances -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("discs", "file"), [(False, "paper-six.yaml"), (True, "paper-six-two-discs.yaml")])
def test_the_paper_instances_are_those_of_the_scenario_files(discs, file):
    ours, shipped = scenario.parse(instances.paper(discs)), scenario.load(SCENARIOS / file)
    assert ours.name == shipped.name
    for name in ("starts", "goals"):
        np.testing.assert_array_equal(getattr(ours.problem, name), getattr(shipped.problem, name))
    circles = [[(*o.center, o.radius) for o in loaded.problem.environment.obstacles] for loaded in (ours, shipped)]
    assert circles[0] == circles[1]
    assert ours.problem.environment.workspace == shipped.problem.environment.workspace
    assert ours.swarm.codewords == shipped.swarm.codewords


@pytest.mark.parametrize("n", [6, 14, 62])
def test_random_instances_have_the_density_and_the_spacing_of_the_paper(n):
    problem = scenario.parse(instances.random(n, True, 3)).problem
    walls = problem.environment.workspace
    assert (walls.x_max - walls.x_min) ** 2 == pytest.approx(n * 400 / 6)
    assert len(problem.environment.obstacles) == n // 3
    for places in (problem.starts[:, :2], problem.goals):
        apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
        assert apart[~np.eye(n, dtype=bool)].min() >= instances.SPACING


def test_random_instances_differ_by_seed_only_and_share_robots_with_and_without_discs():
    assert instances.random(6, True, 1) == instances.random(6, True, 1)
    one, two, discs = (scenario.parse(instances.random(6, *given)).problem for given in ((False, 1), (False, 2), (True, 1)))
    assert not np.array_equal(one.starts, two.starts)
    np.testing.assert_array_equal(one.starts, discs.starts)
    assert one.environment.is_open_plane


# --- runs ------------------------------------------------------------------------------------------------------------


def test_a_run_is_solved_measured_and_keeps_its_plan():
    record = runs.perform(run_of())
    assert record["solved"] and not record["refused"] and record["reason"] == ""
    assert (record["scenario"], record["n"]) == ("paper-six-two-discs", 6)
    assert record["goal_error"] <= 1.5
    assert record["path_length"] >= record["lower_bounds"]["path_length"]
    assert record["plan"]["success"]
    json.dumps(record, allow_nan=False)


def test_a_process_of_its_own_gives_the_same_plan_and_less_memory():
    here, fresh = runs.perform(run_of()), runs.perform(run_of(fresh=True))
    assert fresh["plan"]["activations"] == here["plan"]["activations"]
    assert 50e6 < fresh["peak_memory"] < 2e9


def test_a_run_that_finds_nothing_in_time_is_a_failure_with_a_reason():
    record = runs.perform(run_of("rrt", text=instances.random(14, True, 0), time_limit=0.2))
    assert not record["solved"] and not record["refused"]
    assert "no plan found within 0.2 s" in record["reason"]


def test_a_plan_that_comes_too_late_is_a_failure(monkeypatch):
    def late(problem, planner, settings):
        return replace(solve(problem, planner, settings), planning_time=1.2 * settings.time_limit)

    solve = runs.planners.solve
    monkeypatch.setattr(runs.planners, "solve", late)
    record = runs.measure(run_of())
    assert not record["solved"] and record["reason"] == "the limit was overrun"


def test_a_refused_problem_is_told_as_such():
    record = runs.perform(run_of("parallel", order=9))
    assert record["refused"] and "order" in record["reason"] and record["plan"] is None


@pytest.mark.parametrize("ending", ["hangs", "dies"])
def test_a_process_that_does_not_answer_is_a_failure(monkeypatch, ending):
    code = {"hangs": "import time; time.sleep(60)", "dies": "raise MemoryError('too large')"}[ending]
    monkeypatch.setattr(runs, "_CHILD", code)
    monkeypatch.setattr(runs, "STARTUP", 0.1)
    record = runs.perform(run_of(fresh=True, time_limit=0.2 if ending == "hangs" else 60.0))
    assert not record["solved"]
    assert {"hangs": "ended from outside", "dies": "MemoryError: too large"}[ending] in record["reason"]


@pytest.mark.parametrize("backend", ["sequential", "threading", "multiprocessing"])
def test_any_backend_of_joblib_serves_and_tells_every_record(backend):
    told = []
    with parallel_config(backend, n_jobs=1):
        records = runs.perform_all([run_of(seed=seed) for seed in range(2)], told.append)
    assert [record["seed"] for record in records] == [record["seed"] for record in told] == [0, 1]


def test_the_error_of_switching_falls_in_first_and_in_second_order(tmp_path):
    rows = switching.measure()
    for symmetric, order in ((False, 1.0), (True, 2.0)):
        mine = [row for row in rows if row.symmetric == symmetric]
        assert switching.order_of(mine) == pytest.approx(order, abs=0.1)
        assert mine[-1].error < 1e-3 * (10 if not symmetric else 1)
    folder = Folder(tmp_path, "test")
    folder.table(tables.switching(rows))
    folder.picture("switching", figures.switching(rows), "caption")
    assert (tmp_path / "switching.png").stat().st_size > 10_000


# --- experiments -----------------------------------------------------------------------------------------------------


def test_full_has_as_many_instances_as_the_paper():
    for section, rows, count in (("table_3", published.TABLE_3, 20), ("table_4", published.TABLE_4, 10)):
        planned = getattr(experiments, section)(experiments.FULL)
        assert len(planned) == count * len(rows)
        assert len(set(planned)) == len(planned)


def test_the_order_sweep_poses_every_order_of_both_sizes():
    posed = {(scenario.parse(run.text).swarm.n, run.order) for run in experiments.orders(QUICK)}
    assert posed == {(6, 1), (6, 2), (6, 3), (14, 1), (14, 2), (14, 3), (14, 4)}


def test_growth_goes_on_with_those_that_solved_something():
    asked = []

    def perform_all(planned):
        asked.append({(run.planner, run.section) for run in planned})
        assert all(run.fresh for run in planned)
        return [{"solved": run.planner == "pure_control" and len(asked) < 3} for run in planned]

    records = experiments.growth(QUICK, perform_all, sizes=(6, 14, 30, 62))
    assert [len(cases) for cases in asked] == [14, 2, 2]
    assert asked[1] == {("pure_control", "growth"), ("pure_control", "growth-discs")}
    assert len(records) == 18


# --- tables ----------------------------------------------------------------------------------------------------------


def test_tables_1_and_2_are_the_paper_ones():
    for table in (tables.table_1(), tables.table_2()):
        assert {row[-1] for row in table.rows} == {"same"}
    assert len(tables.table_2().rows) == 12


def record_of(**changes):
    record = {"row": "RRT with rot.", "scenario": "s", "n": 6, "seed": 0, "time_limit": 60.0,
              "solved": True, "refused": False, "reason": "", "planning_time": 1.0,
              "nodes": 10, "path_length": 200.0, "execution_time": 100.0, "activations": 50,
              "lower_bounds": {"path_length": 100.0, "execution_time": 40.0}}
    return record | changes


def test_statistics_are_over_solved_runs_and_failures_are_counted():
    records = [record_of(planning_time=time, seed=seed) for seed, time in enumerate((1.0, 2.0, 6.0))]
    records.append(record_of(solved=False, planning_time=60.0, seed=3, reason="no way"))
    planning, plans = tables.performance("T", published.TABLE_3, records)
    row = dict(zip(planning.header, planning.rows[1], strict=True))
    assert (row["solved"], row["paper: solved"], row["paper: time (s)"]) == ("3/4", "20/20", "8.88")
    assert (row["median"], row["mean"], row["max"], row["seeds"]) == ("2.00", "3.00", "6.00", "0–3")
    assert plans.rows[1][5] == "2.00" and plans.rows[1][10] == "2.50"
    assert "no way" in planning.note
    assert planning.rows[0][3] == "0/0" and planning.rows[0][5] == "–"


def test_markdown_is_a_table_that_ends_with_its_note():
    lines = tables.Table("T", ("a", "b"), (("1", "long one"),), "- note").markdown().splitlines()
    assert lines[0] == "### T"
    assert len({len(line) for line in lines[2:5]}) == 1
    assert lines[-1] == "- note"


# --- figures and the folder ------------------------------------------------------------------------------------------


def test_every_row_of_table_4_is_solved_and_drawn(table_4, tmp_path):
    planned, records = table_4
    assert [record["solved"] for record in records] == [True] * (len(published.TABLE_4) - 1)
    folder = Folder(tmp_path, "test")
    folder.keep(planned, records)
    for table in tables.performance("Table 4", published.TABLE_4, records):
        folder.table(table)
    sequential = folder.plan(records[2])
    assert sequential.valid
    subgroups = records[2]["subgroups"]
    assert {robots for robots, _ in subgroups} == {(4, 5), (1, 3), (2, 6)}
    assert sum(count for _, count in subgroups) == len(sequential.primitives)
    drawn = figures.subgroup_panels(sequential, subgroups, "defghi")
    titles = [figure.axes[0].get_title() for figure in drawn]
    wanted = [(letter, *robots) for letter, robots in zip("def", published.IC4, strict=True)]
    assert [re.match(r"\((\w)\) IC4: robots (\d), (\d),", title).groups() for title in titles] == [
        (letter, str(one), str(other)) for letter, one, other in wanted
    ]
    times = [re.search(r", (\w+) to move", title).group(1) for title in titles]
    assert [subgroups[("first", "second", "third").index(time)][0] for time in times] == list(published.IC4)
    folder.picture("picture", figures.panels(drawn, 3), "caption")
    assert (tmp_path / "picture.png").stat().st_size > 10_000
    content = json.loads((tmp_path / "report.json").read_text())
    assert len(content["tables"]) == 2 and len(content["runs"]) == len(records)
    for entry in content["runs"]:
        assert (tmp_path / entry["plan_file"]).is_file()
    text = (tmp_path / "report.md").read_text()
    assert "![caption](picture.png)" in text and "529.47" in text


def test_the_primitive_of_the_paper_moves_robots_4_and_5_three_ways():
    figure, measured = figures.primitive(time_limit=3.0)
    assert len(figure.axes) == 3
    assert measured[-1] == ("designed by hand", pytest.approx(3.0 + 3.0 * np.pi), pytest.approx(measured[-1][2]))


def test_curves_of_orders_and_growth_are_drawn_even_where_nothing_was_solved():
    records = [
        record_of(order=order, section=section, n=n, solved=n == 6, peak_memory=None)
        for order, n in ((1, 6), (2, 14)) for section in ("growth", "growth-discs")
    ]
    assert len(figures.orders(records).axes) == 3
    assert len(figures.growth(records).axes) == 10
    assert len(tables.orders(records).rows) == 2
    assert [row[3] for row in tables.growth(records).rows] == ["1/1", "0/1", "1/1", "0/1"]


# --- the command -----------------------------------------------------------------------------------------------------


def test_progress_is_plain_lines_where_there_is_no_terminal(capsys):
    with Display(sys.stdout) as show:
        show.section("table 3", 2)
        for _ in range(2):
            show.record(record_of(planner="rrt"))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("table 3, 2 runs")
    assert lines[-1].endswith("2 of 2 runs, 2 solved")


@pytest.mark.parametrize("arguments", [["--jobs", "0"], ["--jobs", "many"], ["--output", __file__]])
def test_bad_arguments_are_refused_in_one_line(arguments, capsys):
    try:
        code = cli.main(["reproduce", *arguments])
    except SystemExit as error:
        code = error.code
    assert code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
