#!/usr/bin/env bash
# Writes requirements/lock.txt, the exact versions of everything, from the .in files.
# Resolved with the oldest Python that we support: what suits it suits the newer ones. Then commit and run the tests.
# Usage: tools/lock.sh [python3.11]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
python=${1:-python3.11}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$python" -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --dry-run --ignore-installed --report "$work/report.json" \
    -r requirements/runtime.in -r requirements/ros.in -r requirements/test.in
"$work/venv/bin/python" - "$work/report.json" > "$work/lock.txt" <<'PY'
import json
import re
import sys

packages = [entry["metadata"] for entry in json.load(open(sys.argv[1]))["install"]]
print("# Written by tools/lock.sh from the .in files; do not edit.")
for line in sorted(f"{re.sub('[-_.]+', '-', p['name']).lower()}=={p['version']}" for p in packages):
    print(line)
PY
mv "$work/lock.txt" requirements/lock.txt
