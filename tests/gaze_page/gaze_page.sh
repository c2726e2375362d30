#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# gaze_page.sh RYE WORK: builds examples/gaze_page with an avatar of half the size that `--preset
# cpu` trains, of a few steps (its skin moves more than that of a trained one), and has a headless Chromium
# visit it (test.js), has that draw by several threads (threads.js) and by WebGPU (webgpu.js), that head and
# one whose network doubles and normalises; then the head as `rye view` draws it (view.js). Where emscripten,
# node or Chromium is missing it says so and ends with 77. From the environment:
#   CHROMIUM   the browser (default: chromium, chromium-browser or google-chrome)
#   MEDIAPIPE and LANDMARKER   as for build.sh: then visitor.js shows the page's camera a face
#   AVATAR and REFERENCE, DRIVERS   instead of its own: an avatar file, a picture of it by
#              `rye redirect`, and the gazes of that (left pitch, yaw, right pitch, yaw [degrees])
set -eu
rye=$1
work=$2
here=$(cd "$(dirname "$0")" && pwd)

not_run() { echo "not run: gaze_page: $1"; exit 77; }
command -v em++ > /dev/null || not_run "no em++ (Debian package emscripten)"
command -v node > /dev/null || not_run "no node (Debian package nodejs)"
chromium=${CHROMIUM:-}
for name in chromium chromium-browser google-chrome; do
    [ -n "$chromium" ] || chromium=$(command -v "$name" || true)
done
[ -n "$chromium" ] || not_run "no chromium (Debian package chromium)"

mkdir -p "$work"
work=$(cd "$work" && pwd)
avatar=${AVATAR:-$work/head.avatar}
reference=${REFERENCE:-$work/reference.png}
drivers=${DRIVERS:-8,-12,4,-16}
if [ -z "${AVATAR:-}" ]; then
    rm -rf "$work/capture" "$work/run" "$work/doubled" "$work/doubled.avatar"
    "$rye" capture --out "$work/capture" --size 256 --cameras 3 --frames 6 --test-frames 1 \
        --apart-frames 1 --samples 1 --quiet
    cat > "$work/short.json" << 'EOF'
{"avatar": {"gaze_frequencies": 4, "shading": "none", "eye_appearance": "free",
            "networks": {"exp_deform": [64, 64, 64, 64], "pose_deform": [64, 64],
                         "gaze_deform": [64, 64, 64]}},
 "grid": {"cell": 0.1458},
 "mesh": {"steps": 60, "pretrain_steps": 200, "fit_steps": 100, "fit_mixed": 0},
 "gaussians": {"steps": 60, "spacing_slope": 0.2, "mouth_points": 600, "rates": {"deform": 1e-3}}}
EOF
    "$rye" train --capture "$work/capture" --preset cpu --config "$work/short.json" --quiet \
        --out "$work/run" > "$work/train.log"
    "$rye" export --run "$work/run" --out "$avatar"
    "$rye" redirect --run "$work/run" --gaze-left "${drivers%,*,*}" --gaze-right "${drivers#*,*,}" \
        --out "$reference"
    cat > "$work/doubled.json" << 'EOF'
{"avatar": {"channels": 20},
 "mesh": {"steps": 20, "pretrain_steps": 100, "fit_steps": 50, "fit_mixed": 0},
 "gaussians": {"steps": 40, "upsampler": {"norm": "instance", "capacity": 6}}}
EOF
    "$rye" train --capture "$work/capture" --preset tiny --config "$work/doubled.json" --quiet \
        --out "$work/doubled" >> "$work/train.log"
    "$rye" export --run "$work/doubled" --out "$work/doubled.avatar"
fi
poster=
! command -v ffmpeg > /dev/null || poster=$reference
MORE="$here/features.c" POSTER="$poster" sh "$here/../../examples/gaze_page/build.sh" "$avatar" "$work/page"
doubled=
[ ! -f "$work/doubled.avatar" ] || { doubled=doubled.avatar; cp "$work/$doubled" "$work/page/"; }
node "$here/test.js" "$chromium" "$work/page" "$reference" "$drivers" "$work/pictures"
node "$here/threads.js" "$chromium" "$work/page" "$work/pictures" ${doubled:+"$doubled"}
node "$here/webgpu.js" "$chromium" "$work/page" "$work/pictures" ${doubled:+"$doubled"}
node "$here/face.js"
if [ -z "${MEDIAPIPE:-}" ] || [ -z "$poster" ] || [ ! -d "$work/capture" ]; then
    echo "not run: gaze_page: the page's camera: MEDIAPIPE, ffmpeg or a capture is missing"
else
    node "$here/visitor.js" "$chromium" "$work/page" "$work/capture" "$work/pictures"
fi
[ -d "$work/run" ] || exit 0
node "$here/view.js" "$chromium" "$rye" "$work/run" "$reference" "$drivers" "$work/pictures"
