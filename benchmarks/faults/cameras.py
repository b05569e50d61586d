"""The camera, its light, its pictures or its tracker fail; the robots are covered, or not alone."""

import copy
import signal
import time
from collections.abc import Callable
from functools import partial

from sensor_msgs.msg import Image
from stressbot_msgs.msg import DriverStatus, ErrorCode

from faults.settings import FILM_TIMEOUT, filmed
from faults.stage import Outcome, Stage

LOOK = 3.0
"""s in which poses must stay right."""

MOST_WRONG = 1.0
"""Body radii: nobody is taken for another one, or for what is none. Where a busy machine delays the driver's words, places lag."""

CAMERA, TRACKER = "simulated_camera", "camera_tracker"


Act = Callable[[Stage], None]


def lost(stage: Stage, fault: Act, mend: Act, said: str, comes_back: bool = True) -> Outcome:
    """Nobody is seen any more."""
    stage.running()
    logged, since = len(stage.system.log(TRACKER)), time.monotonic()
    fault(stage)
    zero, status = stage.at_rest(since, DriverStatus.FAULT, ErrorCode.POSES_LOST)
    if said:
        stage.until(lambda: said in stage.system.log(TRACKER)[logged:], f"{said!r} in the log of the tracker")
    assert not stage.call("start").success
    mend(stage)
    if comes_back:
        stage.until(lambda: not stage.status.missing, "poses again")
        assert stage.status.state == DriverStatus.FAULT
    told = f"{status.error_msg} (zero volts {1e3 * zero:.0f} ms after it, pose_timeout {1e3 * FILM_TIMEOUT:.0f} ms)"
    seen = f"the tracker: … {said} …; the driver: {told}" if said else told
    after = "still FAULT when poses come again; " if comes_back else ""
    return Outcome(seen, None, "FAULT POSES_LOST", after + _recovered(stage))


def told_rightly(stage: Stage, fault: Act, mend: Act, most: set[int], said: str) -> Outcome:
    """Some robots at most are told, all rightly, and the sequence goes on."""
    stage.running()
    logged, since = len(stage.system.log(TRACKER)), time.monotonic()
    fault(stage)
    stage.until(lambda: stage.film.ids(since) and stage.film.ids(since) <= most, f"poses of {most} at most")
    stage.until(lambda: said in stage.system.log(TRACKER)[logged:], f"{said!r} in the log of the tracker")
    begin = time.monotonic()
    stage.until(lambda: time.monotonic() > begin + LOOK)
    count, worst = stage.film.worst(begin)
    assert count and worst < MOST_WRONG, f"{count} poses, wrong by {worst:.2f} body radii"
    assert stage.status.state == DriverStatus.RUNNING and not stage.status.missing, stage.status
    mend(stage)
    if most != ALL:
        stage.film.wait_for_all()
    assert stage.status.state == DriverStatus.RUNNING
    seen = f"the tracker: … {said} …; {count} poses, the worst off by {worst:.2f} body radii"
    again = "all are seen again; " if most != ALL else ""
    return Outcome(seen, None, "RUNNING", again + _recovered(stage))


def _recovered(stage: Stage) -> str:
    """Robots are put elsewhere, as by hand: the tracker starts anew, and a sequence runs."""
    assert stage.call("stop").success
    assert stage.call("reset").success
    stage.system.processes.stop(TRACKER)
    stage.start(TRACKER)
    stage.film.wait_for_all()
    return f"reset and a new tracker, {stage.short_run()}"


def _set(stage: Stage, **values: object) -> None:
    stage.film.adjust(**values)


def _change(stage: Stage, change: Callable[[Image], list[Image]] | None) -> None:
    stage.film.change = change


def _setting(said: str, bad: dict, good: dict) -> Callable[[Stage], Outcome]:
    return partial(lost, fault=partial(_set, **bad), mend=partial(_set, **good), said=said)


def _changing(said: str, change: Callable[[Image], list[Image]]) -> Callable[[Stage], Outcome]:
    return partial(lost, fault=partial(_change, change=change), mend=partial(_change, change=None), said=said)


def _killed(name: str, said: str, comes_back: bool) -> Callable[[Stage], Outcome]:
    def kill(stage: Stage) -> None:
        stage.kill(name)

    return partial(lost, fault=kill, mend=lambda stage: stage.start(name), said=said, comes_back=comes_back)


def _frozen(name: str, said: str, comes_back: bool) -> Callable[[Stage], Outcome]:
    def send(number: signal.Signals, stage: Stage) -> None:
        stage.signal(name, number)

    return partial(lost, fault=partial(send, signal.SIGSTOP), mend=partial(send, signal.SIGCONT), said=said, comes_back=comes_back)


def _right(said: str, most: set[int], fault: Act, mend: Act) -> Callable[[Stage], Outcome]:
    return partial(told_rightly, fault=fault, mend=mend, most=most, said=said)


def _smaller(picture: Image) -> list[Image]:
    picture.height //= 2
    picture.data = picture.data[: picture.height * picture.step]
    return [picture]


def _of_16_bits(picture: Image) -> list[Image]:
    picture.encoding = "mono16"
    return [picture]


def _stamped_alike(picture: Image) -> list[Image]:
    picture.header.stamp.sec, picture.header.stamp.nanosec = 1, 0
    return [picture]


def _and_an_older_one(picture: Image) -> list[Image]:
    older = copy.copy(picture)
    older.header = copy.deepcopy(picture.header)
    older.header.stamp.sec -= 10
    return [picture, older]


STRANGERS, FAR = [4e-4, 1e-3, 0.5, 1.5e-4, 9.4e-4, 2.0], [1.0, 1.0, 0.0]
"""x, y [m] and heading of two, one of them close to robots 3 and 4; and of one that no picture shows."""

ALL, RIGHT_HALF = set(range(1, 7)), {4, 5, 6}

FAULTS = {
    "camera: kill -9": (filmed, _killed(CAMERA, "no picture has come", True)),
    "camera: its process frozen, goes on": (filmed, _frozen(CAMERA, "no picture has come", True)),
    "camera: the same picture again and again": (filmed, _setting("the camera is frozen", {"frozen": True}, {"frozen": False})),
    "camera: light off": (filmed, _setting("is the light on?", {"lamp": 0.0}, {"lamp": 150.0})),
    "camera: a hand over the lens": (filmed, _setting("is something in front of the lens?", {"hand": 1.0}, {"hand": 0.0})),
    "camera: a hand over half of the picture": (
        filmed, _right("are not seen", RIGHT_HALF, partial(_set, hand=0.5), partial(_set, hand=0.0)),
    ),
    "camera: objects that look like robots": (
        filmed, _right("", ALL, partial(_set, strangers=STRANGERS), partial(_set, strangers=FAR)),
    ),
    "camera: pictures of another size": (filmed, _changing("500 x 250 pixels, the camera file says 500 x 500", _smaller)),
    "camera: pictures of another encoding": (filmed, _changing("is 'mono16': set the camera to one of", _of_16_bits)),
    "camera: stamps that stand still": (filmed, _changing("before the last one", _stamped_alike)),
    "camera: a second one, 10 s behind": (
        filmed,
        _right("are there two cameras", ALL, partial(_change, change=_and_an_older_one), partial(_change, change=None)),
    ),
    "camera tracker: kill -9": (filmed, _killed(TRACKER, "", False)),
    "camera tracker: frozen, goes on": (filmed, _frozen(TRACKER, "", False)),
}
