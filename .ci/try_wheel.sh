#!/usr/bin/env bash
# Install a wheel into a new environment and solve there, with nothing on the PATH that could compile.
#
#     .ci/try_wheel.sh dist/mbocp-*.whl [EXTRA]      EXTRA: compiler
set -eu
wheel=$(realpath "$1")
extra=${2:+[$2]}
folder=$(mktemp -d)
remove=$(command -v rm)
trap '"$remove" -rf "$folder"' EXIT
cd "$folder"

step() {
    local begin=$SECONDS
    echo "\$ ${*}"
    "$@"
    echo "    ($((SECONDS - begin)) s)"
}

step "${PYTHON:-python3}" -m venv env
export PATH="$folder/env/bin" MBOCP_CACHE_DIR="$folder/cache"
unset CC CXX PYTHONPATH
step pip install -q --disable-pip-version-check "$wheel$extra"
step mbocp doctor || true # warns of the missing compiler
step mbocp new ur5 -o reach.toml
step mbocp solve reach.toml -q -o reach.h5
step mbocp replay reach.h5 -o reach.html
step mbocp solve reach.toml -q --set goal.q.elbow_joint=0.9
