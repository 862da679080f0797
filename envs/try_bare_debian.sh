#!/bin/sh
# README's commands in a bare Debian 12: what a user meets who has nothing but what README names.
# As root, with debootstrap; outside CI, since the demo and the tests take their time.
#     envs/try_bare_debian.sh /var/tmp/bare                # make demo, then make test
#     envs/try_bare_debian.sh /var/tmp/bare install docs   # these make targets instead
# The folder is made where it is not there, and is kept. Settings of pip in the environment
# (PIP_INDEX_URL ...) count inside too; MOUNTS names further folders of the host to show there.
set -eu
project=$(dirname "$(dirname "$(readlink -f "$0")")")
root=$1
shift
[ $# -gt 0 ] || set -- demo test

if [ ! -e "$root/usr/bin/make" ]; then
    debootstrap --variant=minbase --include=python3,python3-venv,make,ca-certificates \
        bookworm "$root" "${MIRROR:-http://deb.debian.org/debian}" >/dev/null
fi
home=$root/root/cherrypicker
mkdir -p "$home"
# What is in the clone and not ignored, as somebody gets it
(cd "$project" && git ls-files -z --cached --others --exclude-standard | tar -c --null -T - 2>/dev/null) |
    tar -x -C "$home"
cp /etc/resolv.conf "$root/etc/resolv.conf"

mounted=""
trap 'for each in $mounted; do umount -R -l "$root$each"; done' EXIT
for each in /proc /dev ${MOUNTS:-}; do
    mkdir -p "$root$each"
    mount --rbind "$each" "$root$each" 2>/dev/null || mount --bind "$each" "$root$each"
    mount --make-rslave "$root$each"
    mounted="$each $mounted"
done
for target in "$@"; do
    echo "== make $target, in $(cat "$root/etc/debian_version")"
    # A login without the host's Python or caches
    env -u VIRTUAL_ENV -u PYTHONPATH HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin \
        chroot "$root" make -C /root/cherrypicker "$target"
done
