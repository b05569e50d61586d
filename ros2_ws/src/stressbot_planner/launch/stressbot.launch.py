"""Starts driver, sequencer and planner, in any namespace; move:=true adds the mover, view:=true viewer and paths,
click:=true clicks, rviz:=true RViz and these three; camera:=… adds the tracker that gets poses from pictures.

    ros2 launch stressbot_planner stressbot.launch.py scenario:=/path/to/scenario.yaml real_time_factor:=10.0 rviz:=true

Whatever is wrong or missing is said before anything starts. Nobody on another machine hears the nodes unless
ROS_AUTOMATIC_DISCOVERY_RANGE says otherwise.
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from stressbot_planner.ros.bringup import Start, arguments, environment, launched


def generate_launch_description() -> LaunchDescription:
    """Return what `ros2 launch` runs."""
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text) for name, (value, text) in arguments().items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    return [_node(start) for start in launched({name: context.launch_configurations[name] for name in arguments()})]


def _node(start: Start) -> Node:
    files = [start.parameter_file] if start.parameter_file else []
    return Node(
        package=start.package,
        executable=start.executable,
        namespace=start.namespace,
        parameters=[*files, *([start.parameters] if start.parameters else [])],
        arguments=list(start.arguments),
        ros_arguments=list(start.ros_arguments),
        prefix=start.prefix or None,
        additional_env=environment(),
        output="screen",
    )
