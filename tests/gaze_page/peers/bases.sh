#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# bases.sh RYE RUN WORK: what the linear bases of the head of RUN, a folder of `rye train`, cost in
# pictures, bytes and time, in Spark (bases.js). Run by hand, as it takes Spark from the npm registry, into
# WORK and nowhere else; or from there, if it is there already. From the environment: CHROMIUM, SIZE (512).
# Ends with 77 where a program or a package is missing.
set -eu
[ $# -eq 3 ] || { echo "usage: bases.sh RYE RUN WORK" >&2; exit 2; }
here=$(cd "$(dirname "$0")" && pwd)
rye=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")
run=$(cd "$2" && pwd)
mkdir -p "$3"
cd "$3"
not_run() { echo "not run: bases in Spark: $1"; exit 77; }
for need in node npm; do command -v $need > /dev/null || not_run "no $need"; done
chromium=${CHROMIUM:-$(command -v chromium || command -v chromium-browser || true)}
[ -n "$chromium" ] || not_run "no chromium"
[ -f package.json ] || npm init -y > /dev/null
[ -d node_modules/@sparkjsdev/spark ] ||
    npm install --ignore-scripts --no-audit --no-fund --loglevel=error @sparkjsdev/spark@2.2.0 three@0.187.0 \
        > npm.txt 2>&1 || { tail -5 npm.txt; not_run "npm cannot install Spark"; }
cp "$here"/../../../examples/spark/*.mjs .
"$rye" export --run "$run" --canonical --out head.spz
"$rye" export --run "$run" --canonical --axes world --out head.ply --bases head.safetensors
node "$here/bases.js" "$chromium" "$PWD" "$rye" "$run"
