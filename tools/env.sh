# Source this (bash or zsh) to use the workspace by hand, after "make build":
#   source tools/env.sh
#   python -m pytest ros2_ws/src/stressbot_planner/test
# The same environment as .venv/bin/stressbot has, plus the virtual environment's commands, and tools/ros2 where no native ROS is.
_stressbot_root=$(cd "$(dirname "${BASH_SOURCE[0]:-$0}")/.." && pwd -P)
if [ -r "$_stressbot_root/.venv/workspace.sh" ]; then
    . "$_stressbot_root/.venv/bin/activate"
    . "$_stressbot_root/.venv/workspace.sh"
    if [ -n "${_ROS_WHEELS_BOOTSTRAP_COMPLETE:-}" ] && [ -z "${ROS_DISTRO:-}" ]; then
        case :$PATH: in
            *":$_stressbot_root/tools/ros2:"*) ;;
            *) PATH=$PATH:$_stressbot_root/tools/ros2 ;; # last: the official ros2 goes before it
        esac
    fi
    if [ -n "${BASH_VERSION:-}" ]; then
        . "$_stressbot_root/tools/completion.bash"
        if [ "$(command -v ros2)" = "$_stressbot_root/tools/ros2/ros2" ]; then
            complete -o default -o bashdefault -F _stressbot_complete ros2
        fi
    fi
else
    echo "tools/env.sh: nothing built yet; run: make build" >&2
fi
unset _stressbot_root
