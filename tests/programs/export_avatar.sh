#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# export_avatar.sh RYE LESSON WORK: a run becomes an avatar file that the lesson in C draws without
# the run and the capture; what cannot be exported gives one sentence and leaves what was there.
set -eu
rye=$1
lesson=$2
work=$3
rm -rf "$work"
mkdir -p "$work"
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }
# refuses WORDS COMMAND...: the command must fail with one line that holds the words.
refuses() {
    words=$1
    shift
    if "$@" > out.txt 2> err.txt; then fail "accepted: $*"; fi
    grep -q -- "$words" err.txt || { cat out.txt err.txt; fail "no word of '$words' from: $*"; }
    [ "$(wc -l < err.txt)" -eq 1 ] || { cat err.txt; fail "more than a line from: $*"; }
}

"$rye" capture --out cap --size 64 --cameras 3 --frames 3 --test-frames 1 --apart-frames 0 \
    --samples 1 --quiet
cat > small.json << 'EOF'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 4, "image_size": 32, "pretrain_steps": 40},
 "gaussians": {"steps": 4, "mouth_points": 20, "eyeball": {"points": 120},
  "upsampler": {"capacity": 2}}}
EOF
for axis in optical visual; do
    sed "s/^{\"avatar\"/{\"gaze_axis\": \"$axis\", \"avatar\"/" small.json > "$axis.json"
    "$rye" train --capture cap --preset tiny --config "$axis.json" --quiet --out "$axis" > log.txt
    "$rye" export --run "$axis" --out "$axis.avatar" > said.txt
    grep -q "^$axis.avatar: [0-9]* Gaussians, [0-9.]* MB; its pictures are the run's to [4-9][0-9.]* dB" \
        said.txt || { cat said.txt; fail "another report"; }
    "$rye" export --run "$axis" --full-precision --out full.avatar > said.txt
    grep -q "its pictures are the run's, bit for bit" said.txt || { cat said.txt; fail "other bits"; }
    [ "$(wc -c < full.avatar)" -gt "$(wc -c < "$axis.avatar")" ] || fail "half precision is no smaller"
    "$rye" export --run "$axis" --out again.avatar > said.txt
    cmp "$axis.avatar" again.avatar || fail "another file the second time"
done

# A capture of larger pictures: the file's camera is for pictures like training's all the same.
"$rye" capture --out large --size 128 --cameras 3 --frames 3 --test-frames 1 --apart-frames 0 \
    --samples 1 --quiet
"$rye" export --run visual --capture large --out large.avatar > said.txt
"$lesson" large.avatar large.ppm
[ "$(wc -c < large.ppm)" -eq $((64 * 64 * 3 + 13)) ] || fail "another size than training's"

# Nothing but the file is needed.
mkdir alone
mv optical.avatar alone/head.avatar
mv cap gone
"$lesson" alone/head.avatar alone/head.ppm
[ "$(head -c 2 alone/head.ppm)" = P6 ] || fail "no PPM image"
[ "$(wc -c < alone/head.ppm)" -eq $((64 * 64 * 3 + 13)) ] || fail "no picture of 64 x 64 pixels"
[ "$(tail -c +14 alone/head.ppm | od -An -v -tx1 | tr -s ' ' '\n' | sort -u | wc -l)" -gt 30 ] ||
    fail "a picture of few levels"
mv gone cap

refuses "nowhere" "$rye" export --run nowhere --out x.avatar
refuses "no-such-frame" "$rye" export --run optical --frame no-such-frame --out x.avatar
refuses "no-such-camera" "$rye" export --run optical --camera no-such-camera --out x.avatar
refuses "nowhere/x.avatar" "$rye" export --run optical --out nowhere/x.avatar
[ ! -e x.avatar ] || fail "a file of a run that could not be exported"
head -c 5000 alone/head.avatar > cut.avatar
refuses "cut.avatar" "$lesson" cut.avatar cut.ppm
refuses "rye-checkpoint" "$lesson" optical/checkpoint.safetensors cut.ppm
printf rubbish > rubbish.avatar
refuses "rubbish.avatar" "$lesson" rubbish.avatar cut.ppm
[ ! -e cut.ppm ] || fail "a picture of a damaged file"
echo "avatar files: written, drawn alone, refused"
