"""Every event in every state of session, client, gate and backend, and every order of two that come at once."""

from whole_world import World

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.gate.protocol import Outcome
from stressbot_driver.session import State

EVENTS = ("load", "start", "stop", "reset", "end", "loss", "found", "beat", "silence", "death", "nonsense", "look")
BROKEN = ("stop", "start", "upload", "reset", "process")
AT_ONCE = ("start", "stop", "loss", "reset", "close", "silence", "end", "look", "load", "nonsense", "death")
LATCHED = {"silence": ErrorCode.NO_HEARTBEAT, "loss": ErrorCode.PEER_LOST, "death": ErrorCode.BACKEND_FAILURE}


def check(world):
    """What holds whenever nobody has anything to do: the invariants of docs/safety.md."""
    status = world.session._status
    may_be_on = "stop" in world.broken or "MAY BE ON" in status.error_msg
    if world.state == State.RUNNING:
        assert world.level > 0.0 and world.gate._word.outcome == Outcome.PLAYING and not status.missing
    elif not may_be_on:
        assert world.level == 0.0
    if world.state == State.FAULT:
        assert status.error_code and status.error_msg
    if world.gate._latched is not None and not may_be_on:
        assert world.level == 0.0


def see(world):
    """What tells one state from another."""
    gate, client = world.gate, world.client
    outcome = gate._word.outcome.name, gate._latched is None, gate._unrested is None, gate._ending
    status = world.session._status
    backend = gate.output is None or gate.output.backend._sequence is None
    return (
        world.state,
        status.missing,
        status.error_code,
        *outcome,
        backend,
        client._link is None,
        world.level,
        frozenset(world.broken),
    )


def happen(world, event):
    """Let one event happen, and check that its promise is kept."""
    before, was, level = world.state, frozenset(world.broken), world.level
    if event.startswith(("break ", "mend ")):
        word, name = event.split()
        (world.broken.add if word == "break" else world.broken.discard)(name)
        if word == "mend":
            world.do("later")
        return
    if event == "end":
        world.lasting = False
    refused = world.do(event)
    after = world.state
    if before == State.FAULT and event != "reset":
        assert after == State.FAULT
    if event == "start" and before != State.LOADED:
        assert refused is not None and world.level == level
    if before == State.RUNNING and not was and event in LATCHED:
        assert (after, world.session._status.error_code, world.level) == (State.FAULT, LATCHED[event], 0.0)
    if event == "stop":
        assert after != State.RUNNING and (refused is not None or world.level == 0.0)


def follow(path):
    world = World()
    try:
        for event in path:
            happen(world, event)
            check(world)
        return see(world)
    finally:
        world.scheduler.abandon()


def explored(broken=None):
    """Every state that events lead to, with the shortest way there; every event is tried in each, breadth first."""
    events = (*EVENTS, *([f"break {broken}", f"mend {broken}"] if broken else []))
    known, waiting = {follow(()): ()}, [()]
    for path in waiting:
        for event in events:
            state = follow((*path, event))
            if state not in known:
                known[state] = (*path, event)
                waiting.append((*path, event))
    print(f"{broken or 'nothing'} breaks: {len(known)} states, {len(known) * len(events)} events")
    return known


def at_once(first, actors, files=()):
    """Several threads ask at once: nobody waits for ever, nothing but a refusal is raised, and the invariants hold afterwards."""

    def one(choices):
        world = World(choices, files)
        try:
            for event in first:
                world.do(event)
            tasks = [world.scheduler.spawn(actor, getattr(world, actor)) for actor in actors]
            world.scheduler.run()
            for task in tasks:
                assert task.done, f"{task.name} waits for ever, as do {world.scheduler.waiting}"
            for task in world.scheduler.tasks:
                assert task.error is None or isinstance(task.error, StressbotError), (task.name, task.error)
            check(world)
            if {"stop", "close", "loss"} & {*actors} and "load" not in actors:
                assert world.state != State.RUNNING
            return world.scheduler.taken
        except AssertionError as error:
            raise AssertionError(f"{first}, then {actors} by {choices}: {error}") from error
        finally:
            world.scheduler.abandon()

    return one
