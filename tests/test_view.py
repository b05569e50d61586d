"""The page in a real browser, with real nodes behind it: what people do with it, and what happens to it."""

import contextlib
import math
import signal
import subprocess

import pytest
from browser import STRESSBOT, Page, browser, needs_chromium, serve
from stressbot_msgs.action import MoveSwarm, PlanMotion
from stressbot_msgs.msg import DriverStatus
from system_rig import DEADLINE
from three_robots import SCENARIO

pytestmark = [needs_chromium, pytest.mark.xdist_group("view")]

GOAL = (300.0, 900.0)
"""µm, where the first robot is sent."""
ARRIVED = "plane.seen?.errors?.every((error) => error !== null && error < 1)"
"""All robots are seen at their goals, to 1 µm."""


@pytest.fixture(scope="module")
def chromium():
    with browser() as chromium:
        yield chromium


@pytest.fixture
def opened(chromium):
    """Return a function that opens a page; all are closed at the end, and nothing may have gone wrong in them."""
    pages = []

    def open_page(address, **size):
        pages.append(Page(chromium, address, **size))
        return pages[-1]

    yield open_page
    for page in pages:
        page.close()


@pytest.fixture(scope="module")
def system(new_system, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "three.yaml"
    path.write_text(SCENARIO)
    return new_system(nodes=("driver", "sequencer", "planner", "mover"), scenario=path, real_time_factor=5.0)


@pytest.fixture(scope="module")
def address(system):
    return serve(system, "view")


@pytest.fixture
def at_rest(system):
    """Robots at their starts, and no plan."""
    system.client.trigger("stop")
    system.wait_for(lambda: system.client.driver_status.state != DriverStatus.RUNNING, "rest")
    assert system.client.trigger("reset").success


def planned(page):
    """Ask for a plan, again where a busy machine finds none in the page's time, and wait until it can be started."""
    for _ in range(10):
        page.get("window.lastSaid = state.said.at(-1)")
        page.click("plan")
        page.wait("state.said.at(-1) !== window.lastSaid && !state.planning.active")
        if "no collision-free plan from" not in page.get("state.said.at(-1)"):
            break
    page.wait("state.status.state === 'LOADED' && plane.seen.motion && !state.planning.active")


def test_a_goal_is_dragged_a_plan_made_started_stopped_and_driven_to_its_end(system, address, opened, at_rest):
    page, other = opened(address), opened(address.partition("#")[0])
    for each in (page, other):
        each.wait("state.services.includes('plan') && state.frame && state.status.state === 'IDLE'")
    page.page.fill("#time_limit", "1")
    page.page.select_option("#objective", "time")
    page.drag(0, *GOAL)
    for each in (page, other):  # both see the same
        each.wait(f"Math.hypot(state.goals[0][0] - {GOAL[0]}, state.goals[0][1] - {GOAL[1]}) < 8")
        each.wait("state.settings.objective === 'time' && state.settings.time_limit === 1")
    planned(page)
    other.wait("state.status.state === 'LOADED' && plane.seen.motion.count === state.status.epochs")
    goals = page.get("state.goals")
    assert math.dist(goals[0], GOAL) < 8 and other.get("state.motion.goals") == page.get("state.motion.goals") == goals
    page.picture("planned")
    page.click("start")
    page.wait("state.status.state === 'RUNNING' && plane.seen.group !== null")
    page.picture("running")
    other.page.click("#stop")  # a guest may
    page.wait("state.status.state === 'STOPPED'")
    assert system.client.driver_status.state == DriverStatus.STOPPED
    page.wait("state.said.some((line) => line.includes('stop: '))")  # the answer may come after the status
    planned(page)
    page.click("start")
    page.wait("state.status.state === 'DONE'")
    other.wait(f"state.status.state === 'DONE' && {ARRIVED}")
    page.wait(f"{ARRIVED} && live.rows.length > 5")
    page.picture("done")
    page.click("reset")
    page.wait("state.status.state === 'IDLE' && Math.hypot(state.frame.p[0] - 200, state.frame.p[1] - 200) < 1")
    assert page.asked_for == [address.partition("#")[0]]  # and nothing else is loaded


def test_a_guest_is_told_all_and_has_no_buttons_but_stop(address, opened):
    page = opened(address.partition("#")[0], width=390, height=800)
    page.wait("state.frame && state.services.includes('plan')")
    shown = "(one) => !one.disabled && one.id && one.offsetParent !== null || one.id === 'stop'"
    assert page.get(f"[...document.querySelectorAll('button')].filter({shown}).map((one) => one.id)") == ["stop"]
    assert page.get("plane.onGoal === null") and "looking on" in page.page.inner_text("#link")
    box = page.page.locator("#stop").bounding_box()
    assert box["y"] + box["height"] <= 800 and box["height"] > 40
    assert page.get("document.documentElement.scrollWidth <= innerWidth")
    page.picture("phone")


def test_keys_choose_a_robot_move_its_goal_and_stop(system, address, opened, at_rest):
    page = opened(address)
    page.wait("state.role.operator && link.isOpen && plane.onGoal && plane.seen?.swarm")
    page.page.focus("#swarm")
    before = page.get("state.goals")
    for key in ("n", "n", "ArrowUp", "Shift+ArrowLeft"):
        page.page.keyboard.press(key)
    x, y = before[1]
    page.wait(f"Math.abs(state.goals[1][0] - {x - 1}) < 0.1 && Math.abs(state.goals[1][1] - {y + 10}) < 0.1")
    faster = "for (let k = 0; k < 3; k++) byId('swarm').dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowUp' }))"
    page.get(f"() => {{ {faster}; }}")  # than the page is drawn
    page.wait(f"Math.abs(state.goals[1][1] - {y + 40}) < 0.1")
    page.click("goals")
    page.wait("Math.abs(state.goals[1][1] - state.scene.goals[1][1]) < 0.1")
    planned(page)
    page.click("start")
    page.wait("state.status.state === 'RUNNING'")
    page.page.keyboard.press("Escape")
    page.wait("state.status.state === 'STOPPED'")


def test_the_closed_loop_brings_robots_near_their_goals(address, opened, at_rest):
    page = opened(address)
    page.wait("state.services.includes('move') && state.status.state === 'IDLE' && plane.onGoal && plane.origin")
    for row, y in enumerate((200, 600, 1000)):
        page.drag(row, 300, y)
    page.page.fill("#near", "60")
    page.get("document.activeElement.blur()")
    page.wait("state.settings.near === 60 && state.goals.every(([x]) => Math.abs(x - 300) < 8)")
    page.click("move")
    page.wait("state.moving.active")
    page.wait("!state.moving.active && state.said.at(-1).includes('closed loop: all within')")
    assert max(page.get("plane.seen.errors")) < 70
    page.click("goals")


@pytest.mark.parametrize(
    ("action", "topic", "shown"), [(PlanMotion, "plan_motion_action", "planning"), (MoveSwarm, "move_swarm", "moving")]
)
def test_feedback_that_comes_after_the_end_begins_nothing(system, address, opened, at_rest, action, topic, shown):
    page = opened(address)
    kind = action.Impl.FeedbackMessage
    late = system.client.node.create_publisher(kind, f"{system.namespace}/{topic}/_action/feedback", 10)
    system.wait_for(late.get_subscription_count, "the page's node")
    planned(page)
    late.publish(kind())
    page.click("reset")
    page.wait("state.status.state === 'IDLE'")
    assert page.get(f"state.{shown}.active") is False


def test_what_is_refused_is_said(address, opened, at_rest):
    page = opened(address)
    page.wait("plane.onGoal && state.services.includes('plan') && plane.origin")
    page.drag(0, 500, 600)  # onto the disc
    page.click("plan")
    page.wait("state.said.some((line) => line.includes('no plan: ') && line.includes('robot 1'))")
    page.click("goals")


def test_a_wrong_token_is_told_what_to_do(address, opened):
    page = opened(address.partition("#")[0] + "#wrong")
    page.wait("!byId('alarm').hidden")
    assert "token in the address is wrong" in page.page.inner_text("#alarm")
    assert page.get("byId('plan').disabled") and page.get("state.scene === null")


def test_a_lost_connection_is_said_and_found_again(system, opened):
    address = serve(system, "lost", "--read-only")
    page = opened(address)
    page.wait("state.frame && link.isOpen")
    system.processes.stop("lost", signal.SIGKILL)
    page.wait("document.body.classList.contains('lost') && byId('alarm').textContent.includes('connection is lost')")
    page.page.click("#stop")
    page.wait("byId('alarm').textContent.includes('STOP has not been sent')")
    page.get("window.tries = 0; { const lost = link.onState; link.onState = (is) => { lost(is); tries += is === 'lost'; }; }")
    page.wait("tries > 1")  # and says so until the server is back, not until the next try to reach it
    assert "STOP has not been sent" in page.get("byId('alarm').textContent")
    page.picture("lost")
    port = address.partition("127.0.0.1:")[2].strip("/")
    serve(system, "again", "--read-only", "--port", port)
    page.wait("link.isOpen && byId('alarm').hidden && !document.body.classList.contains('lost')")
    assert system.processes.stop("again", signal.SIGINT) == 0


def test_a_fault_is_shown_with_what_to_do(system, address, opened, at_rest):
    page = opened(address)
    page.wait("state.services.includes('plan') && state.status.state === 'IDLE'")
    planned(page)
    page.click("start")
    page.wait("state.status.state === 'RUNNING'")
    system.processes.stop("sequencer", signal.SIGKILL)
    page.wait("state.status.state === 'FAULT' && byId('fault').textContent.includes('PEER_LOST')")
    assert "reset" in page.page.inner_text("#advice") and page.get("byId('plan').disabled && byId('start').disabled")
    page.picture("fault")
    system.start("sequencer")
    page.wait("!state.status.missing.length")
    page.click("reset")
    page.wait("state.status.state === 'IDLE'")


@pytest.fixture(scope="module")
def recording(system, tmp_path_factory):
    """A plan that was driven while all topics were recorded."""
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    client = system.client
    client.trigger("stop")
    assert client.trigger("reset").success
    system.processes.start("record", [str(STRESSBOT), "record", "--output", str(path)])
    for topic in ("motion_plan", "voltage_sequence", "plan_motion_action/_action/feedback"):
        system.wait_for(lambda topic=topic: hears(client.node, f"{system.namespace}/{topic}"), f"the recorder at {topic}")
    system.execute(system.plan(first=True).plan)
    client.forget_poses()
    system.wait_for(lambda: len(client.poses) > 50, "poses at the end")
    assert system.processes.stop("record") == 0
    return path


def hears(node, topic):
    return any(end.node_name == "recorder" for end in node.get_subscriptions_info_by_topic(topic))


def check_recording(page):
    page.wait("state.scene && player.duration")
    page.get("player.seek(player.duration)")
    page.wait(f"state.status.state === 'DONE' && {ARRIVED}")
    assert page.page.inner_text("#place") == "RECORDING OF A SIMULATION"
    assert page.get("plane.seen.trail.rows.length") > 5
    begin, end = page.get(
        "['RUNNING', 'DONE'].map((name) => { const { times, contents } = recorded.kinds.status;"
        " return times[contents.findIndex((one) => one.state === name)]; })"
    )
    page.get(f"player.seek({(begin + end) / 2})")
    page.wait("state.status.state === 'RUNNING' && plane.seen.motion && plane.seen.motion.count === state.status.epochs")
    # what was measured is where the plan takes the robots
    away = "(value, k) => k % 3 < 2 ? Math.abs(value - state.frame.p[k]) : 0"
    page.wait(f"Math.max(...plane.seen.motion.poses(state.frame.t).map({away})) < 1")


@contextlib.contextmanager
def viewed(*files, ending):
    """Yield the address of the page of files, in a process that a signal ends well."""
    process = subprocess.Popen([STRESSBOT, "view", *files, "--no-open"], stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline().strip()
    finally:
        process.send_signal(ending)
        assert process.wait(DEADLINE) == 0
        process.stdout.close()


def test_a_recording_is_played_and_is_one_file(recording, opened):
    with viewed(recording, ending=signal.SIGTERM) as address:
        page = opened(address)
        check_recording(page)
        page.picture("recording")
    done = run("plot", recording, "--output", recording.with_suffix(".html"))
    assert done.returncode == 0, done.stderr
    page = opened(recording.with_suffix(".html").as_uri())
    check_recording(page)
    assert page.asked_for == [recording.with_suffix(".html").as_uri()]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("view", "no.yaml"), "no.yaml"),
        (("view", "no.mcap"), "recording: no.mcap cannot be read (No such file or directory): name a recording"),
        (("view", "no.mcap", "plan.json"), "PLAN.json: is plan.json, but no.mcap is a recording: give that alone"),
        (("view", "--port", "70000"), "--port: is '70000': give a whole number from 0 to 65535"),
        (("view", "--real-time-factor", "nan"), "is 'nan': give a number from 0 to 1e6"),
        (("plot", "no.mcap", "--output", "x.png"), "--output: ends in '.png': use .html for a recording"),
    ],
)
def test_what_cannot_be_shown_is_said_in_one_line(words, line):
    done = run(*words)
    assert done.returncode == 2 and line in done.stderr and done.stderr.count("\n") == 1, done


def run(*words):
    return subprocess.run([STRESSBOT, *map(str, words)], capture_output=True, text=True, timeout=DEADLINE)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    (folder / "three.yaml").write_text(SCENARIO)
    done = run("plan", folder / "three.yaml", "--first", "--max-tries", "1", "--output", folder / "plan.json")
    assert done.returncode == 0, done.stderr
    return folder


def check_timeline(page):
    """Play, seek and end: at the end all robots are at their goals."""
    page.wait("plane.seen && plane.seen.poses")
    page.page.select_option("#speed", "500")
    page.page.click("#play")
    page.wait("player.time === player.duration && !player.isPlaying && plane.seen.time === player.duration")
    assert max(page.get("plane.seen.errors")) < 1
    page.page.fill("#time", "0")
    page.wait("plane.seen.time === 0")
    page.get("player.seek(player.duration / 2)")
    page.wait("plane.seen.time === player.duration / 2")


def test_a_plan_file_is_played(files, opened):
    with viewed(files / "three.yaml", files / "plan.json", ending=signal.SIGINT) as address:
        page = opened(address)
        check_timeline(page)
        page.picture("plan")


def test_a_plan_is_one_file_that_needs_nobody(files, opened):
    done = run("plot", files / "three.yaml", files / "plan.json", "--output", files / "plan.html")
    assert done.returncode == 0, done.stderr
    page = opened((files / "plan.html").as_uri(), width=390, height=800)
    check_timeline(page)
    assert page.asked_for == [(files / "plan.html").as_uri()]
    assert page.get("typeof Link === 'undefined' && byId('stop').offsetParent === null")
    page.picture("plan-phone")


def test_a_scenario_alone_is_shown_at_its_starts(files, opened):
    assert run("plot", files / "three.yaml", "--output", files / "three.html").returncode == 0
    page = opened((files / "three.html").as_uri())
    page.wait("plane.seen?.poses?.[0] === 200")
