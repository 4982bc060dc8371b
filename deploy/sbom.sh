#!/bin/sh
# Writes .drivecal/sbom/ROLE.json: the packages of each image with their hashes, as CycloneDX, from its lock; and ROLE.audit.json: what PyPI's advisories
# know of them. A report: weaknesses end nothing.
set -eu
cd "$(dirname "$0")/.."
mkdir -p .drivecal/sbom
for role in api dispatcher ray-head ray-worker; do
    uv tool run --quiet --from 'cyclonedx-bom>=7,<8' cyclonedx-py requirements --output-reproducible --output-file ".drivecal/sbom/$role.json" "deploy/images/$role.lock"
    uv tool run --quiet 'pip-audit>=2.9,<3' --require-hashes --disable-pip --progress-spinner off --format json \
        --output ".drivecal/sbom/$role.audit.json" --requirement "deploy/images/$role.lock" || echo "$role: see .drivecal/sbom/$role.audit.json" >&2
done
