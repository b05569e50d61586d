"""Pictures hold what they should: circles green, crosses red, a colour a robot, equal axes, true times."""

import io
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.patches import Circle as Disc
from matplotlib.patches import Polygon as Area

from stressbot_planner.allocation import binary
from stressbot_planner.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.plan import Plan, StoredPlan
from stressbot_planner.plotting import plan_title, plot_plan, plot_voltages
from stressbot_planner.primitives import Activate, TurnAll
from stressbot_planner.problem import Problem
from stressbot_planner.swarm import Swarm

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


def test_starts_are_green_circles_and_goals_red_crosses():
    figure = plot_plan(problem(), plan().poses, "six")
    axes = figure.axes[0]
    starts = [patch for patch in axes.patches if isinstance(patch, Disc) and to_hex(patch.get_edgecolor()) == "#2ca02c"]
    np.testing.assert_allclose([patch.center for patch in starts], problem().starts[:, :2])
    (goals,) = [line for line in axes.lines if line.get_marker() == "x"]
    assert to_hex(goals.get_color()) == "#d62728"
    np.testing.assert_allclose(goals.get_xydata(), problem().goals)


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_names_are_drawn_as_they_are(kind):
    figure = plot_plan(problem(1), problem(1).starts[None], "a title")
    for name in ("cost $^$", r"$\frac{1}{0}$ \$", r"\alpha_{1}", "50 % {a} & <b> #1 ~", "a--b-", "]]> -->", "ü ±"):
        figure.axes[0].title.set_text(name)
        stream = io.BytesIO()
        figure.savefig(stream, format=kind)
        if kind == "svg":
            ElementTree.fromstring(stream.getvalue())


def test_obstacles_are_black_and_axes_equal():
    axes = plot_plan(problem(), plan().poses).axes[0]
    black = [patch for patch in axes.patches if patch.get_facecolor()[:3] == (0, 0, 0) and patch.get_fill()]
    assert [type(patch) for patch in black] == [Disc, Area]
    assert axes.get_aspect() in (1.0, "equal")


def test_each_robot_that_moves_has_a_path_of_one_colour_with_arrows_along_its_heading():
    axes = plot_plan(problem(), plan().poses).axes[0]
    moved = np.hypot(*(plan().poses[-1] - plan().poses[0])[:, :2].T) > 0
    paths = [item for item in axes.collections if hasattr(item, "get_segments")]
    arrows = [item for item in axes.collections if hasattr(item, "U")]
    assert len(paths) == len(arrows) == moved.sum()
    assert len({to_hex(path.get_color()[0]) for path in paths}) == len(paths)
    for robot, quiver in zip(np.flatnonzero(moved), arrows, strict=True):
        headings = set(np.round(plan().poses[:, robot, 2], 6) % (2 * np.pi))
        assert all(
            min(abs(np.exp(1j * heading) - np.exp(1j * angle)) for heading in headings) < 1e-6
            for angle in np.arctan2(quiver.V, quiver.U)
        )


def test_the_view_holds_all_poses_and_the_walls():
    axes = plot_plan(problem(), plan().poses).axes[0]
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
    axes = plot_plan(problem(), poses, executed=executed).axes[0]
    dots = [line for line in axes.lines if line.get_marker() == "."]
    assert [len(line.get_xydata()) for line in dots] == ([len(poses)] * 6 if shape == "array" else [len(poses), 2])


@pytest.mark.parametrize("n", [1, 2, 6, 14, 15, 62])
@pytest.mark.parametrize("environment", [SCENE, Environment()], ids=["scene", "open plane"])
def test_labels_and_legend_stay_inside_for_any_swarm(n, environment):
    figure = plot_plan(problem(n, environment), plan(n, environment).poses, "a title\nof two lines")
    assert texts_inside(figure)
    assert png(figure).startswith(b"\x89PNG")


@pytest.mark.parametrize("poses", [problem().starts[None], np.repeat(problem().starts[None], 3, axis=0)])
def test_a_swarm_that_does_not_move(poses):
    assert png(plot_plan(problem(), poses))


def test_a_wide_and_a_high_scene():
    for goal in ((1000.0, 3.0), (0.0, 1000.0)):
        lone = Problem(Swarm(1.0, 1.0, 0.1, ("1",)), Environment(), [[0, 3, 0]], [goal])
        width, height = plot_plan(lone, lone.starts[None]).get_size_inches()
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


@pytest.mark.parametrize("epochs", [0, 1, 4, 100])
def test_any_number_of_epochs(epochs):
    assert png(plot_voltages(LEVELS, DWELLS, ENDS, epochs))


def test_an_empty_sequence():
    assert png(plot_voltages([], [], []))
