"""Starts driver, sequencer and planner; with move:=true also the mover, with view:=true the viewer and RViz.

    ros2 launch stressbot_planner stressbot.launch.py scenario:=/path/to/scenario.yaml real_time_factor:=10.0 view:=true
"""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from stressbot_planner.ros.bringup import ENCLAVES, NODES, share

ARGUMENTS = {
    "scenario": (str(share("scenarios", "paper-six.yaml")), "scenario file that says what lies on the bench"),
    "real_time_factor": ("1.0", "substrate seconds per wall second; 0: as fast as possible"),
    "auto_start": ("false", "start each accepted voltage sequence at once"),
    "parameters": (str(share("config", "stressbot.yaml")), "ROS 2 parameter file for all nodes"),
    "move": ("false", "start the mover, which serves the action move_swarm"),
    "view": ("false", "start the viewer and RViz as well"),
}


def generate_launch_description() -> LaunchDescription:
    """Return what `ros2 launch` runs."""
    view = IfCondition(LaunchConfiguration("view"))
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=text) for name, (value, text) in ARGUMENTS.items()
    ]
    nodes = [
        Node(
            package=entry.package,
            executable=entry.executable,
            name=entry.executable,
            output="screen",
            ros_arguments=["--enclave", f"{ENCLAVES}/{entry.executable}"],
            parameters=[
                LaunchConfiguration("parameters"),
                {name: ParameterValue(LaunchConfiguration(name), value_type=kind) for name, kind in entry.arguments.items()},
            ],
            condition=IfCondition(LaunchConfiguration(entry.option)) if entry.option else None,
        )
        for entry in NODES
    ]
    rviz = Node(
        package="rviz2", executable="rviz2", arguments=["-d", str(share("rviz", "stressbot.rviz"))], condition=view
    )
    return LaunchDescription([*arguments, *nodes, rviz])
