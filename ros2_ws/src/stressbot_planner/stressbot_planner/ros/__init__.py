"""Nodes, parameters and messages: the only part that imports ROS."""
