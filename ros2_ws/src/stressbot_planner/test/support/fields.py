"""Robots of unlike radii and speeds among an obstacle of each kind: what tests of the receding horizon share."""

from stressbot_planner.formats import scenario

FIELD = """
name: field
workspace: {x: [0, 12], y: [0, 12]}
obstacles:
  - circle: {center: [6, 6], radius: 1.0}
  - polygon: [[2, 8], [4, 8], [3, 10]]
swarm: {speed: [1.0, 0.5, 1.0, 0.8], turning_radius: [1.0, 0.7, 1.3, 1.0], body_radius: [0.3, 0.2, 0.4, 0.3]}
robots:
  - {start: [1, 1, 0.3], goal: [10, 10]}
  - {start: [1, 5, 1.3], goal: [10, 2]}
  - {start: [5, 1, 2.3], goal: [2, 5]}
  - {start: [9, 9, -2.0], goal: [6, 2]}
"""


def field():
    return scenario.parse(FIELD).problem
