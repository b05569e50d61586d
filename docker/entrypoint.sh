#!/bin/bash
# Runs a command in the workspace's environment, as the same process, so that signals reach it.
set -e
source /opt/stressbot/ros2_ws/install/setup.bash
exec "$@"
