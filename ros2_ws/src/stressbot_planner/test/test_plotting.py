"""Pictures hold what they should: a style a robot, icons along paths, names that can be read, equal axes, true times."""

import io
from dataclasses import replace
from itertools import combinations
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.patches import Circle as Disc
from matplotlib.patches import Polygon as Area

from stressbot_planner.formats.plan_file import StoredPlan
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.expansion import Activate, TurnAll
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reporting.palette import COLOURS, style
from stressbot_planner.reporting.plotting import plan_title, plot_plan, plot_voltages

SCENE = Environment(Workspace(-2, 22, -2, 22), (Circle((8, 6), 1.5), Polygon([(12, 12), (14, 12), (13, 14)])))


def problem(n=6, environment=SCENE) -> Problem:
    heights = np.linspace(0, 20, n) if n > 1 else [3.0]
    starts = np.column_stack([np.zeros(n), heights, np.linspace(0, 3, n)])
    return Problem(Swarm(1.0, 1.0, 0.1, binary(n)), environment, starts, np.column_stack([np.full(n, 20), heights]))


def plan(n=6, environment=SCENE) -> Plan:
    return Plan(problem(n, environment), (Activate(1, 3.0), TurnAll(1.0), Activate(2, 2.0), Activate(1, 0.0)))


def png(figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


def texts_inside(figure) -> bool:
    """Return whether titles, labels and legend lie within the picture."""
    figure.canvas.draw()
    axes = figure.axes[0]
    whole = figure.bbox
    legends = [legend for legend in (axes.get_legend(), *figure.legends) if legend is not None]
    boxes = [artist.get_window_extent() for artist in (axes.title, axes.xaxis.label, axes.yaxis.label, *legends)]
    return all(box.x0 >= 0 and box.y0 >= 0 and box.x1 <= whole.x1 and box.y1 <= whole.y1 for box in boxes)


def goals_of(axes) -> list:
    return [line for line in axes.lines if line.get_marker() == "x"]


def starts_of(axes) -> list:
    return [patch for patch in axes.patches if isinstance(patch, Disc) and to_hex(patch.get_edgecolor()) in COLOURS]


def names_of(axes) -> list:
    return [text for text in axes.texts if text.get_gid() == "name"]


def random_plan(n: int, seed: int = 0) -> tuple[Problem, Plan]:
    """Return a swarm that fills its plane, and a plan that moves everybody about."""
    rng = np.random.default_rng([seed, n])
    grid = 2.5 * np.stack(np.meshgrid(*2 * [np.arange(np.ceil(np.sqrt(2 * n)))]), axis=-1).reshape(-1, 2)
    places = grid[rng.choice(len(grid), 2 * n, replace=False)]
    starts = np.column_stack([places[:n], rng.uniform(-3, 3, n)])
    problem = Problem(Swarm(1.0, 1.0, 0.3, binary(n)), Environment(), starts, places[n:])
    activations = zip(rng.integers(1, problem.swarm.m + 1, 40).tolist(), rng.uniform(0, 2, 40).tolist(), strict=True)
    return problem, Plan(problem, tuple(Activate(group, length) for group, length in activations))


@pytest.mark.parametrize("n", [6, 24])
def test_circle_cross_path_icons_and_names_of_a_robot_have_its_colour(n):
    problem, plan = random_plan(n)
    axes = plot_plan(problem, plan.poses, 1e-4).axes[0]
    wanted = [style(j).colour for j in range(n)]
    assert [to_hex(patch.get_edgecolor()) for patch in starts_of(axes)] == wanted
    assert [to_hex(line.get_color()) for line in goals_of(axes)] == wanted
    assert [to_hex(item.get_edgecolor()[0]) for item in axes.collections] == wanted
    assert [to_hex(line.get_color()) for line in axes.lines[:n]] == wanted
    assert {(text.get_text(), to_hex(text.get_color())) for text in names_of(axes)} == {(str(j + 1), wanted[j]) for j in range(n)}
    np.testing.assert_allclose([patch.center for patch in starts_of(axes)], problem.starts[:, :2])
    np.testing.assert_allclose([patch.radius for patch in starts_of(axes)], problem.swarm.body_radius)
    np.testing.assert_allclose([np.ravel(line.get_data()) for line in goals_of(axes)], problem.goals)


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_names_are_drawn_as_they_are(kind):
    figure = plot_plan(problem(1), problem(1).starts[None], 1e-4, "a title")
    for name in ("cost $^$", r"$\frac{1}{0}$ \$", r"\alpha_{1}", "50 % {a} & <b> #1 ~", "a--b-", "]]> -->", "ü ±"):
        figure.axes[0].title.set_text(name)
        stream = io.BytesIO()
        figure.savefig(stream, format=kind)
        if kind == "svg":
            ElementTree.fromstring(stream.getvalue())


def test_obstacles_are_black_and_axes_equal():
    axes = plot_plan(problem(), plan().poses, 1e-4).axes[0]
    black = [patch for patch in axes.patches if patch.get_facecolor()[:3] == (0, 0, 0) and patch.get_fill()]
    assert [type(patch) for patch in black] == [Disc, Area]
    assert axes.get_aspect() in (1.0, "equal")


def test_icons_stand_where_activations_begin_and_end_and_look_where_the_robot_looks():
    problem, plan = random_plan(6)
    axes = plot_plan(problem, plan.poses, 1e-4).axes[0]
    for j, item in enumerate(axes.collections):
        for path in item.get_paths():
            corners = path.vertices[:5]
            middle, nose = (corners[0] + corners[4] + 2 * corners[2]) / 4, corners[2]
            heading = np.arctan2(*(nose - middle)[::-1])
            away = np.hypot(*(plan.poses[:, j, :2] - middle).T)
            turned = np.abs(np.angle(np.exp(1j * (plan.poses[:, j, 2] - heading))))
            assert np.any((away < 1e-6) & (turned < 1e-6))


def test_more_activations_have_more_icons():
    problem, plan = random_plan(6)
    few, many = (plot_plan(problem, plan.poses[:count], 1e-4).axes[0] for count in (10, 41))
    assert sum(len(item.get_paths()) for item in many.collections) > 2 * sum(len(item.get_paths()) for item in few.collections)


@pytest.mark.parametrize("n", [1, 6, 14, 24, 62])
def test_no_name_hides_another_or_a_goal_and_all_are_there(n):
    problem, plan = random_plan(n)
    figure = plot_plan(problem, plan.poses, 1e-4)
    figure.canvas.draw()
    axes = figure.axes[0]
    boxes = [text.get_window_extent() for text in names_of(axes)]
    assert sorted(int(text.get_text()) for text in names_of(axes)) == sorted([*range(1, n + 1)] * 2)
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    goals = axes.transData.transform(problem.goals)
    assert not any(box.contains(*goal) for box in boxes for goal in goals)


@pytest.mark.parametrize("length_unit", [1e-12, 1e-9, 1e-6, 1e-4, 3.7e-3, 1.0, 1e3])
@pytest.mark.parametrize("n", [1, 6, 24])
def test_the_scale_bar_is_as_long_as_it_says_and_beside_everything_else(n, length_unit):
    problem, plan = random_plan(n)
    figure = plot_plan(problem, plan.poses, length_unit)
    figure.canvas.draw()
    axes = figure.axes[0]
    (text,) = [text for text in axes.texts if text.get_gid() == "scale"]
    number, unit = text.get_text().split()
    metres = float(number) * {"m": 1.0, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9}[unit]
    (bar,) = [line for line in axes.lines if line.get_linewidth() == 3]
    ends = axes.transData.inverted().transform(bar.get_transform().transform(bar.get_xydata()))
    assert np.ptp(ends[:, 0]) * length_unit == pytest.approx(metres)
    box = text.get_window_extent()
    others = [axes.xaxis.label, *axes.get_xticklabels(), *([legend] if (legend := axes.get_legend()) else [])]
    assert not any(box.overlaps(other.get_window_extent()) for other in others)


def test_a_long_name_is_wrapped_and_cut_and_the_figures_stay():
    figure = plot_plan(problem(), plan().poses, 1e-4, f"{'many words ' * 100}\npath 12.34")
    assert texts_inside(figure)
    lines = figure.axes[0].get_title().splitlines()
    assert len(lines) <= 5 and lines[-1] == "path 12.34"
    assert figure.get_size_inches()[0] < 14


@pytest.mark.parametrize("name", ["Schwärme – ℝ² × 3", "群れ", "\U0001f916", "$x^$", "عربي", "a" * 300])
def test_any_name_is_drawn_without_a_warning(name):
    assert png(plot_plan(problem(), plan().poses, 1e-4, f"{name}\nsecond line"))


def test_the_view_holds_all_poses_and_the_walls():
    axes = plot_plan(problem(), plan().poses, 1e-4).axes[0]
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    places = plan().poses[:, :, :2].reshape(-1, 2)
    assert left <= min(places[:, 0].min(), -2)
    assert right >= max(places[:, 0].max(), 22)
    assert bottom <= min(places[:, 1].min(), -2)
    assert top >= max(places[:, 1].max(), 22)


@pytest.mark.parametrize("shape", ["array", "poses by robot"])
def test_executed_poses_are_drawn_as_dots(shape):
    poses = plan().poses
    executed = poses if shape == "array" else {1: poses[:, 0], 4: poses[:2, 3, :2]}
    axes = plot_plan(problem(), poses, 1e-4, executed=executed).axes[0]
    dots = [line for line in axes.lines if line.get_marker() == "."]
    assert [len(line.get_xydata()) for line in dots] == ([len(poses)] * 6 if shape == "array" else [len(poses), 2])


@pytest.mark.parametrize("n", [1, 2, 6, 14, 15, 62])
@pytest.mark.parametrize("environment", [SCENE, Environment()], ids=["scene", "open plane"])
def test_labels_and_legend_stay_inside_for_any_swarm(n, environment):
    figure = plot_plan(problem(n, environment), plan(n, environment).poses, 1e-4, "a title\nof two lines")
    assert texts_inside(figure)
    assert png(figure).startswith(b"\x89PNG")


@pytest.mark.parametrize("poses", [problem().starts[None], np.repeat(problem().starts[None], 3, axis=0)])
def test_a_swarm_that_does_not_move(poses):
    assert png(plot_plan(problem(), poses, 1e-4))


def test_a_wide_and_a_high_scene():
    for goal in ((1000.0, 3.0), (0.0, 1000.0)):
        lone = Problem(Swarm(1.0, 1.0, 0.1, ("1",)), Environment(), [[0, 3, 0]], [goal])
        width, height = plot_plan(lone, lone.starts[None], 1e-4).get_size_inches()
        assert 3 < width < 12
        assert 3 < height < 12


def test_titles_tell_the_figures():
    title = plan_title("six", StoredPlan("optimize", 0, True, plan()))
    assert "six, optimize" in title
    assert f"path {plan().path_length:.2f}" in title
    assert "closest attempt" in plan_title("six", StoredPlan("optimize", 0, False, plan()))


# --- voltages -------------------------------------------------------------------------------------------------------

LEVELS = [90, 0, 40, 0, 60, 0, 140, 0] * 6
DWELLS = [0.01, 0.005, 0.01, 0.005, 0.01, 0.005, 2.5, 0.005] * 6
ENDS = list(range(8, 49, 8))


def texts(figure) -> list[str]:
    return [text.get_text() for text in figure.axes[0].texts]


def test_voltages_name_epochs_symbols_and_drives():
    figure = plot_voltages(LEVELS, DWELLS, ENDS, symbols={90: "reset", 40: "0", 60: "1", 140: "drive"})
    assert [text for text in texts(figure) if text.startswith("epoch")] == ["epoch 1", "epoch 2", "epoch 3", "epoch 4"]
    for word in ("reset", "0", "1", "drive 2.5 s"):
        assert texts(figure).count(word) == 4
    assert texts(figure).count("//") == 4
    assert "4 of 6" in figure.axes[0].get_title()
    assert texts_inside(figure)


def test_ticks_tell_the_true_time_although_drives_are_cut_short():
    figure = plot_voltages(LEVELS, DWELLS, ENDS, epochs=2)
    labels = [label.get_text() for label in figure.axes[0].get_xticklabels()]
    assert labels == ["0", "2.55", "5.1"]
    assert "cut short" in figure.axes[0].get_xlabel()


def test_short_drives_are_drawn_to_scale():
    figure = plot_voltages(LEVELS, [0.01] * len(LEVELS), ENDS, epochs=1)
    assert "//" not in texts(figure)
    assert figure.axes[0].get_xlabel() == "time (s)"
    assert figure.axes[0].get_xlim() == (0, pytest.approx(0.08))


def test_symbols_may_be_given_per_segment():
    names = ["r", "", "a", "", "b", "", "d", ""] * 6
    assert texts(plot_voltages(LEVELS, DWELLS, ENDS, 1, names))[1:] == ["r", "a", "b", "//", "d 2.5 s"]


@pytest.mark.parametrize("alternating", [False, True])
def test_trains_are_counted_and_shown_one_by_one_in_an_inset(alternating):
    pulses = [20_000 if level == 140 else 0 for level in LEVELS]
    lows = [110.0 if count else 0.0 for count in pulses]
    figure = plot_voltages(LEVELS, DWELLS, ENDS, 2, {140: "drive"}, pulses, lows, 0.25, alternating)
    assert texts(figure).count("drive 20000 pulses 2.5 s") == 2
    (inset,) = figure.axes[0].child_axes
    assert "8000 Hz" in inset.get_xlabel()
    (stairs,) = inset.patches
    values, edges, _ = stairs.get_data()
    assert values[:4].tolist() == [140.0, 110.0, *([-140.0, -110.0] if alternating else [140.0, 110.0])]
    assert edges[:4].tolist() == pytest.approx([0.0, 31.25, 125.0, 156.25])
    assert png(figure)


@pytest.mark.parametrize("epochs", [0, 1, 4, 100])
def test_any_number_of_epochs(epochs):
    assert png(plot_voltages(LEVELS, DWELLS, ENDS, epochs))


def test_an_empty_sequence():
    assert png(plot_voltages([], [], []))


def test_an_arrow_shows_each_heading_at_a_goal():
    turned = replace(problem(), goal_headings=[np.nan, np.pi / 2, np.nan, np.nan, -1.0, np.nan])
    axes = plot_plan(turned, plan().poses, 1e-4, "headings").axes[0]
    arrows = [text for text in axes.texts if text.get_gid() == "heading"]
    assert [text.xy for text in arrows] == [tuple(turned.goals[1]), tuple(turned.goals[4])]
    directions = [np.arctan2(*text.xyann[::-1]) for text in arrows]
    np.testing.assert_allclose(directions, [np.pi / 2, -1.0])


def test_waypoints_parked_robots_and_contacts_have_marks_of_their_own():
    scene = problem()
    goals = scene.goals.copy()
    goals[2] = scene.starts[2, :2]
    words = tuple(word + word.translate({48: "1", 49: "0"}) for word in scene.swarm.codewords)
    stages = np.stack([scene.starts[:, :2] + [1.0, 0.0], scene.starts[:, :2] + [2.0, 0.0]])
    stages[:, 2] = goals[2]
    swarm = replace(scene.swarm, codewords=words)
    staged = replace(scene, swarm=swarm, goals=goals, parked=(2,), waypoints=stages, contacts=((0, 4),))
    axes = plot_plan(staged, plan().poses, 1e-4, "stages").axes[0]
    marks = {name: [line.get_xydata()[0] for line in axes.lines if line.get_gid() == name] for name in ("waypoint", "parked")}
    np.testing.assert_array_equal(marks["waypoint"], [place for j in range(6) if j != 2 for place in stages[:, j]])
    np.testing.assert_array_equal(marks["parked"], [scene.starts[2, :2]])
    (bar,) = [line.get_xydata() for line in axes.lines if line.get_gid() == "contact"]
    np.testing.assert_array_equal(bar, goals[[0, 4]])
    assert {"waypoint", "parked", "contact"} <= {text.get_text() for text in axes.get_legend().get_texts()}
