"""The tracker: pictures in, poses of robots with their ids out.

Each picture: what drives should have done is predicted, robots are measured where they are expected, the stage by those that do
not slide, and each robot's filter takes its measurement in. Robots that are missed are looked for again, at first where they should
be, then everywhere. Nobody gets an id by being near: a track keeps the one that it has, or earns one by how it moves.

A hand may exchange robots that look alike while nobody sees them. So those that were out of sight at the same time keep their names
only if each of them is again just where it should be; and all names are given up where robots lie in each other's places, or move
as if they had been exchanged.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from stressbot_driver.vision.absences import Absences
from stressbot_driver.vision.activations import NOTHING, Activations
from stressbot_driver.vision.background import Background
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.detection import SEARCHING_STEPS, Detector, Measured
from stressbot_driver.vision.filters import LATE, PoseFilters
from stressbot_driver.vision.identities import WORST, Identities, reversed_poses
from stressbot_driver.vision.latency import driven_for
from stressbot_driver.vision.outline import Outline
from stressbot_driver.vision.planar import wrapped
from stressbot_driver.vision.stage import StageFilter

GOOD, NAMELESS, FAINT, FEATURELESS = 0.35, 0.5, 0.4, 5.0
"""Least quality of a measurement, of one that may be of anything, its contrast relative to the usual one, and grey levels below
which there is none."""

WHITE = 255.0
"""Grey level; no contrast is larger."""

GATE = 25.0
"""Of a squared Mahalanobis distance of a measurement from what was expected."""

NEAR, NEAR_DRIVEN, NEAR_AT_REST = 0.12, 0.5, 0.2
"""Of the length, and rad while drives run and while none does: a measurement that is so close to what was expected passes in any
case."""

SETTLED = 0.06
"""s after a drive: by then who is missed has not been looked for at a time that was told a little wrong."""

SAME = 0.35
"""Of the length: two tracks that are so close are one."""

SEARCH_EVERY = 0.5
"""s between two looks at all of a picture."""

MISSED_FOR = 0.25
"""s that robots are missed before all of a picture is searched for them."""

ASTRAY, MOST_ASTRAY = 0.15, 0.25
"""Of the length, a second, and at most: standard deviation of where a robot is that is not where it should be."""

WANDERING = 0.5
"""Of the way that an unknown track could have gone: standard deviation of where it is."""

LOST = 1.0
"""Body lengths: a robot that nobody knows better where it is, is not taken for the one that shows up there."""

BACK_WITHIN = 5.0
"""s after a reset in which some robots may be looked for at their starts, while others have been there before."""

AT_START = (0.5, np.radians(25.0))
"""Lengths and rad from its start within which a robot is taken to be there."""

ALIKE = (0.1, 4.0, 3)
"""Robots that lie beside their starts by so much in the mean, of the length, and in standard deviations of that mean, at least so
many of them, have not been set down so: the stage has moved."""

MOST_FALSE = 20
"""Tracks beyond the number of robots."""


@dataclass(frozen=True, eq=False)
class Robots:
    """Who is on the substrate; as in `swarm_description`."""

    ids: np.ndarray
    speed: np.ndarray
    turning_rate: np.ndarray
    membership: np.ndarray
    start: np.ndarray | None
    """Shape (n, 3); None: they may be anywhere."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What a picture shows.

    Attributes:
        ids: of the robots that are seen and known, shape (k,).
        poses: theirs, shape (k, 3), m, m, rad in (-pi, pi].
        nameless: poses of what else looks like a robot, and moved like one if it could, shape (j, 3); first who did most.
        moved: s of a drive for which robots have moved since the picture before; NaN: not known.
        notes: what has happened to tracks, a sentence each.
    """

    ids: np.ndarray
    poses: np.ndarray
    nameless: np.ndarray
    moved: float
    notes: list[str] = field(default_factory=list)


class SwarmTracker:
    """Follows robots through pictures.

    Attributes:
        stage: where the substrate is.
        missing: ids of robots that were not seen in the last picture.
        displaced: m by which robots lay beside their starts, all alike, when they were taken for those; 0: not alike.
    """

    def __init__(self, robots: Robots, camera: Camera, outlines: Sequence[Outline]) -> None:
        """`outlines`: one a robot."""
        self._robots = robots
        kinds = sorted(set(outlines), key=outlines.index)
        self._kind_of_robot = np.array([kinds.index(outline) for outline in outlines])
        self._detector = Detector(camera, kinds)
        self._camera, self._pixel = camera, camera.pixel
        self._background = Background(camera.height, camera.width)
        self.stage = StageFilter(camera.center, camera.pixel, 0.5 * camera.pixel * max(camera.width, camera.height))
        self._filters = PoseFilters(camera.pixel)
        self._identities = Identities(robots.membership, robots.speed, robots.turning_rate)
        self._robot = np.empty(0, dtype=int)  # of each track, -1: not known
        self.displaced = 0.0
        self._reset = -np.inf  # s, when robots may have been put back
        self._may_start = True  # whether robots may be taken for those at whose starts they are
        self._kind = np.empty(0, dtype=int)
        self._unseen = np.empty(0)  # s
        self._measured = np.empty((0, 3))  # poses by the last picture that showed each
        self._absences = Absences()
        self._contrast: float | None = None
        self._activations, self._at = NOTHING, 0.0
        self._stamp = -np.inf  # of the picture that is looked at, or was last
        self._resolution = 0.5 * camera.pixel + 0.01 * float(self._detector.length.max())  # m, of a motion
        self._searched = -np.inf
        self._rest: tuple[int, np.ndarray, np.ndarray] | None = None  # activations done, poses then, and which tracks were seen
        self._begun: tuple[int, np.ndarray, np.ndarray] | None = None  # the same, as the drive that runs began
        self._begun_at_rest = False
        self._driven = -np.inf  # when something was driven last, by the stamp of a picture
        self._notes: list[str] = []
        self._moved = np.nan

    @property
    def missing(self) -> list[int]:
        """Ids of robots that the last picture did not show, or not surely."""
        shown = set(self._robot[(self._robot >= 0) & (self._unseen == 0.0)].tolist())
        return [int(robot) for row, robot in enumerate(self._robots.ids.tolist()) if row not in shown]

    def play(self, activations: Activations) -> None:
        """From now on sequence times are those of another sequence, which has not begun."""
        if self._activations.driving(self._at):
            self._rest = None
        elif self._rest is not None:  # the drives of the new one may begin before its first picture
            self._rest = 0, *self._rest[1:]
        self._activations, self._at, self._begun = activations, 0.0, None

    def reset(self) -> None:
        """Robots may be back at their starts, until something is driven."""
        self._may_start, self._reset = True, self._stamp

    def look(self, picture: np.ndarray, stamp: float, at: float | None) -> Seen:
        """Take in a picture.

        Args:
            picture: shape (height, width), uint8.
            stamp: when it was taken, s, later than the one before.
            at: sequence time then; None: what is driven is not known.
        """
        self._notes = []
        seconds = max(0.0, stamp - self._stamp) if np.isfinite(self._stamp) else 0.0
        self._stamp = stamp
        if at is not None and self._begun is not None and self._activations.begun(at) > self._begun[0] + 1:
            self._doubt(self._at, True, False)
        still = self._predict(seconds, at)
        before, found = self._measured.copy(), np.zeros(len(self._robot), dtype=bool)
        if len(self._robot):
            found = self._measure(picture, still, at is not None and not self._activations.driving(at))
        self._moved = self._driven_since(before, found & (self._unseen == 0.0))
        self._absences.note(found, stamp)
        self._unseen = np.where(found, 0.0, self._unseen + max(seconds, 1e-9))
        if at is not None and self._begun is not None:
            settled = self._activations.done(at) > self._begun[0] and stamp >= self._driven + SETTLED
            self._doubt(at, settled, settled)
        if self._is_search_due(stamp):
            self._searched = stamp
            self._search(picture)
        self._forget()
        self._learn_background(picture, stamp)
        if at is not None:
            self._identify(at)
        return self._seen()

    def _driven_since(self, before: np.ndarray, rows: np.ndarray) -> float:
        """As `driven_for`, by tracks (k,) that are seen in this picture and the last: by those without a name only if all are."""
        named = rows & (self._robot >= 0)
        speed, rate = self._robots.speed, self._robots.turning_rate
        if named.any():
            robot = self._robot[named]
            return driven_for(before[named], self._measured[named], speed[robot], rate[robot])
        return driven_for(before[rows], self._measured[rows], np.median(speed), np.median(rate))

    def _learn_background(self, picture: np.ndarray, stamp: float) -> None:
        """Once all robots are seen, of which what has no name may be none."""
        named = self._robot >= 0
        if not self._background.is_due(stamp) or int(np.sum(named & (self._unseen == 0.0))) < len(self._robots.ids):
            return
        seen = self.stage.to_picture(self._filters.poses[named])
        self._background.learn(picture, stamp, self._camera.to_pixels(seen[:, :2]), self._detector.around(self._kind[named]))

    def _predict(self, seconds: float, at: float | None) -> np.ndarray:
        """Move tracks as they should have moved; return which of them have surely stayed where they were."""
        self.stage.predict(seconds)
        filters, robots = self._filters, self._robots
        filters.rest(seconds)
        nameless, named = np.flatnonzero(self._robot < 0), np.flatnonzero(self._robot >= 0)
        still = np.ones(len(self._robot), dtype=bool)
        if at is None:
            self._begun, self._driven = None, self._stamp
            most = np.max(robots.speed, initial=0.0) * seconds, np.max(robots.turning_rate, initial=0.0) * seconds
            filters.wander(np.arange(len(self._robot)), *(np.full(len(self._robot), WANDERING * part) for part in most))
            return np.zeros(len(self._robot), dtype=bool)
        done, at_rest = self._activations.done(self._at), not self._activations.driving(self._at)
        for group, driven, begins in self._activations.between(self._at, at):
            self._may_start, self._driven = False, self._stamp
            if begins:
                self._begun, self._begun_at_rest = (done, filters.poses.copy(), self._unseen == 0.0), at_rest
            done, at_rest = done + 1, False
            slides, turns = np.zeros(len(self._robot)), np.zeros(len(self._robot))
            row = self._robot[named]
            member = self._identities.slides(group)[row]
            slides[named] = np.where(member, robots.speed[row] * driven, 0.0)
            turns[named] = np.where(member, 0.0, robots.turning_rate[row] * driven)
            filters.drive(slides, turns, driven, begins)
            far, round_ = robots.speed.max() * driven, robots.turning_rate.max() * driven
            filters.wander(nameless, *(np.full(len(nameless), WANDERING * part) for part in (far, round_)))
            still[named] &= ~member
            still[nameless] = False
        self._at = at
        return still

    def _astray(self) -> np.ndarray:
        """Covariances of how far beside where they should be tracks may be, the more the longer they are missed, (k, 3, 3)."""
        astray = np.minimum(ASTRAY * np.sqrt(self._unseen), MOST_ASTRAY) * self._detector.length[self._kind]
        return (astray**2)[:, None, None] * np.diag([1.0, 1.0, 0.0])

    def _spread(self) -> np.ndarray:
        """Standard deviations of where tracks are, shape (k,), m."""
        return np.sqrt(np.einsum("kii->k", (self._filters.covariance + self._astray())[:, :2, :2]))

    def _measure(self, picture: np.ndarray, still: np.ndarray, at_rest: bool) -> np.ndarray:
        """Measure all tracks where they are expected; return which were seen (k,)."""
        expected = self.stage.to_picture(self._filters.poses)
        measured = self._detector.measure(picture, expected, self._kind, firm=self._robot >= 0, background=self._background.mean)
        good = self._fits(measured) & ((measured.quality > NAMELESS) | (self._robot >= 0))
        # The stage may have jumped with all: robots that agree are no mistake of each other.
        landmarks = np.flatnonzero(good & still & (self._unseen == 0.0))
        if len(landmarks):
            covariance = measured.covariance[landmarks, :2, :2] + self._filters.covariance[landmarks, :2, :2]
            self.stage.update(self._filters.poses[landmarks, :2], measured.poses[landmarks, :2], covariance)
        rows = np.arange(len(good))
        poses = self.stage.to_substrate(measured.poses)
        off = self._filters.distance(rows, poses, measured.covariance)
        length = self._detector.length[self._kind]
        near = np.hypot(*(poses - self._filters.poses)[:, :2].T) < NEAR * length
        near &= np.abs(wrapped(poses[:, 2] - self._filters.poses[:, 2])) < (NEAR_AT_REST if at_rest else NEAR_DRIVEN)
        just_there = (off < GATE) | near
        astray = self._astray()
        good &= just_there | (self._filters.distance(rows, poses, measured.covariance + astray) < GATE)
        # A track that was followed until now is not one that is missed, whoever is expected there.
        misfit = np.where(self._robot >= 0, off, 1e6 - measured.quality) + np.where(self._unseen > 0.0, 1e7, 0.0)
        self._drop_doubles(good, poses, misfit, length)
        self._distrust(good & ~just_there)
        rows = np.flatnonzero(good)
        self._measured[rows] = poses[rows]
        self._filters.covariance[rows] += astray[rows]
        self._filters.update(rows, poses[rows], measured.covariance[rows])
        if len(rows):
            usual = float(np.median(measured.contrast[rows]))
            self._contrast = usual if self._contrast is None else 0.9 * self._contrast + 0.1 * usual
        return good

    def _fits(self, measured: Measured) -> np.ndarray:
        size = np.abs(measured.contrast)
        enough = (measured.quality > GOOD) & (size > FEATURELESS) & (size < WHITE)
        return enough if self._contrast is None else enough & (measured.contrast / self._contrast > FAINT)

    def _drop_doubles(self, good: np.ndarray, poses: np.ndarray, misfit: np.ndarray, length: np.ndarray) -> None:
        """Of two tracks that were measured at one place, the one that fits worse was not seen."""
        middles = self._detector.middles(poses, self._kind)
        for a, b in np.argwhere(np.triu(np.hypot(*(middles[:, None] - middles).transpose(2, 0, 1)) < SAME * length, 1)):
            if good[a] and good[b]:
                good[a if misfit[a] > misfit[b] else b] = False

    def _is_search_due(self, stamp: float) -> bool:
        if stamp < self._searched + SEARCH_EVERY:
            return False
        named, seen = self._robot >= 0, (self._unseen == 0.0) & self._may_be_robots()
        return int(np.sum((self._unseen < MISSED_FOR) & (named | seen))) < len(self._robots.ids)

    def _may_be_robots(self) -> np.ndarray:
        """Whether tracks moved as some robot should: what stands while all robots move is dust."""
        return self._identities.score.max(axis=1, initial=-np.inf) > WORST

    def _search(self, picture: np.ndarray) -> None:
        """Look at all of a picture for robots that no track explains."""
        self._look_at_starts(picture)
        parts = []
        for kind in np.unique(self._kind_of_robot):
            found = self._detector.find(picture, int(kind))
            if self._contrast is not None:
                found = found.of(np.flatnonzero(found.contrast / self._contrast > FAINT))
            parts.append((found, np.full(len(found.poses), kind)))
        found = Measured(*(np.concatenate(part) for part in zip(*(vars(one).values() for one, _ in parts), strict=True)))
        kinds = np.concatenate([kind for _, kind in parts])
        poses, length = self.stage.to_substrate(found.poses), self._detector.length[kinds]
        now = self._unseen == 0.0
        seen = self._detector.middles(self._filters.poses[now], self._kind[now])
        middles = self._detector.middles(poses, kinds)
        new: list[int] = []
        for row in np.argsort(-found.quality).tolist():
            others = np.vstack([seen, middles[new]])
            if not len(others) or np.hypot(*(others - middles[row]).T).min() > SAME * length[row]:
                new.append(row)
        found, kinds, poses = found.of(np.array(new, dtype=int)), kinds[new], poses[new]
        taken = self._claim(found, kinds, poses)
        left = np.flatnonzero(~taken)[: len(self._robots.ids) + MOST_FALSE - len(self._robot)]
        self._begin(poses[left], found.covariance[left], kinds[left], -1)
        self._look_for_exchanged()
        if self._contrast is None and len(found.contrast):
            self._contrast = float(np.median(found.contrast))

    def _claim(self, found: Measured, kinds: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """Give what was found to tracks that are missed, by one assignment within gates; return which is taken.

        Where a track could be two of them, or two tracks the same, nobody is sure: what they were called is forgotten.
        """
        missed = np.flatnonzero(self._unseen > 0.0)
        taken = np.zeros(len(poses), dtype=bool)
        if not len(missed) or not len(poses):
            return taken
        length = self._detector.length[self._kind[missed]]
        spread, astray = self._spread()[missed], self._astray()
        cost, strict = (
            np.array([
                np.where(
                    (kinds == self._kind[track]) & (spread[k] < LOST * length[k]),
                    self._filters.distance(np.full(len(poses), track), poses, found.covariance + much[track]),
                    np.inf,
                )
                for k, track in enumerate(missed)
            ])
            for much in (astray, np.zeros_like(astray))
        )
        gated = cost < GATE
        rows, columns = linear_sum_assignment(np.where(gated, cost, 1e6))
        for k, column in zip(rows, columns, strict=True):
            if not gated[k, column]:
                continue
            track = missed[k]
            doubt = (gated[k].sum() > 1 or gated[:, column].sum() > 1) and self._robot[track] >= 0
            if doubt:
                self._lose(int(track), "it could be another one that is near")
            elif strict[k, column] >= GATE:
                self._distrust(np.arange(len(self._robot)) == track)
            self._filters.covariance[track] += astray[track]
            self._filters.update(np.array([track]), poses[[column]], found.covariance[[column]])
            self._measured[track] = poses[column]
            self._unseen[track], taken[column] = 0.0, True
        self._absences.note(self._unseen == 0.0, self._stamp)
        return taken

    def _look_at_starts(self, picture: np.ndarray) -> None:
        """Where starts are known and most robots are there, they are these: before anything was seen, or after a reset."""
        robots = self._robots
        shown = set(self._robot[(self._robot >= 0) & (self._unseen == 0.0)].tolist())
        most = len(robots.ids) - 1 if self._stamp < self._reset + BACK_WITHIN else len(robots.ids) // 2
        if robots.start is None or not self._may_start or len(shown) > most:
            return
        expected = self.stage.to_picture(robots.start)
        firm = np.ones(len(expected), dtype=bool)
        measured = self._detector.measure(picture, expected, self._kind_of_robot, SEARCHING_STEPS, firm)
        poses = self.stage.to_substrate(measured.poses)
        length, (near, alike) = self._detector.length[self._kind_of_robot], AT_START
        there = self._fits(measured) & (np.hypot(*(poses - robots.start)[:, :2].T) < near * length)
        there &= np.abs(wrapped(poses[:, 2] - robots.start[:, 2])) < alike
        if there.sum() <= len(robots.ids) // 2:
            return
        keep = np.flatnonzero(~np.isin(self._robot, np.flatnonzero(there)))
        self._keep(keep)
        self._may_start = False
        for robot in np.flatnonzero(there):
            self._begin(poses[[robot]], measured.covariance[[robot]], self._kind_of_robot[[robot]], int(robot))
        if self._contrast is None:
            self._contrast = float(np.median(measured.contrast[there]))
        self._notes.append(f"{int(there.sum())} of {len(there)} robots are at their starts")
        self.displaced = _alike((poses - robots.start)[there, :2], float(length.max()))

    def _begin(self, poses: np.ndarray, covariance: np.ndarray, kinds: np.ndarray, robot: int) -> None:
        first = len(self._robot)
        self._filters.add(poses, covariance)
        self._identities.add(len(poses))
        self._kind = np.concatenate([self._kind, kinds])
        self._robot = np.concatenate([self._robot, np.full(len(poses), robot)])
        self._unseen = np.concatenate([self._unseen, np.zeros(len(poses))])
        self._measured = np.concatenate([self._measured, poses])
        self._absences.add(len(poses), self._stamp)
        if robot >= 0:
            self._identities.start(first, robot)
        self._rest, self._begun = (
            was and (was[0], np.concatenate([was[1], poses]), np.concatenate([was[2], np.zeros(len(poses), dtype=bool)]))
            for was in (self._rest, self._begun)
        )

    def _keep(self, rows: np.ndarray) -> None:
        self._filters.keep(rows)
        self._identities.keep(rows)
        self._absences.keep(rows)
        self._measured = self._measured[rows]
        self._kind, self._robot, self._unseen = self._kind[rows], self._robot[rows], self._unseen[rows]
        self._rest, self._begun = (was and (was[0], was[1][rows], was[2][rows]) for was in (self._rest, self._begun))

    def _lose(self, track: int, why: str) -> None:
        self._notes.append(f"robot {self._robots.ids[self._robot[track]]} is not known for sure any more: {why}")
        self._robot[track] = -1
        self._identities.forget(track)

    def _lose_all(self, tracks: np.ndarray, why: str) -> None:
        for track in np.flatnonzero(tracks & (self._robot >= 0)):
            self._lose(int(track), why)

    def _distrust(self, beside: np.ndarray) -> None:
        """Tracks, shape (k,), that were out of sight at rest are found beside where they were: a hand may have been at work."""
        named = self._robot >= 0
        for track in np.flatnonzero(beside & named & (self._absences.seen >= self._driven)):
            others = self._absences.together(int(track), self._stamp) & named
            if others.sum() > 1:
                self._lose_all(others, "others that were out of sight with it are not where they should be")

    def _look_for_exchanged(self) -> None:
        """Where strangers lie in the places of two or more that are missed at rest, a hand has exchanged them, perhaps others."""
        missed = np.flatnonzero((self._robot >= 0) & (self._unseen > 0.0) & (self._absences.seen >= self._driven))
        strangers = (self._robot < 0) & (self._unseen == 0.0)
        middles = self._detector.middles(self._filters.poses, self._kind)
        away = np.hypot(*(middles[missed, None] - middles[strangers]).transpose(2, 0, 1))
        if np.sum(away.min(axis=1, initial=np.inf) < SAME * self._detector.length[self._kind[missed]]) > 1:
            self._lose_all(self._robot >= 0, "others lie where robots should be that are missed")

    def _doubt(self, at: float, last: bool, settled: bool) -> None:
        """Give up the names of those that move as if they had been exchanged, by the picture at a sequence time.

        `last`: no other picture will show more of the drive. `settled`: all robots are at rest, and those that are missed stay so.
        """
        if self._begun is None:
            return
        k, before, had = self._begun
        group = int(self._activations.groups[k])
        named, seen = had & (self._robot >= 0), self._unseen == 0.0
        late = 0.0 if settled else LATE
        driven = min(at, float(self._activations.ends[k])) - float(self._activations.begins[k])
        if last:
            self._begun = None
        if not group or driven < 2.0 * late or not seen.any():
            return
        rows = np.flatnonzero(named & seen)
        spread = np.hypot(self._resolution, 0.0 if self._begun_at_rest else LATE * float(self._robots.speed.max()))
        middle = self._detector.middle[self._kind[rows]]
        failed, exchanged = self._identities.compare(
            self._robot[rows], before[rows], self._measured[rows], middle, group, driven, spread, late
        )
        missed = named & ~seen
        if exchanged.any():
            doubtful = missed.copy()
            doubtful[rows[exchanged]] = True
            self._lose_all(doubtful, "robots move as if they had been exchanged")
        if settled:
            missed[rows[failed]] = True
            if len(set(self._identities.slides(group)[self._robot[missed & (self._robot >= 0)]].tolist())) > 1:
                self._lose_all(self._robot >= 0, "robots that should have slid, and others that should have turned, have not")

    def _forget(self) -> None:
        """Nameless tracks that are missed are gone; so is the name of one that may be anywhere by now."""
        gone = (self._robot < 0) & (self._unseen > MISSED_FOR)
        length = self._detector.length[self._kind]
        far = (self._robot >= 0) & (self._unseen > MISSED_FOR) & (self._spread() > LOST * length)
        for track in np.flatnonzero(far):
            self._notes.append(f"robot {self._robots.ids[self._robot[track]]} is lost")
        if np.any(gone | far):
            self._keep(np.flatnonzero(~(gone | far)))

    def _identify(self, at: float) -> None:
        """Compare tracks with robots by what the last activation did to those that were seen at rest before and after it."""
        if self._activations.driving(at):
            return
        done, seen = self._activations.done(at), self._unseen == 0.0
        if self._rest is not None and done == self._rest[0]:
            was = self._rest[2] | seen  # the newest poses of what was seen at this rest
            self._rest = done, np.where(seen[:, None], self._filters.poses, self._rest[1]), was
            return
        if self._rest is not None and done == self._rest[0] + 1 and self._activations.groups[done - 1]:
            _, before, had = self._rest
            rows = np.flatnonzero(had & seen)
            if len(rows):
                k = done - 1
                seconds = float(self._activations.ends[k] - self._activations.begins[k])
                group = int(self._activations.groups[k])
                poses, middle = self._filters.poses[rows], self._detector.middle[self._kind[rows]]
                reversed_ = self._identities.learn(rows, before[rows], poses, middle, group, seconds, self._resolution)
                reversed_ &= self._robot[rows] < 0
                self._filters.poses[rows[reversed_]] = reversed_poses(poses, middle)[reversed_]
                self._rename()
        self._rest = done, self._filters.poses.copy(), seen.copy()

    def _rename(self) -> None:
        shown = np.flatnonzero(self._unseen < MISSED_FOR)  # who is missed keeps no other from a name
        was, known = self._robot.copy(), np.full(len(self._robot), -1)
        known[shown] = self._identities.known(shown, was[shown])
        for track in shown[(was[shown] >= 0) & (known[shown] < 0)]:
            self._lose(int(track), "it moves as another one should")
        for track in shown[(was[shown] < 0) & (known[shown] >= 0)]:
            for other in np.flatnonzero(self._robot == known[track]):
                self._lose(int(other), "another one moves as it should")
            self._robot[track] = known[track]
            self._notes.append(f"robot {self._robots.ids[known[track]]} is known by how it moves")

    def _seen(self) -> Seen:
        now = self._unseen == 0.0
        poses = self._filters.poses.copy()
        poses[:, 2] = wrapped(poses[:, 2])
        named = np.flatnonzero(now & (self._robot >= 0))
        named = named[np.argsort(self._robot[named])]
        nameless = np.flatnonzero(now & (self._robot < 0) & self._may_be_robots())
        nameless = nameless[np.argsort(-self._identities.score[nameless].max(axis=1), kind="stable")]
        return Seen(self._robots.ids[self._robot[named]], poses[named], poses[nameless], self._moved, self._notes)


def _alike(away: np.ndarray, length: float) -> float:
    """Return by how much robots lie away from their starts, (k, 2), in the mean, if that is no chance; otherwise 0."""
    least, deviations, count = ALIKE
    if len(away) < count:
        return 0.0
    mean = float(np.hypot(*away.mean(axis=0)))
    error = float(np.sqrt(away.var(axis=0, ddof=1).sum() / len(away)))
    return mean if mean > max(least * length, deviations * error) else 0.0
