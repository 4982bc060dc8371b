#!/bin/sh
# Makes .venv from deploy/requirements.lock and installs drivecal into it, editable. Run by every make target.
# Needs only Python >= 3.11 with venv. Uses uv where it is there, else brings it into .venv, else does with pip.
set -eu
cd "$(dirname "$0")/.."

python=${PYTHON:-}
if [ -z "$python" ]; then
    for candidate in python3 python3.13 python3.12 python3.11 python; do
        if command -v "$candidate" >/dev/null 2>&1 &&
            "$candidate" -c 'import sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            python=$candidate
            break
        fi
    done
fi
if [ -z "$python" ]; then
    echo "drivecal needs Python 3.11 or newer with the venv module; found: $(python3 --version 2>&1). Set PYTHON=/path/to/python." >&2
    exit 1
fi

started=$(date +%s)
echo "drivecal: installing into .venv with $("$python" --version) (only the first time, or when the lock changes)" >&2
[ -x .venv/bin/python ] || "$python" -m venv .venv
if command -v uv >/dev/null 2>&1; then
    uv=uv
elif .venv/bin/python -m pip install --quiet --disable-pip-version-check uv 2>/dev/null; then
    uv=.venv/bin/uv
else
    uv=
fi
if [ -n "$uv" ]; then
    "$uv" pip install --quiet --python .venv/bin/python --require-hashes -r deploy/requirements.lock
    "$uv" pip install --quiet --python .venv/bin/python --no-deps --no-build-isolation --editable .
else
    .venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r deploy/requirements.lock
    .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
fi
if [ -f services/drivecal/api/static/missing.txt ]; then
    echo "drivecal: the page in the browser could not be built, everything else works: $(cat services/drivecal/api/static/missing.txt)" >&2
fi
touch .venv/.installed
echo "drivecal: installed in $(($(date +%s) - started)) s" >&2
