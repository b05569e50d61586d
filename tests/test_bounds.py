"""Whoever sends more than a message may hold is refused by code, and holds nobody up."""

import threading
from array import array

import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.action import ActionClient
from stressbot_msgs import action, bounds, msg, srv
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.msg import DriverStatus, ErrorCode, MotionPlan, Primitive, VoltageSequence
from system_rig import DEADLINE, SCENARIOS

NODES = ("driver", "sequencer", "planner", "mover", "viewer", "paths", "clicks")
HUGE = "p" * 1_000_000
KINDS = [
    *(kind for kind in vars(msg).values() if hasattr(kind, "get_fields_and_field_types")),
    srv.PlanMotion.Request,
    action.PlanMotion.Goal,
    action.MoveSwarm.Goal,
]


def fields(kind):
    """Every text and every list of a message, however deep: its name, and a message in which that one has `size`."""
    for name, text in kind.get_fields_and_field_types().items():
        value = getattr(kind(), name)
        if isinstance(value, str):
            yield name, lambda size, name=name: kind(**{name: "x" * size})
        elif isinstance(value, array):
            yield name, lambda size, name=name, value=value: kind(**{name: array(value.typecode, bytes(size * value.itemsize))})
        elif isinstance(value, list) and text.startswith("sequence<string"):
            yield name, lambda size, name=name: kind(**{name: [""] * size})
            yield f"{name}[1]", lambda size, name=name: kind(**{name: ["", "x" * size]})
        elif isinstance(value, list):
            item = getattr(msg, text.removeprefix("sequence<stressbot_msgs/").removesuffix(">"))
            yield name, lambda size, name=name, item=item: kind(**{name: [item()] * size})
            for inner, make in fields(item):
                yield f"{name}[1].{inner}", lambda size, name=name, item=item, make=make: kind(**{name: [item(), make(size)]})
        elif hasattr(value, "get_fields_and_field_types"):
            for inner, make in fields(type(value)):
                yield f"{name}.{inner}", lambda size, name=name, make=make: kind(**{name: make(size)})


CASES = [(kind, name, make) for kind in KINDS for name, make in fields(kind) if not name.startswith("header.stamp")]


@pytest.mark.parametrize(("kind", "name", "make"), CASES, ids=lambda value: getattr(value, "__name__", value))
def test_every_text_and_every_list_of_every_message_has_an_end(kind, name, make, monkeypatch):
    for table in ("LENGTHS", "COUNTS"):
        monkeypatch.setattr(bounds, table, dict.fromkeys(getattr(bounds, table), 30))
    for constant in ("LONGEST_TEXT", "MOST_ENTRIES"):
        monkeypatch.setattr(bounds, constant, 30)
    assert bounds.excess(make(30)) is None
    field, problem = bounds.excess(make(31))
    assert field == name and "31" in problem and "the most is 30" in problem


def test_what_the_largest_swarm_and_the_longest_plan_need_is_within_the_bounds():
    described = msg.SwarmDescription(
        codewords=["1" * 9999] * 10, start=array("d", bytes(8 * 30_000)), obstacles=[msg.Obstacle(x=array("d", bytes(80_000)))]
    )
    sequence = VoltageSequence(plan_id="p" * 200, levels=array("d", bytes(8 * 500_000)))
    assert bounds.excess(described) is None and bounds.excess(sequence) is None


@pytest.fixture(scope="module")
def system(new_system):
    system = new_system(nodes=("driver", "sequencer", "planner"), scenario=SCENARIOS / "paper-six.yaml")
    for name in NODES[3:]:
        system.start(name)
    system.wait_for(lambda: set(NODES) <= set(system.client.node.get_node_names()), "the others")
    return system


def test_a_plan_and_a_sequence_with_too_much_are_refused_by_code_and_not_echoed(system):
    node, client = system.client.node, system.client
    swarm = client.description.swarm_id
    plans = node.create_publisher(MotionPlan, "motion_plan", 10)
    sequences = node.create_publisher(VoltageSequence, "voltage_sequence", 10)
    system.wait_for(lambda: plans.get_subscription_count() and sequences.get_subscription_count(), "their readers")
    for plan in (
        MotionPlan(plan_id=HUGE, swarm_id=swarm),
        MotionPlan(plan_id="deep", swarm_id=swarm, primitives=[Primitive(kind=4, robots=array("I", bytes(4 * 200_000)))]),
    ):
        plans.publish(plan)
        system.wait_for(lambda plan=plan: client.sequencer_status.plan_id == plan.plan_id[:200], "the refusal")
        assert client.sequencer_status.error_code == ErrorCode.LIMIT_EXCEEDED, client.sequencer_status.error_msg
    sequences.publish(VoltageSequence(plan_id=HUGE, swarm_id=swarm))
    system.wait_for(lambda: client.driver_status.refused_plan_id == "p" * 200, "the refusal")
    assert client.driver_status.error_code == ErrorCode.LIMIT_EXCEEDED and "1000000 characters" in client.driver_status.error_msg


@pytest.mark.parametrize("fields", [{"planner": HUGE}, {"objective": "9" * 1_000_000}, {"robots": array("I", bytes(800_000))}])
def test_a_request_with_too_much_is_refused_by_code(system, fields):
    answer = system.plan(**fields)
    assert (answer.success, answer.error_code) == (False, ErrorCode.LIMIT_EXCEEDED)
    assert answer.error_msg.startswith(next(iter(fields))) and len(answer.error_msg) < 200


def test_a_goal_with_too_much_is_refused_by_code(system):
    actions = ActionClient(system.client.node, MoveSwarm, "move_swarm")
    system.wait_for(actions.server_is_ready, "the mover")
    handle = system.asked(lambda: actions.send_goal_async(MoveSwarm.Goal(goal_x=array("d", bytes(1_600_000)))))
    system.wait_for(handle.done, "the goal")
    result = system.asked(handle.result().get_result_async)
    system.wait_for(result.done, "the result")
    assert result.result().result.error_code == ErrorCode.LIMIT_EXCEEDED
    assert "goal_x has 200000 entries" in result.result().result.error_msg.replace(":", "")


@pytest.mark.parametrize("node", NODES)
def test_parameters_are_asked_and_set_in_bounded_requests_and_no_request_ends_a_node(system, node):
    def ask(kind, **fields):
        client = system.client.node.create_client(kind, f"{node}/{kind.__name__.replace('P', '_p').replace('A', '_a').lower()}")
        system.wait_for(client.service_is_ready, f"{node}'s parameters")
        while True:
            answered = client.call_async(kind.Request(**fields))
            try:
                system.wait_for(answered.done, "the answer", 5.0)
                return answered.result()
            except TimeoutError:  # the first answer of a server that does not know its client yet is lost
                client.remove_pending_request(answered)

    many = [Parameter(name="pose_rate", value=ParameterValue(type=3, double_value=20.0))] * 20_000
    strange = [Parameter(name="pose_rate", value=ParameterValue(type=200))]
    long = [Parameter(name="n" * 10_000, value=ParameterValue(type=4, string_value="x"))]
    (result,) = ask(SetParameters, parameters=many).results
    assert not result.successful and "more than 200" in result.reason
    for parameters in (strange, long):
        (result,) = ask(SetParameters, parameters=parameters).results
        assert not result.successful and len(result.reason) <= 1000
        assert not ask(SetParametersAtomically, parameters=parameters).result.successful
    assert len(ask(GetParameters, names=["use_sim_time"] * 20_000).values) == 0
    assert len(ask(GetParameters, names=["use_sim_time"] * 200).values) == 200


def test_stop_is_served_while_any_other_callback_is_loaded(system):
    """Each in turn, by as many messages as it takes to keep the driver busy; `make faults` measures how long it takes."""
    node, client = system.client.node, system.client
    setting = node.create_client(SetParameters, "driver/set_parameters")
    full = SetParameters.Request(parameters=[Parameter(name="status_rate", value=ParameterValue(type=3, double_value=10.0))] * 200)
    publishers = {
        kind: node.create_publisher(kind, topic, 10)
        for kind, topic in ((VoltageSequence, "voltage_sequence"), (DriverStatus, "driver_status"), (msg.SwarmPoses, "swarm_poses"))
    }
    large = {
        VoltageSequence: VoltageSequence(plan_id="large", levels=array("d", bytes(8 * 100_000))),
        DriverStatus: DriverStatus(error_msg="x" * 3000, missing=["y"] * 1000),
        msg.SwarmPoses: msg.SwarmPoses(ids=array("I", bytes(4 * 10_000))),
    }
    system.wait_for(setting.service_is_ready, "the driver's parameters")
    loads = [
        lambda: setting.call_async(full),
        lambda: client._services["reset"].call_async(client._services["reset"].srv_type.Request()),
        *(lambda kind=kind: publishers[kind].publish(large[kind]) for kind in publishers),
    ]
    for load in loads:
        over = threading.Event()

        def flood(load=load, over=over):
            while not over.wait(0.002):
                load()

        flooding = threading.Thread(target=flood)
        flooding.start()
        try:
            for _ in range(5):
                assert client.trigger("stop", DEADLINE).success
        finally:
            over.set()
            flooding.join()
