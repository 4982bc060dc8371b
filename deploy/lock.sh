#!/bin/sh
# Writes deploy/requirements.lock: every dependency of the services, the workers and the tests with its hashes,
# for every platform and Python version that drivecal supports; and from it the locks of the images. Run by `make lock`.
set -eu
cd "$(dirname "$0")/.."
uv=${UV:-uv}
compile() {
    "$uv" pip compile --universal --generate-hashes --no-annotate --no-emit-index-url --no-emit-find-links --quiet \
        --custom-compile-command "make lock" "$@"
}
compile pyproject.toml --extra cluster --group dev "$@" --output-file deploy/requirements.lock
for list in deploy/images/*.in; do
    compile "$list" --constraint deploy/requirements.lock --python-version 3.11 --output-file "${list%.in}.lock"
done
