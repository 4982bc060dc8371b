#!/bin/sh
# Writes deploy/requirements.lock: every dependency of the services, the workers and the tests with its hashes,
# for every platform and Python version that drivecal supports. Run by `make lock`.
set -eu
cd "$(dirname "$0")/.."
uv=${UV:-uv}
"$uv" pip compile pyproject.toml --extra service --extra worker --group dev \
    --universal --generate-hashes --no-annotate --no-emit-index-url --no-emit-find-links --quiet \
    --custom-compile-command "make lock" "$@" --output-file deploy/requirements.lock
