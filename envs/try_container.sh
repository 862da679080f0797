#!/bin/sh
# The image of envs/Dockerfile, built and tried by podman on a bare Debian 12 that debootstrap makes,
# so that no registry is needed. As root, with Debian's podman, runc and debootstrap; outside CI.
#     envs/try_container.sh                        # build, then the tests of one room in a container
#     envs/try_container.sh cherrypicker doctor    # this command instead of the tests
# The images localhost/debian-bare and localhost/cherrypicker are kept; `podman rmi` takes them away.
# OPTIONS goes to both podman calls: --volume for an index of packages or certificates of the host.
set -eu
project=$(dirname "$(dirname "$(readlink -f "$0")")")
[ $# -gt 0 ] || set -- python -m pytest -q tests/geometry
# runc, since Debian 12's crun refuses hosts with both kinds of cgroups; podman's own limits are
# above those of many hosts
podman="podman --runtime runc"
options="--network host --ulimit nofile=4096:4096 --ulimit nproc=4096:4096 ${OPTIONS:-}"

if ! $podman image exists localhost/debian-bare; then
    bare=$(mktemp -d)
    trap 'rm -rf "$bare"' EXIT
    debootstrap --variant=minbase bookworm "$bare/root" "${MIRROR:-http://deb.debian.org/debian}" \
        >/dev/null
    tar -C "$bare/root" -c . | $podman import - localhost/debian-bare
fi
# shellcheck disable=SC2086
$podman build $options --build-arg BASE=localhost/debian-bare --tag localhost/cherrypicker \
    --file "$project/envs/Dockerfile" "$project"
# shellcheck disable=SC2086
$podman run --rm $options localhost/cherrypicker "$@"
