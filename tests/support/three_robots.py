"""A small scenario with an obstacle between starts and goals."""

SCENARIO = """
name: three
length_unit: 1.0e-4
workspace: {x: [0, 12], y: [0, 12]}
obstacles: [{circle: {center: [5, 6], radius: 1.0}}]
swarm: {speed: 1.0, turning_radius: 1.0, body_radius: 0.3, groups: binary}
robots:
  - {start: [2, 2, 0], goal: [7, 8]}
  - {start: [2, 6, 0], goal: [8, 2]}
  - {start: [2, 10, 0], goal: [8, 5]}
"""
