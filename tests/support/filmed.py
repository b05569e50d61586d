"""Six robots beside each other under a simulated microscope, and the nodes that see them by its pictures alone."""

from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.msg import SwarmPoses
from system_rig import DEADLINE

from stressbot_planner.ros.bringup import BENCH

SCENARIO = """
name: six-near
length_unit: 1.0e-4
workspace: {x: [0, 12], y: [0, 12]}
swarm: {speed: 1.0, turning_radius: 0.5, body_radius: 0.3, groups: binary}
robots:
  - {start: [2, 2, 0], goal: [3.5, 2.5]}
  - {start: [2, 6, 0], goal: [3.5, 6]}
  - {start: [2, 10, 0], goal: [3.5, 9.5]}
  - {start: [8, 2, 3], goal: [7, 3.5]}
  - {start: [8, 6, 3], goal: [7, 7]}
  - {start: [8, 10, 3], goal: [6.5, 10]}
electrical: {drive: pulses}
"""


def filmed(system, folder, driver, camera, tracker):
    """Start driver, sequencer, camera and tracker, with other or more parameters each; `truth` of the system has the true poses."""
    path = folder / "six.yaml"
    path.write_text(SCENARIO)
    system.truth = []
    system.client.node.create_subscription(SwarmPoses, "true_poses", system.truth.append, 50)
    system.start("driver", tracked=True, scenario=path, real_time_factor=1.0, **driver)
    system.start("sequencer")
    system.start("simulated_camera", **{"camera": BENCH, "rate": 15.0, "lost": 0.05, **camera})
    system.start("camera_tracker", **{"camera": BENCH, **tracker})
    system.wait_for(lambda: system.client.has_met("driver"), "driver")
    return system


def moved(system, tolerance):
    """Let the mover bring them to the scenario's goals within a tolerance [m]; return its result."""
    answer = system.asked(lambda: system.actions.send_goal_async(MoveSwarm.Goal(tolerance=tolerance, time_limit=400.0)))
    system.wait_for(answer.done, "acceptance")
    handle = answer.result()
    assert handle.accepted
    result = system.asked(handle.get_result_async)
    system.wait_for(result.done, "result", 4 * DEADLINE)
    return result.result().result
