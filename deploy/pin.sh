#!/bin/sh
# Writes deploy/images/pinned.env anew: the images of others with the digests that their registry has for their tags now. Needs Docker with
# buildx and a network; without, the file stays as it is.
set -eu
cd "$(dirname "$0")/images"
new=$(mktemp)
trap 'rm -f "$new"' EXIT
while IFS= read -r line; do
    case $line in
    DRIVECAL_*=*)
        image=${line#*=}
        image=${image%@*}
        digest=$(docker buildx imagetools inspect --format '{{.Manifest.Digest}}' "$image" </dev/null)
        case $digest in
        sha256:*) line="${line%%=*}=$image@$digest" ;;
        *) echo "$image: no digest: $digest" >&2 && exit 1 ;;
        esac
        ;;
    esac
    printf '%s\n' "$line"
done <pinned.env >"$new"
cat "$new" >pinned.env
