#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# lessons.sh RYE DRAW WORK: DRAW (lesson 11) turns the eyes of an avatar file that `rye` makes, and
# names a file that is not there. Lesson 12 is tests/consumer's.
set -eu
rye=$1 draw=$2 work=$3
rm -rf "$work"
mkdir -p "$work"
cd "$work"
fail() { echo "FAILED: $*" >&2; exit 1; }

"$rye" capture --out capture --frames 3 --test-frames 0 --apart-frames 0 --cameras 3 --size 64 --samples 1 \
    --png --quiet

cat > small.json << 'END'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 12, "image_size": 32, "pretrain_steps": 40},
 "gaussians": {"steps": 12, "mouth_points": 20, "eyeball": {"points": 120}, "upsampler": {"capacity": 2}}}
END
"$rye" train --capture capture --preset tiny --config small.json --quiet --out run > log.txt
"$rye" export --run run --out head.avatar > log.txt
"$draw" head.avatar picture.ppm
[ "$(head -c 2 picture.ppm)" = P6 ] || fail "lesson 11 writes no picture"
[ "$(wc -c < picture.ppm)" -ge $((3 * 64 * 64)) ] || fail "the picture of lesson 11 is too small"
! "$draw" gone.avatar picture.ppm 2> said.txt || fail "lesson 11 draws what is not there"
grep -q "gone.avatar" said.txt || { cat said.txt; fail "no word of the file"; }
