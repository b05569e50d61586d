"""Whose description is in force, in a world of drivers that come, leave, die, freeze and are not heard to live."""

import random
from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rclpy.duration import Duration
from stressbot_msgs import described
from stressbot_msgs.described import LEASE, LOOK, SETTLED_AFTER, Described
from stressbot_msgs.msg import SwarmDescription

STEP = 0.05
ASSERTED = 0.3
LISTED = 20.0
"""s: of this simulation, of a sign of life, of ROS for one that was killed."""

LONG = LEASE + 3 * SETTLED_AFTER + 5 * LOOK
"""s, after which all must be as it is in the world; a reader that is deaf to somebody once is not a second time."""


@dataclass(eq=False)
class Driver:
    message: SwarmDescription
    leased: bool
    alive: bool = True
    since: float = 0.0  # when it came to life, or was killed

    def publisher(self):
        lease = Duration(seconds=0.5) if self.leased else Duration(nanoseconds=2**63 - 1)
        gid = list(id(self).to_bytes(16, "big"))
        return SimpleNamespace(endpoint_gid=gid, qos_profile=SimpleNamespace(liveliness_lease_duration=lease))


@dataclass(eq=False)
class Reader:
    since: float
    hear: object
    on_life: object = None
    deaf: set = field(default_factory=set)
    lives: dict = field(default_factory=dict)  # what it was told of each driver: whether it lives
    heard: set = field(default_factory=set)


class World:
    """Stands for the node, and for DDS."""

    def __init__(self, is_deaf):
        self.now, self.drivers, self.readers, self._is_deaf = 0.0, [], [], is_deaf

    def monotonic(self):
        return self.now

    def create_subscription(self, _type, _topic, hear, _quality, event_callbacks=None):
        reader = Reader(self.now, hear, event_callbacks and event_callbacks.liveliness)
        if reader.on_life and self._is_deaf():
            reader.deaf = set(self.drivers)
        self.readers.append(reader)
        return reader

    def destroy_subscription(self, reader):
        self.readers.remove(reader)

    def create_timer(self, period, tick, clock):
        assert period == LOOK
        self.tick = tick

    def get_publishers_info_by_topic(self, _topic):
        return [driver.publisher() for driver in self.drivers]

    def advance(self, duration):
        for _ in range(round(duration / STEP)):
            before, self.now = self.now, self.now + STEP
            self.drivers = [driver for driver in self.drivers if driver.alive or self.now < driver.since + LISTED]
            for reader in list(self.readers):
                self._tell(reader)
            if int(self.now / LOOK + 1e-9) > int(before / LOOK + 1e-9):
                self.tick()

    def _tell(self, reader):
        if reader.on_life is None:
            for driver in self.drivers:
                if driver.alive and driver not in reader.heard:
                    reader.heard.add(driver)
                    reader.hear(driver.message)
            return
        before = dict(reader.lives)
        for driver in self.drivers:
            if driver.leased and driver not in reader.deaf:
                if driver.alive and self.now > max(driver.since, reader.since) + ASSERTED:
                    reader.lives[driver] = True
                elif not driver.alive and reader.lives.get(driver) and self.now > driver.since + LEASE:
                    reader.lives[driver] = False
        reader.lives = {driver: lives for driver, lives in reader.lives.items() if driver in self.drivers}
        if reader.lives != before:
            gone, earlier = (sum(not lives for lives in found.values()) for found in (reader.lives, before))
            reader.on_life(
                SimpleNamespace(alive_count=sum(reader.lives.values()), not_alive_count=gone, not_alive_count_change=gone - earlier)
            )


@pytest.fixture
def make_world(monkeypatch):
    monkeypatch.setattr(described, "Clock", lambda clock_type: None)
    monkeypatch.setattr(described, "SubscriptionEventCallbacks", lambda **events: SimpleNamespace(**events))

    def make(is_deaf=lambda: False, drivers=0):
        world = World(is_deaf)
        world.drivers += [driver(f"driver {number}", world) for number in range(drivers)]
        monkeypatch.setattr(described.time, "monotonic", world.monotonic)
        changes = []
        listener = Described(world, lambda: changes.append((listener.description, listener.is_ambiguous)))
        return world, listener, changes

    return make


def driver(name, world, leased=True):
    return Driver(SwarmDescription(name=name), leased, since=world.now)


@pytest.mark.parametrize("leased", [True, False])
@pytest.mark.parametrize("killed", [True, False])
@pytest.mark.parametrize("survivor", [0, 1])
def test_when_one_of_two_drivers_ends_the_other_ones_swarm_is_in_force_again(make_world, leased, killed, survivor):
    world, listener, changes = make_world()
    pair = [driver("first", world, leased)]
    world.drivers.append(pair[0])
    world.advance(3.0)
    assert listener.description is pair[0].message
    pair.append(driver("second", world, leased))
    world.drivers.append(pair[1])
    world.advance(3.0)
    assert listener.is_ambiguous and listener.description is None
    changes.clear()
    gone = pair[1 - survivor]
    gone.alive, gone.since = False, world.now
    if not killed:
        world.drivers.remove(gone)
    world.advance(LONG if leased or not killed else LISTED + LONG)
    assert not listener.is_ambiguous and listener.description is pair[survivor].message
    assert changes[-1] == (pair[survivor].message, False)
    assert all(description in (None, pair[survivor].message) for description, _ in changes)


@pytest.mark.parametrize("deaf", [0, 1])
def test_a_driver_that_is_there_first_is_in_force_all_the_time_and_its_death_is_seen(make_world, deaf):
    left = [True] * deaf
    world, listener, changes = make_world(lambda: bool(left) and left.pop(), drivers=1)
    world.advance(10.0)
    assert changes == [(world.drivers[0].message, False)]
    world.drivers[0].alive, world.drivers[0].since = False, world.now
    world.advance(LEASE + LOOK)
    assert listener.description is None and listener.drivers == 0


@pytest.mark.parametrize("leased", [True, False])
def test_a_second_driver_is_noticed_at_once(make_world, leased):
    world, listener, _ = make_world(drivers=1)
    world.advance(5.0)
    world.drivers.append(driver("second", world, leased))
    world.advance(LOOK + STEP)
    assert listener.is_ambiguous
    world.advance(60.0)
    assert listener.is_ambiguous


ACTIONS = st.lists(
    st.tuples(
        st.sampled_from(["come", "come without a lease", "leave", "die", "freeze", "go on"]), st.sampled_from([0.1, 0.5, 1.2, 3.0])
    ),
    max_size=8,
)


COME_AND_GO = [("leave", 0.1), ("freeze", 0.1), ("leave", 3.0), ("go on", 0.1), ("come", 0.1), ("leave", 0.1)]


@example(COME_AND_GO, 2, [], random.Random(0))
@example(COME_AND_GO, 2, [], random.Random(1))
@given(ACTIONS, st.integers(0, 2), st.lists(st.booleans(), max_size=3), st.randoms(use_true_random=False))
@settings(deadline=None, max_examples=60)
def test_after_a_while_all_is_as_it_is(actions, early, deafness, rng):
    """Whatever happened, and however often a reader was deaf to those that were there before it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(described, "Clock", lambda clock_type: None)
        patch.setattr(described, "SubscriptionEventCallbacks", lambda **events: SimpleNamespace(**events))
        deaf = list(deafness)
        world = World(lambda: bool(deaf) and deaf.pop())
        patch.setattr(described.time, "monotonic", world.monotonic)
        world.drivers += [driver(f"early {number}", world) for number in range(early)]
        listener = Described(world, lambda: None)
        frozen = []
        for number, (action, wait) in enumerate(actions):
            living = [one for one in world.drivers if one.alive]
            if action.startswith("come"):
                world.drivers.append(driver(str(number), world, action == "come"))
            elif action == "go on" and frozen:
                one = frozen.pop()
                if one in world.drivers:
                    one.alive, one.since = True, world.now
            elif living:
                one = rng.choice(living)
                if action == "leave":
                    world.drivers.remove(one)
                elif one.leased:
                    one.alive, one.since = False, world.now
                    if action == "freeze":
                        frozen.append(one)
            world.advance(wait)
        world.advance(LONG + (1 + len(deafness)) * (SETTLED_AFTER + LOOK))
        living = [one for one in world.drivers if one.alive]
        assert listener.is_ambiguous == (len(living) > 1)
        assert listener.description is (living[0].message if len(living) == 1 else None)
