#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# viewers.sh RYE RUN WORK: opens what `rye export` writes in programs of other people, and prints the
# PSNR of each picture against `rye render`. Run by hand, as it takes programs from the npm registry:
# node and npm, chromium (or CHROMIUM=path) with its software drawing, and the packages below, which
# are installed in WORK and nowhere else. RUN is a folder of `rye train`; EXPORT holds further options
# of `rye export`, such as "--capture FOLDER". SCENE names another splat file, which splat-transform
# draws too, from EYE toward TARGET (X,Y,Z; by default 0,-1,-4 and 0,-1,0). What a machine lacks is named in a line "not run: ...".
# The pictures stay in WORK. Fails if a picture is below the bound that view.mjs has for its viewer.
set -eu
[ $# -eq 3 ] || { echo "usage: viewers.sh RYE RUN WORK" >&2; exit 2; }
here=$(cd "$(dirname "$0")" && pwd)
rye=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")
run=$(cd "$2" && pwd)
mkdir -p "$3"
[ -z "${SCENE:-}" ] || SCENE=$(cd "$(dirname "$SCENE")" && pwd)/$(basename "$SCENE")
cd "$3"
chromium=${CHROMIUM:-$(command -v chromium || command -v chromium-browser || true)}
for need in node npm; do
    command -v "$need" > /dev/null || { echo "not run: viewers of exports, for there is no $need"; exit 77; }
done
[ -n "$chromium" ] || { echo "not run: viewers of exports, for there is no chromium"; exit 77; }
[ -f package.json ] || npm init -y > /dev/null
PLAYWRIGHT_SKIP_BROWSER_DOWNLOAD=1 npm install --no-audit --no-fund --loglevel=error \
    @playcanvas/splat-transform@2.7.1 @sparkjsdev/spark@2.2.0 three@0.180.0 babylonjs@9 \
    babylonjs-loaders@9 playwright-core > npm.txt 2>&1 ||
    { tail -5 npm.txt; echo "not run: viewers of exports, for npm cannot install them"; exit 77; }

# shellcheck disable=SC2086 # a list of options
for kind in ply splat spz glb; do "$rye" export --run "$run" ${EXPORT:-} --out "head.$kind"; done
view="--eye 0,0,-10 --target 0,0,0 --up 0,-1,0 --fov 18 --size 512x512"
# shellcheck disable=SC2086 # a list of options
for kind in ply splat spz; do "$rye" render "head.$kind" $view --out "rye_$kind.png"; done
# shellcheck disable=SC2086 # a list of options
for kind in ply splat spz; do
    "$rye" render "head.$kind" $view --alpha-floor 0.0111 --out "rye_${kind}_floor.png"
done

# splat-transform draws by WebGPU, for which chromium brings a driver in software. It reads no GLB.
driver=$(dirname "$(readlink -f "$chromium")")/vk_swiftshader_icd.json
[ -f "$driver" ] || driver=/usr/lib/chromium/vk_swiftshader_icd.json
transform=node_modules/@playcanvas/splat-transform/bin/cli.mjs
rm -f transform_*.webp
draw() { # NAME FILE EYE TARGET FOV: in its frame x and y are negated
    XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-/tmp} VK_ICD_FILENAMES=${VK_ICD_FILENAMES:-$driver} \
        node $transform -q -w -g 0 "$2" --camera "$(turned "$3")" --look-at "$(turned "$4")" \
        --up 0,1,0 --fov "$5" --resolution 512x512 "transform_$1.webp" > "transform_$1.txt" 2>&1 ||
        echo "not run: splat-transform on $2, see $PWD/transform_$1.txt"
}
turned() { echo "$1" | awk -F, '{ print -$1 "," (-$2) "," $3 }'; }
for kind in ply splat spz; do draw "$kind" "head.$kind" 0,0,-10 0,0,0 18; done
# It reads the rotations of a .splat half a level of 255 off: with the floor, rye draws that reading.
if node $transform -q -w head.splat splat_as_read.ply > transform_read.txt 2>&1; then
    # shellcheck disable=SC2086 # a list of options
    "$rye" render splat_as_read.ply $view --alpha-floor 0.0111 --out rye_splat_floor.png
fi
if [ "${SCENE:-}" ]; then
    eye=${EYE:-0,-1,-4} target=${TARGET:-0,-1,0}
    for floor in "" 0.0111; do
        "$rye" render "$SCENE" --eye "$eye" --target "$target" --fov 40 --size 512x512 \
            --alpha-floor "${floor:-0}" --out "rye_scene${floor:+_floor}.png"
    done
    draw scene "$SCENE" "$eye" "$target" 40
fi
cp "$here/view.mjs" view.mjs
node view.mjs "$chromium"
