#!/bin/sh
# Open3D loads four system libraries that pip cannot bring. Install what is missing where that is
# allowed, else say exactly what to install.
set -eu

libraries="libusb-1.0.so.0:libusb-1.0-0 libEGL.so.1:libegl1 libGL.so.1:libgl1 libX11.so.6:libx11-6 libgomp.so.1:libgomp1"

[ "$(uname -s)" = Linux ] || exit 0
known=$( (ldconfig -p || /sbin/ldconfig -p) 2>/dev/null || true)
missing=""
for pair in $libraries; do
    case "$known" in
    *"${pair%%:*}"*) ;;
    *) missing="$missing ${pair##*:}" ;;
    esac
done
[ -n "$missing" ] || exit 0

as_root=""
if [ "$(id -u)" -ne 0 ]; then
    if command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        as_root="sudo"
    else
        as_root="none"
    fi
fi
if ! command -v apt-get >/dev/null 2>&1 || [ "$as_root" = none ]; then
    echo "Open3D needs system libraries that are missing here. Please install them and run again:" >&2
    echo "    sudo apt-get install$missing" >&2
    exit 1
fi
echo "installing system packages:$missing"
$as_root apt-get update -qq
# shellcheck disable=SC2086
DEBIAN_FRONTEND=noninteractive $as_root apt-get install -y -qq --no-install-recommends $missing >/dev/null
