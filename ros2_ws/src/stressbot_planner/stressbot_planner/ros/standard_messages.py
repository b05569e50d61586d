"""Paths and marks in the messages that RViz and Foxglove know."""

from collections.abc import Iterable, Mapping

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from nav_msgs.msg import Path
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from stressbot_planner.reporting.palette import COLOURS
from stressbot_planner.ros.conversion import FRAME
from stressbot_planner.ros.parameters import Number

VIEW_FRAME = "substrate_view"
"""In which lengths are magnified by `view_scale`: RViz shows nothing of a millimetre."""

VIEW_SCALE = Number(
    "view_scale", 1000.0, "Magnification of lengths in frame substrate_view, as the viewer's.", 1e-3, 1e9, read_only=True
)


def path_message(poses: np.ndarray, stamp: Time) -> Path:
    """Return a path of poses (k, 3), m and rad, in frame `substrate`."""
    header = Header(stamp=stamp, frame_id=FRAME)
    halves = poses[:, 2] / 2
    columns = np.column_stack([poses[:, :2], np.sin(halves), np.cos(halves)]).tolist()
    return Path(
        header=header,
        poses=[
            PoseStamped(header=header, pose=Pose(position=Point(x=x, y=y), orientation=Quaternion(z=z, w=w)))
            for x, y, z, w in columns
        ],
    )


def colour(row: int, alpha: float = 1.0) -> ColorRGBA:
    """Return the colour of a robot, as pictures have it."""
    text = COLOURS[row % len(COLOURS)]
    red, green, blue = (int(text[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return ColorRGBA(r=red, g=green, b=blue, a=alpha)


def lines(namespace: str, paths: Mapping[int, np.ndarray], scale: float, width: float, alpha: float) -> list[Marker]:
    """Return a line, magnified, for each path (k, 3), m and rad, by id of its robot; none of less than two poses. Width in m."""
    return [
        marker(namespace, robot, Marker.LINE_STRIP, scale * path[:, :2], scale * width, colour(row, alpha))
        for row, (robot, path) in enumerate(paths.items())
        if len(path) > 1
    ]


def marker(namespace: str, number: int, kind: int, places: np.ndarray, width: float, tone: ColorRGBA) -> Marker:
    """Return a marker made of lines through places (k, 2) in the magnified frame."""
    made = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, color=tone)
    made.header.frame_id = VIEW_FRAME
    made.pose.orientation.w = 1.0
    made.scale.x = width
    made.points = [Point(x=x, y=y) for x, y in places.tolist()]
    return made


def anew(markers: Iterable[Marker]) -> MarkerArray:
    """Return markers behind one that deletes those of before."""
    delete = Marker(action=Marker.DELETEALL)
    delete.header.frame_id = VIEW_FRAME
    return MarkerArray(markers=[delete, *markers])
