#!/usr/bin/env bash
# make mutants: changes one thing after another in the sequence check, the session and the gate, in a copy, and lets their tests find
# it. Prints what they did not find; docs/safety.md says of each why. Hours; ARGS="session" does one of the three.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python -m pip install -qq --no-input --disable-pip-version-check --target "$folder/library" -r requirements/mutation.txt
mkdir -p "$folder/ros2_ws/src"
cp -r ros2_ws/src/stressbot_driver "$folder/ros2_ws/src/"
cp -r docs pyproject.toml "$folder/"
cd "$folder/ros2_ws/src/stressbot_driver"
export PYTHONPATH=$PWD:$PYTHONPATH:$folder/library PYTHONDONTWRITEBYTECODE=1 OPENBLAS_NUM_THREADS=1
declare -A modules=([sequence]=sequence [session]=session [gate]=gate/gate)
for name in ${@:-sequence session gate}; do
    cat >"$name.toml" <<TOML
[cosmic-ray]
module-path = "stressbot_driver/${modules[$name]}.py"
timeout = 60.0
excluded-modules = []
test-command = "python -m pytest -x -q -p no:cacheprovider -p no:xdist test/test_sequence.py test/test_session.py test/test_gate.py"
[cosmic-ray.distributor]
name = "local"
TOML
    tool() { python "$folder/library/bin/$1" "${@:2}"; }
    tool cosmic-ray init "$name.toml" "$name.sqlite" 2>/dev/null
    tool cosmic-ray baseline "$name.toml"
    tool cosmic-ray exec "$name.toml" "$name.sqlite" 2>/dev/null
    tool cr-report --show-diff --surviving-only "$name.sqlite"
done
