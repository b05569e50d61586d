"""Put four planners beside each other on one problem: path, driving time and activations.

    python examples/compare_planners.py
"""

from pathlib import Path

from stressbot_planner import Settings, load, solve

SCENARIO = Path(__file__).parents[1] / "scenarios/paper-six.yaml"
PLANNERS = ("optimize", "pure_control", "sequential", "rrt_rotation")
GOAL_RADIUS = 1.5
"""Units: trees reach a neighbourhood of the goals, not the goals themselves."""

problem = load(SCENARIO, GOAL_RADIUS).problem
print(f"{'planner':<14}{'path':>8}{'driving':>9}{'activations':>13}")
for planner in PLANNERS:
    result = solve(problem, planner, Settings(max_tries=2000 if planner == "rrt_rotation" else 20))
    if result.plan is not None and result.success:
        plan = result.plan
        print(f"{planner:<14}{plan.path_length:>8.1f}{plan.execution_time:>7.1f} s{len(plan.groups):>13}")
    else:
        print(f"{planner:<14}{result.reason}")
