#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# peers.sh RYE RUN WORK: times a picture of the head of RUN, a folder of `rye train`, in one headless Chromium:
# by the gaze page, and of the .ply that `rye export` writes by viewers of other people (peers.js). Run by
# hand, as it takes these from the npm registry, into WORK and nowhere else. From the environment: CHROMIUM,
# SIZES (256 512 1024), and those of peers.js. Ends with 77 where a program or a package is missing.
set -eu
[ $# -eq 3 ] || { echo "usage: peers.sh RYE RUN WORK" >&2; exit 2; }
here=$(cd "$(dirname "$0")" && pwd)
rye=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")
run=$(cd "$2" && pwd)
mkdir -p "$3"
cd "$3"
not_run() { echo "not run: peers of the gaze page: $1"; exit 77; }
for need in em++ node npm; do command -v $need > /dev/null || not_run "no $need"; done
chromium=${CHROMIUM:-$(command -v chromium || command -v chromium-browser || true)}
[ -n "$chromium" ] || not_run "no chromium"
[ -f package.json ] || npm init -y > /dev/null
npm install --ignore-scripts --no-audit --no-fund --loglevel=error @sparkjsdev/spark@2.2.0 three@0.187.0 \
    playcanvas@2.23.3 > npm.txt 2>&1 || { tail -5 npm.txt; not_run "npm cannot install the viewers"; }
"$rye" export --run "$run" --out head.avatar
"$rye" export --run "$run" --gaze-left 0,0 --gaze-right 0,0 --axes world --out head.ply
sh "$here/../../../examples/gaze_page/build.sh" head.avatar page
# shellcheck disable=SC2086 # a list
node "$here/peers.js" "$chromium" . ${SIZES:-}
