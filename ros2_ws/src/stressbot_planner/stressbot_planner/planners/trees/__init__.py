"""Planners that grow trees (RRT), with groups or subgroups as moves."""
