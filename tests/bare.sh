#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# bare.sh SUITE COMMAND...: runs the command in a copy of this project on a bare Debian or Ubuntu of that
# suite (bullseye, bookworm, trixie, jammy, noble, ...), as root and with nothing installed but the
# minimal base:
#     sh tests/bare.sh trixie sh cmake/quickstart.sh
# PACKAGES lists packages to install first. CARRY lists files and folders that are copied to carried/ of
# the copy. BUILD names the folder of the systems (build/bare); the copy lies in SUITE/rye there when the
# command has ended.
# Needs root, debootstrap and a mirror: without one of them it says so and ends with 77.
set -eu
from=$PWD
cd "$(dirname "$0")/.."
. tests/portability/unpack.sh

suite=$1
shift
case ${BUILD:-build/bare} in
/*) work=${BUILD:-} ;;
*) work=$PWD/${BUILD:-build/bare} ;;
esac
base=$work/$suite.base
root=$work/$suite
not_here() { echo "bare: $1"; exit 77; }

[ "$(id -u)" = 0 ] || not_here "a bare system is made by root"
if ! command -v debootstrap > /dev/null 2>&1; then
    { command -v apt-get && apt-get update && apt-get install -y --no-install-recommends debootstrap
    } > /dev/null 2>&1 || not_here "no debootstrap"
fi
unshare --mount true 2> /dev/null || not_here "no file system may be mounted here"

strap() { # MIRROR OPTIONS...: the base; no mirror: debootstrap's own
    site=$1
    shift
    rm -rf "$base"
    # An older debootstrap makes newer suites by the script of an older one.
    scripts=/usr/share/debootstrap/scripts script=
    case $suite in
    noble) [ -e $scripts/noble ] || script=$scripts/jammy ;;
    esac
    debootstrap --variant=minbase "$@" "$suite" "$base" "$site" $script > "$work/$suite.log" 2>&1
}

mkdir -p "$work"
if [ ! -e "$base/made" ]; then
    made=
    case $suite in
    jammy | noble)  # from debootstrap's own mirror, with keys that Debian has since its version 13
        (unpack trixie "$(dpkg --print-architecture)" "$work/keys" ubuntu-keyring) || not_here "no keys of Ubuntu's archive"
        strap "" --keyring="$work/keys/usr/share/keyrings/ubuntu-archive-keyring.gpg" && made=yes ;;
    *)
        mirror=$(apt-get indextargets --format '$(LABEL) $(REPO_URI)' 'Created-By: Packages' |
            sed -n 's/^Debian //p' | head -n 1)
        for site in "$mirror" http://archive.debian.org/debian; do  # where old ones go
            [ -n "$made" ] || { strap "$site" && made=yes; }
        done ;;
    esac
    [ -n "$made" ] || not_here "debootstrap of $suite failed: $(tail -n 1 "$work/$suite.log")"
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

for carried in ${CARRY:-}; do
    mkdir -p "$root/rye/carried"
    cp -R "$(cd "$from" && readlink -f "$carried")" "$root/rye/carried/"
done

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
