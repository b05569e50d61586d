#!/usr/bin/env bash
# Writes requirements/lock.txt, the exact versions of everything, from the .in files, and then comparison.txt: what
# comparison.in needs beside that.
# Resolved with the oldest Python that we support: what suits it suits the newer ones. Then commit and run the tests.
# Usage: tools/lock.sh [python3.11]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
python=${1:-python3.11}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m venv "$work/venv"

resolve() { # pins that pip finds for its arguments
    "$work/venv/bin/python" -m pip install -qq --dry-run --ignore-installed --report "$work/report.json" "$@"
    "$work/venv/bin/python" - "$work/report.json" <<'PY'
import json
import re
import sys

packages = [entry["metadata"] for entry in json.load(open(sys.argv[1]))["install"]]
for line in sorted(f"{re.sub('[-_.]+', '-', p['name']).lower()}=={p['version']}" for p in packages):
    print(line)
PY
}

header="# Written by tools/lock.sh from the .in files; do not edit."
{ echo "$header"; resolve -r requirements/runtime.in -r requirements/ros.in -r requirements/recording.in -r requirements/view.in -r requirements/test.in; } >"$work/lock.txt"
resolve -c "$work/lock.txt" -r requirements/comparison.in >"$work/comparison.txt"
{ echo "$header"; grep -vxFf "$work/lock.txt" "$work/comparison.txt"; } >"$work/more.txt"
mv "$work/lock.txt" requirements/lock.txt
mv "$work/more.txt" requirements/comparison.txt
