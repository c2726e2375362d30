#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# video.sh RYE VIDEO_TRUTH WORK: films a head, tracks it in a browser, imports the tracks, and compares
# the capture with the truth. Where a tool or a model is missing it says so and ends with 77.
# From the environment:
#   RYE_MODULES, RYE_FACE_LANDMARKER, CHROMIUM   as for `rye import video`
#   RYE_DATA     a folder with ict/ict_light.npz, the head that is filmed
#   FRAMES, SIZE, SEED   of the video (default: 30, 480 and 3)
set -eu
rye=$1
truth=$2
work=$3
not_run() { echo "skipped: video: $1"; exit 77; }
model=${RYE_DATA:-none}/ict/ict_light.npz
[ -f "$model" ] || not_run "no head that the tracker knows as a face (RYE_DATA/ict/ict_light.npz)"
rm -rf "$work"
mkdir -p "$work"
: > "$work/none.mp4"
# A file of no bytes is told only when all tools are there.
said=$("$rye" import video "$work/none.mp4" --out "$work/none" 2>&1) && { echo "an empty file was taken"; exit 1; }
case $said in
    *"needs what is not here"*) not_run "${said#*needs what is not here: }" ;;
    *"ffmpeg reads no pictures of it"*) ;;
    *) echo "$said"; exit 1 ;;
esac
[ ! -e "$work/none" ] || { echo "a capture of an empty file is there"; exit 1; }
"$rye" capture --model "$model" --seed "${SEED:-3}" --video "$work/head.mp4" --frames "${FRAMES:-30}" \
    --rate 5 --size "${SIZE:-480}" --samples 2 --out "$work/truth" --quiet
head -c 9000 "$work/head.mp4" > "$work/cut.mp4"
said=$("$rye" import video "$work/cut.mp4" --out "$work/cut" 2>&1) && { echo "a part of a file was taken"; exit 1; }
case $said in
    *"
"*) echo "more than a line: $said"; exit 1 ;;
    *"cut.mp4: ffmpeg reads no pictures of it: no video stream"*) echo "ffmpeg is not quoted: $said"; exit 1 ;;
    *"cut.mp4: ffmpeg reads no pictures of it"*) ;;
    *) echo "$said"; exit 1 ;;
esac
"$rye" import video "$work/head.mp4" --every 1 --out "$work/capture"
"$truth" "$work/truth" "$work/capture" "$work/true_gazes" | tee "$work/differences"
"$rye" info "$work/true_gazes" > "$work/info.txt" || { cat "$work/info.txt"; exit 1; }
# A fifth of the frames have true gazes now.
"$truth" "$work/truth" "$work/true_gazes" > "$work/less"
awk '/^gaze/ { if (NR == FNR) was[$2] = $3; else if ($3 > 0.9 * was[$2]) { print "gazes are not the true ones"; bad = 1 } }
     END { exit bad }' "$work/differences" "$work/less"
# Looser than what docs/video.md states: fewer pictures, of fewer pixels.
awk '/^head pose/ && $3 > 7 { print "the head turns otherwise"; bad = 1 }
     /^gaze/ && $3 > 15 { print "the gaze is wrong"; bad = 1 }
     /^masks/ && $2 < 0.9 { print "the masks are wrong"; bad = 1 }
     END { exit bad }' "$work/differences"
