"""The paper's two problems by every planner: success, time, lengths, and their ratio to the lower bounds.

Paper's figures: Table 3 (no obstacles, within radius 2) and Table 4 (two discs, within radius 1.5). Positions of the
discs, body radius and turning radius are this project's own choice; see scenarios/.
"""

from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from stressbot_planner import scenario
from stressbot_planner.planners import Settings, prepare, solve

SCENARIOS = Path(__file__).parents[1] / "scenarios"
TIME_LIMIT = 60.0

CASES = {
    "no obstacles": (
        "paper-six.yaml",
        2.0,
        {"optimize": (0.80, 181.04, 76.33), "rrt_rotation": (8.88, 323.57, 172.36), "rrt": (393.53, 332.10, 110.70)},
    ),
    "two discs": (
        "paper-six-two-discs.yaml",
        1.5,
        {
            "rrt_rotation": (1141.38, 384.62, 200.57),
            "parallel": (216.15, 868.66, 886.04),
            "sequential": (15.38, 529.47, 577.41),
            "pure_control": (19.44, 871.82, 1042.47),
        },
    ),
}
PLANNERS = ("optimize", "rrt", "rrt_rotation", "parallel", "sequential", "pure_control")


def run(planner: str, file: str, tolerance: float, seed: int) -> tuple[bool, float, float, float, float, float]:
    """Return success, planning time, path length, execution time and their ratios to the bounds of one run."""
    prepare(planner)
    exact = planner in ("optimize", "pure_control")
    problem = scenario.load(SCENARIOS / file, *(() if exact else (tolerance,))).problem
    result = solve(problem, planner, Settings(time_limit=TIME_LIMIT, seed=seed))
    plan, bounds = result.plan, problem.lower_bounds
    return (
        result.success,
        result.planning_time,
        plan.path_length,
        plan.execution_time,
        plan.path_length / bounds.path_length,
        plan.execution_time / bounds.execution_time,
    )


def table(seeds: int) -> str:
    """Return the table as Markdown."""
    lines = [
        f"Six robots, {seeds} seeds; `optimize` and `pure_control` reach goals exactly, trees within the paper's radius.",
        "Medians over successes (maximum for the time). Time-outs after 60 s are failures. In brackets: the paper.",
        "",
        "| problem | planner | success | planning (s) | max (s) | path | × bound | driving (s) | × bound |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for case, (file, tolerance, paper) in CASES.items():
        for planner in PLANNERS:
            runs = Parallel(n_jobs=2, inner_max_num_threads=1)(
                delayed(run)(planner, file, tolerance, seed) for seed in range(seeds)
            )
            data = np.array([row for row in runs if row[0]], dtype=float).reshape(-1, 6)
            median = np.median(data, axis=0) if len(data) else np.full(6, np.nan)
            theirs = [f" [{value:g}]" for value in paper[planner]] if planner in paper else ["", "", ""]
            lines.append(
                f"| {case} | {planner} | {len(data)}/{seeds} | {median[1]:.3f}{theirs[0]} | {data[:, 1].max(initial=0):.2f} | "
                f"{median[2]:.1f}{theirs[1]} | {median[4]:.2f} | {median[3]:.1f}{theirs[2]} | {median[5]:.2f} |"
            )
            print(lines[-1], flush=True)
    return "\n".join(lines)
