#!/usr/bin/env bash
# Runs the packages' tests with the oldest libraries that we support, those of Ubuntu 24.04, in a clone of what is committed.
# Arguments are passed on to pytest, before the folders of tests.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
clone=$PWD/.stamps/oldest
rm -rf "$clone"
git clone --quiet . "$clone"
cd "$clone"
PYTHON=${PYTHON:-python3.12} tools/build.sh
.venv/bin/python -m pip install -qq --no-input --disable-pip-version-check --no-deps -r requirements/oldest.txt
source tools/env.sh
export OPENBLAS_NUM_THREADS=1 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
python -m pytest -q -n 2 --dist loadgroup -m "not timing" "$@" ros2_ws/src/*/test
