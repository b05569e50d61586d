"""Plan for the paper's six robots between two discs, say what the plan costs, and draw it.

    python examples/plan_and_draw.py [plan.png]
"""

import sys
from pathlib import Path

from stressbot_planner import Settings, Solved, load, plot, solve

SCENARIO = Path(__file__).parents[1] / "scenarios/paper-six-two-discs.yaml"

scenario = load(SCENARIO)
result = solve(scenario.problem, "optimize", Settings(max_tries=20))
if not isinstance(result, Solved):
    sys.exit(result.reason)
plan = result.plan
bound = scenario.problem.lower_bounds.path_length
print(f"{len(plan.groups)} activations, path {plan.path_length:.1f} units, {plan.path_length / bound:.2f} times the lower bound")
print(f"smallest gap {plan.clearance.gap:.3f} units, largest goal error {plan.goal_error:.1e} units")
if sys.argv[1:]:
    plot(plan, scenario.length_unit, scenario.name).savefig(sys.argv[1])
