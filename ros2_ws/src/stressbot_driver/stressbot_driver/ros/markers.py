"""Marker arrays that show a swarm in RViz, magnified: a scene of 2 mm is invisible there."""

import math

import numpy as np
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from stressbot_msgs.msg import Obstacle, SwarmDescription, SwarmPoses
from visualization_msgs.msg import Marker, MarkerArray

FRAME = "substrate_view"
FLAT = 0.02  # height of a flat marker, in body radii
POINT = 0.1  # radius that a point is drawn with, in turning radii

_BODY = ColorRGBA(r=0.12, g=0.47, b=0.71, a=0.9)
_HEADING = ColorRGBA(r=0.05, g=0.05, b=0.05, a=1.0)
_OBSTACLE = ColorRGBA(r=0.45, g=0.45, b=0.45, a=1.0)
_WALL = ColorRGBA(r=0.3, g=0.3, b=0.3, a=1.0)
_START = ColorRGBA(r=0.17, g=0.63, b=0.17, a=1.0)
_GOAL = ColorRGBA(r=0.84, g=0.15, b=0.16, a=1.0)


def fixed_markers(description: SwarmDescription, scale: float) -> MarkerArray:
    """Walls, obstacles, starts (green circles) and goals (red crosses), as in the paper's figures.

    The first marker deletes what an earlier swarm left behind.
    """
    radius = scale * _drawn_radius(description)
    thin = 0.1 * float(radius.min())
    markers = [_marker("", 0, Marker.CUBE, _WALL)]
    markers[0].action = Marker.DELETEALL
    if description.workspace:
        x0, x1, y0, y1 = (scale * value for value in description.workspace)
        walls = _marker("walls", 0, Marker.LINE_STRIP, _WALL, thin)
        walls.points = _points(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]))
        markers.append(walls)
    for index, obstacle in enumerate(description.obstacles):
        markers.append(_obstacle_marker(obstacle, index, scale, thin))

    start = scale * np.asarray(description.start).reshape(-1, 3)[:, :2]
    angles = np.linspace(0.0, 2.0 * math.pi, 17)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    ring = np.stack([circle[:-1], circle[1:]], axis=1).reshape(-1, 2)
    starts = _marker("starts", 0, Marker.LINE_LIST, _START, thin)
    starts.points = _points((start[:, None, :] + radius[:, None, None] * ring).reshape(-1, 2))
    goal = scale * np.asarray(description.goal).reshape(-1, 2)
    cross = np.array([[-0.7, -0.7], [0.7, 0.7], [-0.7, 0.7], [0.7, -0.7]])
    goals = _marker("goals", 0, Marker.LINE_LIST, _GOAL, thin)
    goals.points = _points((goal[:, None, :] + radius[:, None, None] * cross).reshape(-1, 2))
    return MarkerArray(markers=[*markers, starts, goals])


def robot_markers(description: SwarmDescription, poses: SwarmPoses, scale: float) -> MarkerArray:
    """Bodies (flat discs) and heading arrows of the robots that were seen; a few markers, however many robots."""
    row = {robot: index for index, robot in enumerate(description.ids)}
    seen = [k for k, robot in enumerate(poses.ids) if robot in row]
    drawn = scale * _drawn_radius(description)
    radius = drawn[[row[poses.ids[k]] for k in seen]]
    xy = scale * np.column_stack([poses.x, poses.y])[seen]
    heading = np.asarray(poses.heading)[seen]

    markers = []
    # A list marker has one size for all its points, so there is one list per body radius.
    for index, value in enumerate(np.unique(drawn)):
        bodies = _marker("bodies", index, Marker.SPHERE_LIST, _BODY)
        bodies.scale.x = bodies.scale.y = 2.0 * float(value)
        bodies.scale.z = FLAT * float(value)
        bodies.points = _points(xy[radius == value])
        markers.append(bodies)

    along = np.column_stack([np.cos(heading), np.sin(heading)]) * radius[:, None]
    across = np.column_stack([-along[:, 1], along[:, 0]])
    tip = xy + 1.3 * along
    strokes = [xy, tip, tip, tip - 0.4 * along + 0.25 * across, tip, tip - 0.4 * along - 0.25 * across]
    arrows = _marker("headings", 0, Marker.LINE_LIST, _HEADING, 0.12 * float(radius.min(initial=np.inf)) if seen else 0.1)
    arrows.points = _points(np.stack(strokes, axis=1).reshape(-1, 2), height=FLAT * float(radius.max(initial=0.0)))
    return MarkerArray(markers=[*markers, arrows])


def _drawn_radius(description: SwarmDescription) -> np.ndarray:
    """Radii (n,) [m] of the discs that show the robots: a point would not be seen."""
    body = np.asarray(description.body_radius)
    return np.where(body > 0.0, body, POINT * np.asarray(description.turning_radius))


def _obstacle_marker(obstacle: Obstacle, index: int, scale: float, thin: float) -> Marker:
    corners = scale * np.column_stack([obstacle.x, obstacle.y])
    if obstacle.kind == Obstacle.CIRCLE:
        marker = _marker("obstacles", index, Marker.CYLINDER, _OBSTACLE)
        marker.pose.position.x, marker.pose.position.y = map(float, corners[0])
        marker.scale.x = marker.scale.y = 2.0 * scale * obstacle.radius
        marker.scale.z = thin
        return marker
    marker = _marker("obstacles", index, Marker.LINE_STRIP, _OBSTACLE, thin)
    marker.points = _points(np.vstack([corners, corners[:1]]))
    return marker


def _marker(namespace: str, number: int, kind: int, color: ColorRGBA, width: float = 1.0) -> Marker:
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, color=color)
    marker.header.frame_id = FRAME
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = float(width)
    return marker


def _points(xy: np.ndarray, height: float = 0.0) -> list[Point]:
    return [Point(x=x, y=y, z=height) for x, y in xy.tolist()]
