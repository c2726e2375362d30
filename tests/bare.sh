#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# bare.sh SUITE COMMAND...: runs the command in a copy of this project on a bare Debian of that suite
# (bookworm, trixie, ...), as root and with nothing installed but Debian's minimal base:
#     sh tests/bare.sh trixie sh cmake/quickstart.sh
# PACKAGES lists Debian packages to install first. BUILD names the folder of the systems
# (build/bare); the copy lies in SUITE/rye there when the command has ended.
# Needs root, debootstrap and a Debian mirror: without one of them it says so and ends with 77.
set -eu
cd "$(dirname "$0")/.."

suite=$1
shift
work=$PWD/${BUILD:-build/bare}
base=$work/$suite.base
root=$work/$suite
not_here() { echo "bare: $1"; exit 77; }

[ "$(id -u)" = 0 ] || not_here "a bare system is made by root"
if ! command -v debootstrap > /dev/null 2>&1; then
    { command -v apt-get && apt-get update && apt-get install -y --no-install-recommends debootstrap
    } > /dev/null 2>&1 || not_here "no debootstrap"
fi
unshare --mount true 2> /dev/null || not_here "no file system may be mounted here"

mkdir -p "$work"
if [ ! -e "$base/made" ]; then
    mirror=$(apt-get indextargets --format '$(LABEL) $(REPO_URI)' 'Created-By: Packages' |
        sed -n 's/^Debian //p' | head -n 1)
    rm -rf "$base"
    # shellcheck disable=SC2086 # no mirror: debootstrap's own
    debootstrap --variant=minbase "$suite" "$base" $mirror > "$work/$suite.log" 2>&1 ||
        not_here "debootstrap of $suite failed: $(tail -n 1 "$work/$suite.log")"
    [ ! -e /etc/resolv.conf ] || cp /etc/resolv.conf "$base/etc/"
    touch "$base/made"
fi
rm -rf "$root"
cp -a "$base" "$root"
mkdir "$root/rye"
if git rev-parse --is-inside-work-tree > /dev/null 2>&1; then
    git ls-files -z --cached --others --exclude-standard
else
    find . -name build -prune -o -type f -print0
fi | tar c --null --files-from=- --ignore-failed-read | tar x -C "$root/rye"

if [ -n "${PACKAGES:-}" ]; then
    # shellcheck disable=SC2016 # for the shell in there
    set -- sh -c '{ apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y \
        --no-install-recommends $PACKAGES; } > /dev/null && exec "$@"' sh "$@"
fi
# Mounts of its own, gone with the command; and nothing of this machine's environment.
# shellcheck disable=SC2016 # for the shell in there
exec unshare --mount sh -c 'root=$1; shift
    mount --rbind /dev "$root/dev"
    mount -t proc proc "$root/proc" 2> /dev/null || mount --rbind /proc "$root/proc"
    exec chroot "$root" "$@"' sh "$root" \
    /usr/bin/env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin ${JOBS:+"JOBS=$JOBS"} \
    "PACKAGES=${PACKAGES:-}" sh -c 'cd /rye && exec "$@"' sh "$@"
