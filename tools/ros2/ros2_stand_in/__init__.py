"""A stand-in for the official `ros2` command, written on rclpy, for machines that have ROS 2 as wheels and no `ros2cli`.

One module a family of commands; each has `add_arguments(parser)`, which names its verbs, and takes the official words, arguments,
YAML values and exit codes. Nothing in the ROS packages depends on it.
"""
