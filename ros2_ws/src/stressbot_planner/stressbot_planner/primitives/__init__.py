"""Motion primitives of the paper, the vector fields and Lie brackets behind them, and subgroups."""
