"""What a recording holds, as the page's plain data by kind and time."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from stressbot_msgs.action import MoveSwarm, PlanMotion
from stressbot_msgs.bounds import excess
from stressbot_msgs.msg import DriverStatus, MotionPlan, SwarmDescription, SwarmPoses, VoltageSequence

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import recording
from stressbot_planner.ros import view_words as words
from stressbot_planner.ros.conversion import Scene, scene_from_description

MOST_NUMBERS = 6_000_000
"""Of all poses; of more, frames are left out evenly."""

APART = 1 / 30
"""s from one frame to the next, at least"""


class _Track:
    """Contents of one kind, and their times, s since the beginning; what says the same again is left out."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.contents: list[Any] = []

    def add(self, time: float, content: Any) -> None:
        if not self.contents or self.contents[-1] != content:
            self.times.append(round(time, 3))
            self.contents.append(content)

    def told(self) -> dict[str, Any]:
        return {"times": self.times, "contents": self.contents}


class _Reader:
    """Reads messages of one swarm's nodes: those in the namespace of the first description."""

    def __init__(self) -> None:
        self.tracks = {kind: _Track() for kind in ("scene", "status", "motion", "frame", "planning", "moving")}
        self.prefix: str | None = None
        self._scene: Scene | None = None
        self._plan: MotionPlan | None = None
        self._sequence: VoltageSequence | None = None
        self._framed = -np.inf
        self._history: list[list[float]] = []
        self.hears: dict[str, tuple[type, Callable[[float, Any], None]]] = {
            "swarm_description": (SwarmDescription, self._described),
            "driver_status": (DriverStatus, lambda time, message: self.tracks["status"].add(time, words.status_of(message))),
            "swarm_poses": (SwarmPoses, self._seen),
            "motion_plan": (MotionPlan, self._planned),
            "accepted_plan": (MotionPlan, self._planned),
            "voltage_sequence": (VoltageSequence, self._sequenced),
            "plan_motion_action/_action/feedback": (PlanMotion.Impl.FeedbackMessage, self._searched),
            "move_swarm/_action/feedback": (MoveSwarm.Impl.FeedbackMessage, self._moved),
        }

    def read(self, time: float, topic: str, data: bytes) -> None:
        """Take in a message if it is one of these. Raises StressbotError if it is no such message, or refused."""
        if self.prefix is None:
            if not topic.endswith("/swarm_description"):
                return
            self.prefix = topic.removesuffix("swarm_description")
        if not topic.startswith(self.prefix) or (name := topic.removeprefix(self.prefix)) not in self.hears:
            return
        kind, hear = self.hears[name]
        try:
            message: Any = deserialize_message(data, kind)
        except Exception as error:  # whatever the middleware raises
            raise StressbotError(ErrorCode.MALFORMED_FILE, topic, f"has a message that cannot be read ({error})") from error
        if (problem := excess(message)) is not None:
            raise StressbotError(ErrorCode.LIMIT_EXCEEDED, f"{topic}.{problem[0]}", problem[1])
        hear(time, message)

    def _described(self, time: float, message: SwarmDescription) -> None:
        self._scene = scene_from_description(message)
        self.tracks["scene"].add(time, words.scene_of(self._scene))

    def _seen(self, time: float, message: SwarmPoses) -> None:
        if self._scene is None or message.swarm_id != self._scene.swarm_id or time < self._framed + APART:
            return
        self._framed = time
        self.tracks["frame"].add(time, words.frame_of(words.poses_of(message, self._scene), message.sequence_time))

    def _planned(self, time: float, message: MotionPlan) -> None:
        self._plan = message
        self._show(time)

    def _sequenced(self, time: float, message: VoltageSequence) -> None:
        self._sequence = message
        self._show(time)

    def _show(self, time: float) -> None:
        if self._scene is not None and self._plan is not None and self._plan.swarm_id == self._scene.swarm_id:
            self.tracks["motion"].add(time, words.motion_of(self._plan, self._sequence, self._scene))

    def _searched(self, time: float, message: Any) -> None:
        news = words.planning_of(message.feedback)
        if self._history and news["elapsed"] < self._history[-1][0]:
            self._history = []
        if news["found"]:
            self._history = [*self._history, [news["elapsed"], news["path"], news["driving"]]]
        self.tracks["planning"].add(time, {**news, "active": True, "history": self._history})

    def _moved(self, time: float, message: Any) -> None:
        self.tracks["moving"].add(time, {**words.moving_of(message.feedback), "active": True})


def recorded(path: Path) -> dict[str, Any]:
    """Return what the page shows of a recording.

    Raises:
        StressbotError: it cannot be read, holds no swarm, or one of its messages is refused.
    """
    reader, begin, end = _Reader(), 0, 0
    kept = [message for message in recording.read(path) if message.topic.name.endswith(tuple(reader.hears))]
    for message in sorted(kept, key=lambda message: message.heard):  # a recorder writes them nearly so
        if reader.prefix is None:  # what comes before a swarm is described shows nothing
            begin = message.heard
        end = message.heard
        reader.read((message.heard - begin) * 1e-9, message.topic.name, message.data)
    tracks = reader.tracks
    if not tracks["scene"].contents:
        raise StressbotError(
            ErrorCode.MISSING_FIELD, "recording", f"{path} holds no swarm_description: record all topics, from the beginning"
        )
    frames = tracks["frame"]
    numbers = sum(len(frame["p"]) for frame in frames.contents)
    every = -(-numbers // MOST_NUMBERS) if numbers else 1
    frames.times, frames.contents = frames.times[::every], frames.contents[::every]
    return {
        "file": "RECORDING",
        "scene": tracks["scene"].contents[0],
        "duration": (end - begin) * 1e-9,
        "recorded": {kind: track.told() for kind, track in tracks.items() if track.contents},
    }
