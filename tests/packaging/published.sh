#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# published.sh [WORK]: makes a release of the last commit in WORK (build/published), of the two lowest levels
# of processor, and sees that what is in it works: artefacts.sh, container.sh, and on bare systems
# first_minutes.sh, whose table it prints. What cannot be made or run here is named. It takes an hour and
# more on two processors. RELEASE of the environment names a folder that packaging/release.sh made, to look
# at that one.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
git -C "$here" rev-parse HEAD > /dev/null 2>&1 || { echo "not run: a release, for this is no checkout of git"; exit 0; }
work=${1:-$here/../../build/published}
mkdir -p "$work"
work=$(cd "$work" && pwd)
release=${RELEASE:-}
if [ -z "$release" ]; then
    release=$work/release
    rm -rf "$release"
    levels=x86-64
    if grep -qw avx2 /proc/cpuinfo && grep -qw fma /proc/cpuinfo; then levels="x86-64 x86-64-v3"; fi
    LEVELS=$levels sh "$here/../../packaging/release.sh" HEAD "$release"
fi
sh "$here/artefacts.sh" "$release" "$work/bare"
sh "$here/container.sh" "$release" "$work/bare" || [ $? = 77 ]
sh "$here/first_minutes.sh" "$release" "$work/bare"
