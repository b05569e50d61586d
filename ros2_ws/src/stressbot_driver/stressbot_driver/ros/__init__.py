"""The node, its parameters and its messages: the only part that imports ROS."""
