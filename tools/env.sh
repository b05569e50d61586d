# Source this (bash or zsh) to use the workspace by hand, after "make build":
#   source tools/env.sh
#   python -m pytest ros2_ws/src/stressbot_planner/test
# The same environment as .venv/bin/stressbot has, plus the virtual environment's commands.
_stressbot_root=$(cd "$(dirname "${BASH_SOURCE[0]:-$0}")/.." && pwd -P)
if [ -r "$_stressbot_root/.venv/workspace.sh" ]; then
    . "$_stressbot_root/.venv/bin/activate"
    . "$_stressbot_root/.venv/workspace.sh"
else
    echo "tools/env.sh: nothing built yet; run: make build" >&2
fi
unset _stressbot_root
