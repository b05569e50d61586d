#!/usr/bin/env bash
# Brings .venv, ros2_ws/install and .venv/bin/stressbot up to date; what is up to date is left alone.
#
# Two ways to get ROS 2 Jazzy, chosen by the environment:
#   native  a Jazzy is sourced: its rclpy, its colcon, its Python; .venv only adds the tools that are missing
#   wheels  otherwise: everything comes as pinned wheels into .venv
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
venv=$root/.venv
workspace=$root/ros2_ws
stamps=$root/.stamps

say() { echo "build: $*"; }
die() { echo "build: $*" >&2; exit 1; }

# --- which ROS ---------------------------------------------------------------------------------------------------

sourced_jazzy() { # the prefix of a sourced ROS 2 Jazzy that holds rclpy, if there is one
    [ "${ROS_DISTRO:-}" = jazzy ] || return 1
    local prefix
    local IFS=:
    for prefix in ${AMENT_PREFIX_PATH:-}; do
        if [ -e "$prefix/share/rclpy/package.xml" ] && [ "$prefix" != "$venv" ]; then
            echo "$prefix"
            return
        fi
    done
    return 1
}

# --- system packages ---------------------------------------------------------------------------------------------

python_is_suitable() { # name
    local test='import sys; assert (3, 11) <= sys.version_info < (3, 14)'
    [ "$mode" = wheels ] || test+='; import rclpy'
    "$1" -c "$test" 2>/dev/null
}

find_python() {
    local name
    for name in ${PYTHON:-python3 python3.13 python3.12 python3.11 /usr/bin/python3}; do
        if python_is_suitable "$name"; then
            # not our own, which is on the path of who has sourced tools/env.sh: it may be removed
            "$name" -c 'import sys; print(sys._base_executable if sys.prefix == sys.argv[1] else sys.executable)' "$venv"
            return
        fi
    done
    return 1
}

missing_packages() { # the Debian names of what this machine lacks
    command -v make >/dev/null || echo make
    command -v cmake >/dev/null || echo cmake
    command -v g++ >/dev/null || echo g++
    local python
    if python=$(find_python); then
        local package=python3
        case $python in /usr/bin/*) package=$(basename "$(readlink -f "$python")") ;; esac
        "$python" -c 'import ensurepip, venv' 2>/dev/null || echo "$package-venv"
        "$python" -c 'import os, sysconfig; assert os.path.exists(sysconfig.get_path("include") + "/Python.h")' \
            2>/dev/null || echo "$package-dev"
    elif command -v python3 >/dev/null && [ "$mode" = wheels ]; then
        echo python3.11 python3.11-venv python3.11-dev # beside one that is too old or too new
    else
        echo python3 python3-venv python3-dev
    fi
    if [ "$mode" = native ]; then
        command -v colcon >/dev/null || echo python3-colcon-common-extensions
        local module
        for module in $(sed -e 's/#.*//' -e 's/pyyaml/yaml/' -e 's/opencv-python-headless<5/cv2/' "$root/requirements/runtime.in"); do
            "$python" -c "import ${module//-/_}" 2>/dev/null || echo "python3-${module/cv2/opencv}"
        done
    fi
}

ensure_system_packages() {
    local missing
    missing=$(missing_packages)
    missing=${missing//$'\n'/ }
    [ -n "$missing" ] || return 0
    local command="apt-get install -y --no-install-recommends $missing"
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        say "installing system packages: $missing"
        { apt-get update -qq && DEBIAN_FRONTEND=noninteractive $command -qq; } >"$stamps/apt.log" 2>&1 || {
            tail -n 20 "$stamps/apt.log" >&2
            die "could not install what is missing; run: $command"
        }
        hash -r
    else
        die "system packages are missing; run: sudo $command"
    fi
    find_python >/dev/null || die "needs Python 3.11, 3.12 or 3.13 (set PYTHON to one)"
}

# --- the virtual environment -------------------------------------------------------------------------------------

missing_tools() { # pins with hashes of what recording.in, view.in, test.in and docs.in ask for and the native Python lacks, and of what these need
    "$venv/bin/python" - "$root"/requirements/{lock.txt,recording.in,view.in,test.in,docs.in} <<'PY'
import re
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

lock, *wanted = (Path(path).read_text() for path in sys.argv[1:])
names = re.findall(r"^[\w.-]+", "\n".join(wanted), re.MULTILINE)


def missing(name):
    try:
        version(name)
    except PackageNotFoundError:
        return True
    return False


if any(map(missing, names)):
    for pin in re.findall(r"^\w.*(?:\n    .*)*$", lock, re.MULTILINE):
        name = pin.split("==")[0]
        if not name.startswith("ros-") and missing(name):
            print(pin)
PY
}

install_with_uv() ( # the lock; where pip finds files, and whom it trusts, stands in settings that uv does not read
    settings=$("$venv/bin/python" -m pip config list)
    setting() { sed -n "s/^[a-z:]*\.$1='\(.*\)'$/\1/p" <<<"$settings" | tail -n 1; }
    index=$(setting index-url) certificates=$(setting cert)
    if [ -n "$index" ]; then export UV_DEFAULT_INDEX=${UV_DEFAULT_INDEX:-$index}; fi
    if [ -n "$certificates" ]; then export SSL_CERT_FILE=${SSL_CERT_FILE:-$certificates}; fi
    "$venv/bin/uv" pip install --quiet --compile-bytecode --python "$venv/bin/python" \
        --no-deps --require-hashes -r "$root/requirements/lock.txt"
)

ensure_venv() {
    local fingerprint
    fingerprint=$(
        echo "$mode $native_prefix $root ${PYTHON:-}"
        cat "$root"/requirements/{lock.txt,recording.in,view.in,test.in,docs.in}
    )
    if [ -x "$venv/bin/python" ] && [ "$(cat "$venv/fingerprint" 2>/dev/null)" = "$fingerprint" ]; then
        return
    fi
    ensure_system_packages
    if [ "$mode" = wheels ] && [ "$(uname -sm)" != "Linux x86_64" ]; then
        die "ROS 2 wheels exist for Linux on x86_64 only; source a ROS 2 Jazzy, or use docker/"
    fi
    local python
    python=$(find_python)
    say "making .venv with $("$python" --version) ($mode ROS 2 Jazzy)"
    rm -rf "$venv" "$workspace/build" "$workspace/install" "$workspace/log" "$stamps"/package-*
    local pip=("$venv/bin/python" -m pip install -qq --no-input --disable-pip-version-check)
    if [ "$mode" = wheels ]; then
        "$python" -m venv "$venv"
        sed -n '/^uv==/,/[^\\]$/p' "$root/requirements/lock.txt" >"$stamps/uv.txt"
        "${pip[@]}" --no-deps --require-hashes -r "$stamps/uv.txt" || die "could not install uv, which installs the rest"
        install_with_uv || {
            say "uv could not, pip can take some minutes"
            "${pip[@]}" --no-deps --require-hashes -r "$root/requirements/lock.txt" || die "could not install requirements/lock.txt"
        }
    else
        "$python" -m venv --system-site-packages "$venv"
        missing_tools >"$stamps/missing.txt"
        if [ -s "$stamps/missing.txt" ]; then
            "${pip[@]}" --no-deps --require-hashes -r "$stamps/missing.txt" ||
                die "could not install $(sed -n 's/==.*//p' "$stamps/missing.txt" | xargs)"
        fi
    fi
    echo "$fingerprint" >"$venv/fingerprint"
}

# --- the workspace -----------------------------------------------------------------------------------------------

fingerprint_of() { # package: changes when a file that is built changes, comes or goes
    cd "$workspace/src/$1"
    find . -type f -not -path './test/*' -not -path '*/__pycache__/*' -not -path './*.egg-info/*' -not -path '*/.*' -print0 |
        LC_ALL=C sort -z | xargs -0 sha1sum
    sha1sum "$root"/cmake/*
}

run_colcon() { # packages
    local arguments=(build --packages-select "$@" --event-handlers console_stderr-
        --cmake-args -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF -Wno-dev)
    unset MFLAGS MAKELEVEL # colcon's make is not a part of ours
    export MAKEFLAGS=-j$(nproc) # colcon would ask for as many, but also to wait while the machine is busy
    if [ "$mode" = native ]; then
        colcon "${arguments[@]}"
    else
        env -u PYTHONPATH -u LD_LIBRARY_PATH -u COLCON_PREFIX_PATH -u ROS_DISTRO -u _ROS_WHEELS_BOOTSTRAP_COMPLETE \
            VIRTUAL_ENV="$venv" PATH="$venv/bin:$PATH" CMAKE_PREFIX_PATH="$venv" AMENT_PREFIX_PATH="$venv" \
            "$venv/bin/python" -m colcon "${arguments[@]}" "-DPython3_EXECUTABLE=$venv/bin/python" \
            "-DCMAKE_PROJECT_INCLUDE=$root/cmake/ros_wheels.cmake"
    fi
}

ensure_workspace() {
    local manifest package stale=()
    for manifest in "$workspace"/src/*/package.xml; do
        package=$(basename "$(dirname "$manifest")")
        if [ ! -d "$workspace/install/$package" ] ||
            [ "$(fingerprint_of "$package")" != "$(cat "$stamps/package-$package" 2>/dev/null)" ]; then
            stale+=("$package")
        fi
    done
    [ ${#stale[@]} -gt 0 ] || return 0

    say "building ${stale[*]}"
    for package in "${stale[@]}"; do
        fingerprint_of "$package" >"$stamps/next-$package" # taken before, so that an edit meanwhile is seen next time
        if [ ! -e "$workspace/src/$package/CMakeLists.txt" ]; then
            # colcon copies Python files and never forgets one that was renamed or removed
            rm -rf "$workspace/build/$package" "$workspace/install/$package"
        fi
    done
    if ! (cd "$workspace" && rm -rf log && run_colcon "${stale[@]}") >"$stamps/colcon.log" 2>&1; then
        cat "$stamps/colcon.log" >&2
        for package in "${stale[@]}"; do
            tail -n 60 "$workspace/log/latest_build/$package/stderr.log" 2>/dev/null >&2 || true
        done
        die "colcon could not build the workspace; the whole log is in ros2_ws/log/latest_build"
    fi
    for package in "${stale[@]}"; do
        mv "$stamps/next-$package" "$stamps/package-$package"
    done
    rm -f "$venv/workspace.sh" "$venv/bin/stressbot"
}

# --- the launcher ------------------------------------------------------------------------------------------------

# Sourcing colcon's set-up scripts takes about a second, so it is done once, here, and its outcome written down.
# Natively it starts from what is sourced now, with wheels from nothing but the virtual environment.
write_environment() {
    local captured name value clean=()
    local -A last=() # what stands behind the workspace's own entries
    if [ "$mode" = wheels ]; then
        clean=(env -i "PATH=$PATH")
        local site
        site=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("platlib"))')
        last[AMENT_PREFIX_PATH]=$venv
        last[PYTHONPATH]=$site # still before the caller's, which may hold another ROS
        last[LD_LIBRARY_PATH]=$venv/lib$(printf ':%s' "$site"/ros_*.libs)
    fi
    # shellcheck disable=SC2016 # expanded by the inner bash
    captured=$("${clean[@]}" bash -c '
        . "$1" >/dev/null
        printf "%s\n" "AMENT_PREFIX_PATH ${AMENT_PREFIX_PATH:-}" "PYTHONPATH ${PYTHONPATH:-}" "LD_LIBRARY_PATH ${LD_LIBRARY_PATH:-}"
    ' capture "$workspace/install/local_setup.bash")
    {
        echo "# Written by tools/build.sh. What is named here goes before what the caller has set."
        while read -r name value; do
            value=${value%:}${last[$name]:+${value:+:}${last[$name]}}
            echo "export $name='$value'\"\${$name:+:\$$name}\""
        done <<<"$captured"
        if [ "$mode" = wheels ]; then
            # Says that LD_LIBRARY_PATH is right: each interpreter would otherwise start itself a second time.
            echo "export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1"
        else
            echo "export ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3"
        fi
        # Compiled loops outlive a rebuild of the package that they belong to.
        echo "export NUMBA_CACHE_DIR=\"\${NUMBA_CACHE_DIR:-$venv/numba-cache}\""
        # Without any of these, ROS does not know where to write its log and refuses to start.
        # shellcheck disable=SC2016 # expanded where it is sourced
        echo 'if [ -z "${HOME:-}${ROS_HOME:-}${ROS_LOG_DIR:-}" ]; then export ROS_LOG_DIR="${TMPDIR:-/tmp}/ros-log"; fi'
    } >"$venv/workspace.sh.new"
    mv "$venv/workspace.sh.new" "$venv/workspace.sh"
}

write_launcher() {
    local tool=$workspace/install/stressbot_planner/lib/stressbot_planner/stressbot
    [ -e "$tool" ] || die "stressbot_planner installs no executable 'stressbot'"
    cat >"$venv/bin/stressbot.new" <<SH
#!/bin/sh
# Written by tools/build.sh: the workspace's environment, then the installed tool.
. '$venv/workspace.sh'
exec '$venv/bin/python' '$tool' "\$@"
SH
    chmod +x "$venv/bin/stressbot.new"
    mv "$venv/bin/stressbot.new" "$venv/bin/stressbot"
}

# -----------------------------------------------------------------------------------------------------------------

case $root in *[[:space:]]*) die "the path '$root' contains a space, which colcon cannot take; move the folder" ;; esac
mode=wheels
if native_prefix=$(sourced_jazzy); then
    mode=native
fi
mkdir -p "$stamps"
exec 9>"$stamps/lock"
flock 9 # two builds at once take turns

ensure_venv
ensure_workspace
if [ ! -e "$venv/bin/stressbot" ] || [ "$0" -nt "$venv/bin/stressbot" ]; then
    write_environment
    write_launcher
fi
if [ "$stamps/package-stressbot_planner" -nt "$stamps/kernels" ]; then
    say "compiling the planner's loops"
    # shellcheck disable=SC1091 # written above
    (cd "$root" && . "$venv/workspace.sh" && "$venv/bin/python" -c "from stressbot_planner.execution import closed_loop, worker; worker.warm_up(); closed_loop.warm_up()")
    touch "$stamps/kernels"
fi
