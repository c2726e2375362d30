#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# readers.sh RYE RUN WORK: gives what `rye export` writes to readers of other people, and compares the
# numbers that they take from it: a .usda with a sweep of gazes to TinyUSDZ, an SPZ of version 4 to
# splat-transform. Run by hand, as it takes programs from the npm registry, into WORK. RUN is a folder of
# `rye train`; EXPORT holds further options of `rye export`. Prints the largest differences, and fails
# beyond readers.mjs' bounds. Ends with 77 where node, npm or a package is missing.
set -eu
[ $# -eq 3 ] || { echo "usage: readers.sh RYE RUN WORK" >&2; exit 2; }
here=$(cd "$(dirname "$0")" && pwd)
rye=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")
run=$(cd "$2" && pwd)
mkdir -p "$3"
cd "$3"
for need in node npm; do
    command -v "$need" > /dev/null || { echo "not run: readers of exports, for there is no $need"; exit 77; }
done
[ -f package.json ] || npm init -y > /dev/null
npm install --no-audit --no-fund --loglevel=error tinyusdz@0.9.0-rc10 @playcanvas/splat-transform@2.7.1 > npm.txt 2>&1 ||
    { tail -5 npm.txt; echo "not run: readers of exports, for npm cannot install them"; exit 77; }
# shellcheck disable=SC2086 # a list of options
export_as() { "$rye" export --run "$run" ${EXPORT:-} "$@"; }
export_as --gaze-sweep 10,3 --out sweep.usda
export_as --out head.ply
export_as --spz-version 4 --out head.spz
rm -f read.ply
node node_modules/@playcanvas/splat-transform/bin/cli.mjs -q -w head.spz read.ply > transform.txt 2>&1 ||
    { cat transform.txt; exit 1; }
cp "$here/readers.mjs" readers.mjs
node readers.mjs
