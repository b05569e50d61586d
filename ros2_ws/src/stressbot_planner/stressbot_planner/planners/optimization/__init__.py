"""Planners over durations: nonlinear optimisation for a fixed group order, and the search for orders."""
