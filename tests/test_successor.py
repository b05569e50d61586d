"""The benchmark of a learned switcher: layouts, decisions, searches, episodes and what is told of them."""

from itertools import product
from math import exp, log

import numpy as np
import pytest
import successor
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from successor_baselines import ORDERS, Child, best_first
from successor_layouts import BODY, DISC, LAYOUTS, corridor, scattered
from successor_model import COARSE_COST, MOVE, PRECISE, SLIDE_STEP, SUBSTEP_COST, SUBSTEPS, THRESHOLD, TURN_STEP, Decisions

from stressbot_planner.formats.scenario import parse
from stressbot_planner.model.kinematics import replay
from stressbot_planner.primitives.expansion import expand as activations_of
from stressbot_planner.problem.reachability import walled_in

SEEDS = range(40)


def layout(make, seed):
    problem = parse(make(seed)).problem
    discs = np.array([obstacle.center for obstacle in problem.environment.obstacles])
    return problem, discs, problem.starts[:, :2], problem.goals


def between(points):
    return np.min(np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))[~np.eye(len(points), dtype=bool)])


def away(points, discs):
    return np.min(np.hypot(*(points[:, None] - discs[None]).transpose(2, 0, 1)))


def inside(points, low, high):
    return np.all(points >= low) and np.all(points <= high)


@pytest.mark.parametrize("make", LAYOUTS.values(), ids=LAYOUTS)
def test_layouts_have_its_robots_discs_and_spacings(make):
    for seed in SEEDS:
        problem, discs, starts, goals = layout(make, seed)
        assert problem.swarm.n == 14 and problem.swarm.m == 5 and len(discs) == 7
        assert np.all(problem.swarm.body_radius == 0.2) and np.all(problem.swarm.turning_radius == 0.5)
        assert all(obstacle.radius == DISC for obstacle in problem.environment.obstacles)
        assert between(starts) >= 0.6 and between(goals) >= 0.5 and between(discs) >= 2 * DISC
        assert away(starts, discs) >= DISC + 0.5 and away(goals, discs) >= DISC + BODY
        assert inside(starts, 1.0, 14.0) and inside(goals, 1.0, 14.0) and inside(discs, 0.0, 15.0)
        assert np.ptp(problem.starts[:, 2]) > np.pi / 2
        assert seed > 3 or walled_in(problem) is None


def test_the_corridor_is_a_band_of_discs_with_gaps():
    for seed in SEEDS:
        _, discs, starts, goals = layout(corridor, seed)
        assert inside(discs, (6.0, 1.0), (9.0, 14.0)) and between(discs) - 2 * DISC >= 1.0
        assert inside(starts[:, 0], 1.0, 3.75) and inside(goals[:, 0], 11.25, 14.0)


def test_the_scattered_layout_uses_the_whole_square():
    every = [layout(scattered, seed) for seed in SEEDS]
    for points in (np.vstack([one[k] for one in every]) for k in (1, 2, 3)):
        assert np.all(np.abs(points.mean(axis=0) - 7.5) < 1.0) and np.all(points.std(axis=0) > 3.0)


def test_a_seed_is_an_episode():
    for make in LAYOUTS.values():
        assert make(1000) == make(1000) != make(1001)


@pytest.fixture(scope="module")
def decisions():
    return Decisions(parse(scattered(0)).problem)


def test_there_are_22_subgroups_of_7_3_and_4_robots(decisions):
    sizes = decisions.members.sum(axis=1).tolist()
    assert (sizes.count(7), sizes.count(3), sizes.count(4), len(sizes)) == (4, 6, 12, PRECISE)
    poses = np.array(decisions.problem.starts)
    assert all(decisions.cost(action, poses) == (8.8 if size == 7 else 52.7) for action, size in enumerate(sizes))
    assert decisions.cost(PRECISE, poses) == pytest.approx(SUBSTEP_COST * SUBSTEPS * decisions.away(poses).sum())


def random_poses(rng):
    return np.column_stack([rng.uniform(1, 14, (14, 2)), rng.uniform(-np.pi, np.pi, 14)])


def test_a_coarse_step_turns_by_the_five_inputs_and_slides_members_only(decisions):
    matrix = np.column_stack([~decisions.problem.swarm.membership[:4].T, np.ones(14)])
    rng = np.random.default_rng(0)
    for action in range(PRECISE):
        poses = random_poses(rng)
        step, members = decisions.step(action, poses), decisions.members[action]
        off = step.poses[:, 2] - poses[:, 2] - matrix @ step.turns
        assert np.allclose(np.exp(1j * off), 1.0)
        way = step.poses[:, :2] - poses[:, :2]
        ahead = np.column_stack([np.cos(step.poses[:, 2]), np.sin(step.poses[:, 2])])
        assert np.allclose(way, MOVE * ahead * members[:, None], atol=1e-12)


def test_a_coarse_step_brings_its_members_as_near_as_a_library_can(decisions):
    rng = np.random.default_rng(1)
    matrix = np.column_stack([~decisions.problem.swarm.membership[:4].T, np.ones(14)])
    for action in range(PRECISE):
        poses, members = random_poses(rng), decisions.members[action]

        def distances(turns, poses=poses, members=members):
            headings = (poses[:, 2] + matrix @ turns)[members]
            ends = poses[members, :2] + MOVE * np.column_stack([np.cos(headings), np.sin(headings)])
            return np.hypot(*(ends - decisions.problem.goals[members]).T).sum()

        turns = decisions.step(action, poses).turns
        assert distances(turns) <= minimize(distances, turns).fun + 0.01


def test_three_members_look_straight_at_their_goals(decisions):
    rng = np.random.default_rng(2)
    for action in np.flatnonzero(decisions.members.sum(axis=1) == 3):
        poses, members = random_poses(rng), decisions.members[action]
        after = decisions.step(action, poses).poses[members]
        aim = decisions.problem.goals[members] - poses[members, :2]
        assert np.allclose(np.cos(after[:, 2] - np.arctan2(aim[:, 1], aim[:, 0])), 1.0, atol=1e-6)


def sampled_gap(problem, poses, members, length):
    best = np.inf
    for way in np.linspace(0, length, 400):
        places = poses[:, :2] + way * members[:, None] * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
        apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) - 2 * BODY
        np.fill_diagonal(apart, np.inf)
        discs = np.array([obstacle.center for obstacle in problem.environment.obstacles])
        best = min(best, apart[members].min(), away(places[members], discs) - DISC - BODY)
        best = min(best, (places[members] - BODY).min(), (15.0 - BODY - places[members]).min())
    return best


def test_collisions_of_a_noisy_coarse_step_are_found_exactly(decisions):
    rng, touched = np.random.default_rng(3), 0
    for action in list(range(PRECISE)) * 4:
        poses, jumps = random_poses(rng), rng.normal(0.0, 0.2, 14)
        members = decisions.members[action]
        plain, step = decisions.step(action, poses), decisions.step(action, poses, jumps)
        turned = np.exp(1j * (step.poses[:, 2] - plain.poses[:, 2]))
        assert np.allclose(turned, np.exp(1j * jumps * members))
        before = step.poses.copy()
        before[:, :2] = poses[:, :2]
        sampled = sampled_gap(decisions.problem, before, members, MOVE)
        assert sampled - 2 * MOVE / 399 <= step.gap <= sampled + 1e-12
        touched += step.gap < 0
    assert 10 < touched < 4 * PRECISE


def test_a_precise_step_keeps_its_limits_and_touches_nothing():
    for seed in range(5):
        decisions = Decisions(parse(scattered(seed)).problem)
        poses = np.array(decisions.problem.starts)
        for _ in range(10):
            moving = decisions.away(poses)
            step = decisions.step(PRECISE, poses)
            assert step.gap >= 0 and between(step.poses[:, :2]) >= 2 * BODY
            assert np.all(np.abs(step.ways[:, 0]) <= SUBSTEPS * TURN_STEP + 1e-12)
            slid = np.hypot(*(step.poses[:, :2] - poses[:, :2]).T)
            assert np.all(slid <= step.ways[:, 1] + 1e-12) and np.all(step.ways[:, 1] <= SUBSTEPS * SLIDE_STEP + 1e-12)
            assert not step.ways[~moving].any()
            poses = step.poses


def test_precise_steps_alone_bring_one_robot_to_its_goal():
    for seed in range(4):
        problem = parse(corridor(seed)).problem
        decisions = Decisions(problem)
        poses = np.column_stack([problem.goals, np.zeros(14)])
        poses[0] = problem.starts[0]
        for _ in range(60):
            poses = decisions.step(PRECISE, poses).poses
        assert not decisions.away(poses).any(), seed


def test_robots_at_their_goals_are_neither_driven_nor_priced(decisions):
    poses = np.column_stack([decisions.problem.goals, np.zeros(14)])
    assert decisions.left(poses) == 0.0 and decisions.cost(PRECISE, poses) == 0.0
    poses[:2, :2] += (THRESHOLD + 0.01, 0.0)
    assert decisions.cost(PRECISE, poses) == pytest.approx(2 * SUBSTEPS * SUBSTEP_COST)
    assert decisions.left(poses) >= 2 * THRESHOLD * SUBSTEP_COST / SLIDE_STEP


def test_a_coarse_step_expands_into_activations_that_do_the_same(decisions, monkeypatch):
    swarm, rng = decisions.problem.swarm, np.random.default_rng(4)
    expanded = []
    original = Decisions._expanded
    monkeypatch.setattr(Decisions, "_expanded", lambda self, moves: (expanded.append(moves), original(self, moves))[1])
    for action in range(PRECISE):
        poses = random_poses(rng)
        step = decisions.step(action, poses)
        count, length = decisions.activations(action, step)
        groups, lengths = activations_of(swarm, expanded[-1])
        assert count <= len(groups) and length <= lengths.sum() + 1e-9
        end = replay(swarm, poses, groups, lengths)[-1]
        assert np.allclose(end[:, :2], step.poses[:, :2], atol=1e-9)
        assert np.allclose(np.exp(1j * (end[:, 2] - step.poses[:, 2])), 1.0)


def tree(depth, costs, likely):
    """Return what expands a full tree whose nodes are the actions up to them; cheap actions are not the likely ones."""

    def expand(state):
        for action, cost in enumerate(costs):
            child = (*state, action)
            left = min(costs) * (depth - len(child))
            yield Child(action, cost + 0.1 * (sum(child) % 3), child, left, len(child) == depth, log(likely[action]))

    return expand


price = st.floats(0.5, 5.0)


@settings(max_examples=20, deadline=None)
@given(st.lists(price, min_size=2, max_size=3), st.integers(1, 4))
def test_a_star_finds_what_brute_force_finds(costs, depth):
    likely = [1 / len(costs)] * len(costs)
    expand = tree(depth, costs, likely)

    def total(actions):
        state, cost = (), 0.0
        for action in actions:
            child = list(expand(state))[action]
            state, cost = child.state, cost + child.cost
        return cost

    found = best_first((), expand, ORDERS["A*"], 10**6)
    assert found.complete and len(found.actions) == depth
    assert found.cost == pytest.approx(total(found.actions))
    assert found.cost == pytest.approx(min(total(actions) for actions in product(range(len(costs)), repeat=depth)))


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(sorted(ORDERS)), st.lists(price, min_size=2, max_size=3), st.lists(price, min_size=3, max_size=3))
def test_nodes_are_taken_up_in_the_order_of_the_search(name, costs, weights):
    likely = np.array(weights[: len(costs)]) / sum(weights[: len(costs)])
    plain, seen, taken = tree(4, costs, likely.tolist()), {(): (0.0, 0.0, 0.0)}, []

    def expand(state):
        taken.append(state)
        for child in plain(state):
            cost, _, logarithm = seen[state]
            seen[child.state] = cost + child.cost, child.left, logarithm + child.log_policy
            yield child

    found = best_first((), expand, ORDERS[name], 10**6)
    keys = {state: ORDERS[name](*values) for state, values in seen.items() if state}
    waiting = set()
    for before, state in zip(taken, [*taken[1:], tuple(found.actions)], strict=True):
        waiting |= {child for child in keys if child[:-1] == before}
        assert keys[state] == pytest.approx(min(keys[one] for one in waiting))
        waiting.remove(state)


def test_the_orders_are_those_of_the_papers():
    cost, left, probability = 3.0, 2.0, 0.25
    wanted = {"A*": 5.0, "LevinTS": 3.0 / 0.25, "PHS": 5.0 / 0.25, "PHS*": 5.0 / 0.25 ** (1 + 2.0 / 3.0)}
    for name, order in ORDERS.items():
        value = order(cost, left, log(probability))
        assert (value if name == "A*" else exp(value)) == pytest.approx(wanted[name])


def test_a_search_that_may_expand_no_more_gives_the_best_way_so_far():
    expand = tree(6, [1.0, 2.0], [0.5, 0.5])
    for most in (1, 2, 5):
        found = best_first((), expand, ORDERS["A*"], most)
        assert not found.complete and found.expanded == most and 0 < len(found.actions) <= most
    assert best_first((), lambda state: (), ORDERS["A*"], 5).actions == []


@pytest.mark.parametrize("name", ["A*", "PHS*, policy by ways"])
def test_an_episode_adds_up(name, monkeypatch):
    steps = []
    original = Decisions.step

    def step(self, action, poses, jumps=None):
        made = original(self, action, poses, jumps)
        if jumps is not None:
            steps.append((action, self.cost(action, poses), made))
        return made

    monkeypatch.setattr(Decisions, "step", step)
    monkeypatch.setattr(successor, "MOST_DECISIONS", 12)
    for seed in range(3):
        steps.clear()
        episode = successor.searched(scattered(seed), seed, successor.METHODS[name], 3)
        assert episode.decisions == len(steps) == episode.coarse + episode.precise <= 12
        assert episode.precise == sum(action == PRECISE for action, _, _ in steps)
        assert episode.cost == pytest.approx(sum(cost for _, cost, _ in steps))
        assert episode.gap == min(made.gap for _, _, made in steps)
        assert (episode.outcome == "collision") == (episode.gap < 0)
        assert episode.outcome != "time-out" or episode.decisions == 12
        assert all(made.gap >= 0 for _, _, made in steps[:-1])


def test_noise_is_that_of_the_seed_and_not_of_the_search():
    text = corridor(0)
    one, two = (successor.searched(text, 0, successor.METHODS["A*"], 2) for _ in range(2))
    assert replace_planning(one) == replace_planning(two)


def replace_planning(episode):
    return episode._replace(planning=0.0)


def episode(outcome, **more):
    values = {"decisions": 100, "coarse": 60, "precise": 40, "cost": 10.0, "gap": 0.1, "activations": 7, "seconds": 3.0}
    return successor.Episode(outcome, **(values | more), planning=1.0)


def test_tables_count_every_episode_and_take_medians_of_successes():
    episodes = [
        episode("success"), episode("success", decisions=130, cost=30.0),
        episode("collision", cost=1e6, gap=-0.2), episode("time-out"),
    ]
    table = successor.table("corridor", {"some": episodes, "none": episodes[2:]})
    first, second = (dict(zip(table.header, row, strict=True)) for row in table.rows)
    counts = ("episodes", "success", "collision", "time-out", "success within 120")
    assert [first[key] for key in counts] == ["4", "2", "1", "1", "1"]
    assert first["cost"] == "20" and first["decisions"] == "115" and first["smallest gap"] == "-0.200"
    assert second["success"] == "0" and second["cost"] == "-"


def test_steps_of_more_halvings_expand_into_more():
    rows = {row[0]: [float(value) for value in row[1:]] for row in successor.expansions(range(2)).rows}
    seven, four, three, precise = (rows[f"coarse, {n} robots"] if n else rows["precise, all that are away"] for n in (7, 4, 3, 0))
    assert [seven[0], four[0], three[0], precise[0]] == [8, 24, 12, 2]
    assert seven[1] == COARSE_COST[1] and three[1] == four[1] == COARSE_COST[2]
    assert 10 < seven[2] < min(three[2], four[2]) and precise[2] > max(three[2], four[2])


def test_every_episode_is_in_the_picture():
    runs = [episode("success"), episode("collision"), episode("time-out"), episode("success")]
    figure = successor.drawn({name: {"one": runs, "two": runs[:2]} for name in LAYOUTS})
    maps, panels = (part.axes for part in figure.subfigs)
    assert len(maps) == 2 and len(panels) == 2 * len(successor.PANELS)
    assert all(len(axes.patches) == 7 + 14 for axes in maps)
    for axes in panels:
        assert sum(len(line.get_xdata()) for line in axes.lines) == 6


def test_the_closed_loop_is_priced_by_activations():
    episode = successor.driven(scattered(1), 1)
    assert episode.cost == COARSE_COST[1] * episode.activations
    assert episode.outcome == "success" and episode.gap > 0 and 0 < episode.decisions <= episode.activations
