"""What the paper prints, to stand beside what is measured here."""

from dataclasses import dataclass

from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.brackets import VectorField, f, g, h

TABLE_1 = {1: (0, 0, 0, 1, 1, 1), 2: (0, 1, 1, 0, 0, 1), 3: (1, 0, 1, 0, 1, 0)}
"""Membership of R1 to R6 in each group."""


@dataclass(frozen=True)
class Row:
    """A row of Table 3 or 4: averages over the instances that were solved.

    Attributes:
        label: the paper's name.
        planner: ours.
        tolerance: goal radius, units; None: exact.
        solved: share of the instances, as text.
        time, nodes, path, execution: s, -, units, s; None: the paper gives none.
    """

    label: str
    planner: str
    tolerance: float | None
    solved: str = ""
    time: float | None = None
    nodes: float | None = None
    path: float | None = None
    execution: float | None = None
    objective: str = "path"


TABLE_3 = (
    Row("Numerical Opt.", "optimize", None, "20/20", 0.80, None, 181.04, 76.33),
    Row("RRT with rot.", "rrt_rotation", 2.0, "20/20", 8.88, 147.20, 323.57, 172.36),
    Row("Original RRT", "rrt", 2.0, "5/20", 393.53, 7736.80, 332.10, 110.70),
    Row("Numerical Opt., driving time", "optimize", None, objective="time"),
    Row("Numerical Opt., K = 35", "optimize_paper", None, "20/20", 0.80, None, 181.04, 76.33),
)
TABLE_4 = (
    Row("RRT with rotation", "rrt_rotation", 1.5, "2/10", 1141.38, 8242.75, 384.62, 200.57),
    Row("Subgroup parallel", "parallel", 1.5, "10/10", 216.15, 2218.01, 868.66, 886.04),
    Row("Subgroup sequential", "sequential", 1.5, "10/10", 15.38, 102.10, 529.47, 577.41),
    Row("Pure control", "pure_control", 1.5, "10/10", 19.44, 175.50, 871.82, 1042.47),
    Row("Original RRT", "rrt", 1.5),
    Row("Numerical Opt.", "optimize", None),
)
"""Not in the paper: the fourth row of Table 3, and the last two of Table 4. Its first row stands twice in Table 3, for our
planner and for its own variant, which in the paper may collide."""


IC4 = ((4, 5), (1, 3), (2, 6))
"""Its subgroups, in the order of the paper's figures."""


@dataclass(frozen=True)
class Bracket:
    """A row of Table 2: [first, second] and the robots it moves."""

    text: str
    first: VectorField
    second: VectorField
    robots: tuple[int, ...]


def table_2(swarm: Swarm) -> list[Bracket]:
    """Return the rows of Table 2, their fields built for a swarm of six."""
    h1, h2, h3, f4 = (*(h(swarm, i) for i in (1, 2, 3)), f(swarm, 4))
    g1, g2, g3 = (g(swarm, i) for i in (1, 2, 3))
    return [
        Bracket("[h2, g1]", h2, g1, (4, 5)),
        Bracket("[h3, g1]", h3, g1, (4, 6)),
        Bracket("[h1, g2]", h1, g2, (2, 3)),
        Bracket("[h3, g2]", h3, g2, (2, 6)),
        Bracket("[h1, g3]", h1, g3, (1, 3)),
        Bracket("[h2, g3]", h2, g3, (1, 5)),
        Bracket("[h1 + h2 - f4, g3]", h1 + h2 - f4, g3, (1,)),
        Bracket("[h1 + h3 - f4, g2]", h1 + h3 - f4, g2, (2,)),
        Bracket("[f4 - h3, g2]", f4 - h3, g2, (3,)),
        Bracket("[h2 + h3 - f4, g1]", h2 + h3 - f4, g1, (4,)),
        Bracket("[f4 - h3, g1]", f4 - h3, g1, (5,)),
        Bracket("[f4 - h2, g1]", f4 - h2, g1, (6,)),
    ]
