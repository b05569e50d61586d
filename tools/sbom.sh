#!/usr/bin/env bash
# Writes results/sbom.json: every distribution in .venv with version and licence, in CycloneDX, by cyclonedx-py.
# The tool has an environment of its own, below .stamps: what it needs is not what we need.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
unset PYTHONPATH # what it names would count as installed
tool=.stamps/sbom
if ! cmp --silent requirements/sbom.txt "$tool/requirements.txt"; then
    rm -rf "$tool"
    .venv/bin/python -m venv "$tool"
    "$tool/bin/python" -m pip install -qq --no-input --disable-pip-version-check --no-deps --require-hashes -r requirements/sbom.txt
    cp requirements/sbom.txt "$tool/requirements.txt"
fi
mkdir -p results
"$tool/bin/cyclonedx-py" environment --output-reproducible --of JSON --output-file results/sbom.json .venv/bin/python
echo "sbom: results/sbom.json, $(grep -c '"bom-ref"' results/sbom.json) components"
