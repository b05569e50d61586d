#!/usr/bin/env bash
# Writes requirements/lock.txt, the exact versions and hashes of everything, from the .in files, and then those of
# comparison.in and sbom.in. Versions that are locked already stay, unless --upgrade is given.
# Resolved for the oldest Python that we support: what suits it suits the newer ones. Then commit and run the tests.
# Usage: tools/lock.sh [--upgrade]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --no-input --disable-pip-version-check uv

header="# Written by tools/lock.sh from the .in files; do not edit."
compile() { # output, then arguments of uv: pins with hashes
    local output=$1
    shift
    "$work/venv/bin/uv" pip compile --quiet --generate-hashes --no-annotate --no-header --python-version 3.11 \
        --python-platform x86_64-manylinux_2_28 --output-file "$output" "$@"
}

cp requirements/lock.txt "$work/lock.txt"
compile "$work/lock.txt" "$@" requirements/{runtime,ros,recording,view,test,docs}.in
{ echo "$header"; cat "$work/lock.txt"; } >requirements/lock.txt

# beside the lock, of which it repeats nothing
if [ -e requirements/comparison.txt ]; then cp requirements/comparison.txt "$work/comparison.txt"; fi
compile "$work/comparison.txt" "$@" --constraint requirements/lock.txt requirements/comparison.in
{
    echo "$header"
    "$work/venv/bin/python" - "$work/comparison.txt" requirements/lock.txt <<'PY'
import re
import sys

ours, locked = (re.findall(r"^\w.*(?:\n    .*)*$", open(path).read(), re.MULTILINE) for path in sys.argv[1:])
names = {pin.split()[0] for pin in locked}
print(*(pin for pin in ours if pin.split()[0] not in names), sep="\n")
PY
} >requirements/comparison.txt

# for an environment of its own
if [ -e requirements/sbom.txt ]; then cp requirements/sbom.txt "$work/sbom.txt"; fi
compile "$work/sbom.txt" "$@" requirements/sbom.in
{ echo "$header"; cat "$work/sbom.txt"; } >requirements/sbom.txt
