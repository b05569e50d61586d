"""The campaigns of `make faults` and `make soak` in a short form: every fault that needs no root, once, in its own system."""

import random

import pytest
from faults import campaign, settings, soak

pytestmark = pytest.mark.xdist_group("faults")

SHORT = {
    settings.simulated: (
        "sequencer: kill -9",
        "sequencer: frozen, goes on",
        "planner: kill -9 while a sequence runs",
        "planner: kill -9 of its planning process",
        "two planners at once",
        "driver: SIGHUP",
        "driver: kill -9",
        "driver: frozen, goes on",
        "gate: kill -9",
        "driver: kill -9, then a plan is asked for",
        "two drivers, the second is killed",
        "plan doubled, and again after its end",
        "plans reordered: an older one after a newer one ran",
        "hostile sequences past the sequencer",
        "flood of voltage_sequence",
        "flood of set_parameters, 20 000 entries",
        "all suspended for a second",
    ),
    settings.blocked: ("nobody reads the driver's log: stop call", "nobody reads the driver's log: sequencer kill -9"),
    settings.failing_calls: ("gate: recv fails", "gate: poll hangs", "gate: mmap fails"),
    settings.moving: ("mover: kill -9 while it drives",),
    settings.shifted_clocks: ("clocks: all 1 h back while a sequence runs", "clocks: the driver's alone 1 h back"),
    settings.filmed: ("camera: light off", "camera: objects that look like robots", "camera: pictures of another encoding"),
    settings.tracked: ("tracker: silent while a sequence runs",),
    settings.instrument: (
        "instrument: disk full while recording",
        "instrument: driver kill -9",
        "instrument: sequencer kill -9",
        "instrument: another client switches on at rest",
    ),
}


ALONE = (settings.filmed,)
"""Where pictures decide, whose times a busy machine tells late."""


@pytest.mark.parametrize(
    "setting",
    [pytest.param(setting, id=setting.__name__, marks=[pytest.mark.timing] if setting in ALONE else []) for setting in SHORT],
)
def test_every_fault_ends_as_documented_and_the_system_runs_again(setting, tmp_path, monkeypatch):
    for name in ("PEER_TIMEOUT", "GATE_TIMEOUT"):
        monkeypatch.setattr(settings, name, 1.0)  # tests share the machine, and a false alarm is none of these faults
    monkeypatch.setattr(settings, "EXCHANGE_TIMEOUT", 20.0)
    with setting(tmp_path, random.Random(0)) as stage:
        for name in SHORT[setting]:
            needed, fault = campaign.FAULTS[name]
            assert needed is setting
            outcome = fault(stage)
            assert outcome.seen and outcome.recovered.endswith(("DONE", "plans again")), name
            assert outcome.zero is None or outcome.zero < 5.0, name  # 0.1 s on a machine of its own: see make faults


def test_a_short_soak_leaves_nothing_behind(tmp_path, monkeypatch):
    for name in ("PEER_TIMEOUT", "GATE_TIMEOUT"):
        monkeypatch.setattr(settings, name, 1.0)
    with settings.simulated(tmp_path, random.Random(1)) as stage:
        done, early, late = soak.soak(stage, 8.0, 0.3)
    assert done and set(early) <= set(late) == {"driver", "sequencer", "planner", "gate"}
    for name, (_, threads, files) in early.items():
        assert late[name][1] <= threads + 2 and late[name][2] <= files + 5, name
