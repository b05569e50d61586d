"""A process that floods one topic or service of a driver until it is killed: NAMESPACE WHAT. It says `flooding` when it does."""

import os
import sys
import time
from array import array

import rclpy
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from std_srvs.srv import Trigger
from stressbot_msgs.msg import DriverStatus, MotionPlan, SwarmPoses, VoltageSequence
from stressbot_msgs.transports import avoid_shared_memory

from stressbot_planner.ros.qos import LATCHED

HUGE = "p" * 40_000_000
PERIOD = 0.002
"""s, of small messages"""

LARGE_PERIOD = 0.3
"""s, of large ones: the sender is busy for longer than the driver"""

POSE_RATE = Parameter(name="pose_rate", value=ParameterValue(type=3, double_value=50.0))
SERVICES = {
    "set_parameters, 20 000 entries": ("driver/set_parameters", SetParameters, {"parameters": [POSE_RATE] * 20_000}, LARGE_PERIOD),
    "set_parameters, 200 entries": ("driver/set_parameters", SetParameters, {"parameters": [POSE_RATE] * 200}, PERIOD),
    "get_parameters": ("driver/get_parameters", GetParameters, {"names": ["pose_rate"] * 200}, PERIOD),
    "start": ("start", Trigger, {}, PERIOD),
    "reset": ("reset", Trigger, {}, PERIOD),
}
TOPICS = {
    "voltage_sequence": (VoltageSequence(plan_id="p", levels=array("d", bytes(80_000)), dwells=array("d", bytes(80_000))), PERIOD),
    "driver_status": (DriverStatus(error_msg="x" * 1000, missing=["y"] * 100), PERIOD),
    "swarm_poses": (SwarmPoses(ids=array("I", bytes(4000)), x=array("d", bytes(8000))), PERIOD),
    "motion_plan": (MotionPlan(plan_id="p"), PERIOD),
    "voltage_sequence, a name of 40 MB": (VoltageSequence(plan_id=HUGE), LARGE_PERIOD),
    "motion_plan, a name of 40 MB": (MotionPlan(plan_id=HUGE), LARGE_PERIOD),
}


def main(namespace: str, what: str) -> None:
    """Send without waiting for answers."""
    avoid_shared_memory(os.environ)
    rclpy.init()
    node = rclpy.create_node("flooder", namespace=namespace)
    if what in SERVICES:
        name, kind, fields, period = SERVICES[what]
        client, request = node.create_client(kind, name), kind.Request(**fields)
        client.wait_for_service()

        def send() -> None:
            client.remove_pending_request(client.call_async(request))
    else:
        message, period = TOPICS[what]
        quality = LATCHED if isinstance(message, DriverStatus) else 10
        publisher = node.create_publisher(type(message), what.partition(",")[0], quality)
        while not publisher.get_subscription_count():
            time.sleep(0.01)

        def send() -> None:
            publisher.publish(message)

    send()
    print("flooding", flush=True)
    while True:
        send()
        time.sleep(period)


if __name__ == "__main__":
    main(*sys.argv[1:])
