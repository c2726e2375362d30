#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# avatar.sh RYE MAKE_IMPORT_SOURCE WORK: `rye avatar` makes an avatar file and a sheet of the tracks of
# a video, goes on where a signal stopped it, to the same bits, and repeats nothing; what it cannot
# do is one line, and leaves what was there.
set -eu
rye=$1
make=$2
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

"$make" video tracks 20 160 > /dev/null
cat > small.json << 'EOF'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 12, "image_size": 32, "pretrain_steps": 40},
 "gaussians": {"steps": 200, "mouth_points": 20, "panel_every": 100, "checkpoint_every": 5,
  "eyeball": {"points": 120}, "upsampler": {"capacity": 2}}}
EOF
avatar() { "$rye" avatar tracks --preset tiny --config small.json --out "$@"; }

refuses "none.mp4: no such file" "$rye" avatar none.mp4 --out a.avatar
refuses "ends in .avatar" "$rye" avatar tracks --out a.ply
: > none.mp4
refuses "apt-get install nodejs" env PATH=/nowhere "$rye" avatar none.mp4 --out a.avatar
refuses "none.csv" "$rye" avatar tracks --dots none.csv --out a.avatar
[ ! -e a.avatar.work ] || fail "a folder of work is there of what could not begin"
# Dots that nobody looked at: the import says so.
echo begin_s,end_s,right_mm,up_mm > dots.csv
for i in 0 1 2 3 4 5 6 7 8 9; do
    echo "$i,$i.9,$((i * 7 % 5 * 60 - 120)),$((i * 3 % 4 * 40 - 60))" >> dots.csv
done
refuses "follow these dots at no time" "$rye" avatar tracks --dots dots.csv --quiet --out looked.avatar

# Whole, and stopped in the training.
avatar whole.avatar > whole.txt
[ -s whole.avatar ] || fail "no avatar"
[ -s whole.png ] || fail "no sheet"
grep -q "^1 of 4  finding the head in the video" whole.txt || fail "no progress: $(cat whole.txt)"
grep -q "^4 of 4  .*done" whole.txt || fail "no end: $(cat whole.txt)"
grep -q "rye view whole.avatar" whole.txt || fail "the next command is not named"
"$rye" avatar tracks --preset tiny --config small.json --out cut.avatar > cut.txt 2>&1 &
pid=$!
waited=0
until [ -e cut.avatar.work/run/checkpoint.safetensors ]; do
    sleep 0.05
    waited=$((waited + 1))
    [ $waited -lt 6000 ] || fail "no checkpoint after 300 s: $(cat cut.txt)"
done
kill -TERM $pid
code=0
wait $pid || code=$?
[ $code -eq 143 ] || { cat cut.txt; fail "stopped with code $code, expected 143"; }
[ ! -e cut.avatar ] || fail "an avatar of a training that was stopped"
avatar cut.avatar > more.txt
grep -q "^1 of 4" more.txt && fail "the import is repeated"
cmp whole.avatar cut.avatar || fail "another avatar after an interruption"

# Again: nothing is left to do, but for a file that is gone.
rm whole.png
avatar whole.avatar > again.txt
grep -q "of 4  training" again.txt && fail "the training is repeated"
[ -s whole.png ] || fail "the sheet that was removed is not drawn again"
refuses "other videos or options" avatar whole.avatar --frames 9
rm -r cut.avatar.work/avatar.json
refuses "has no avatar.json" avatar cut.avatar

# A video that no head can be found in.
sed 's/"faces":1/"faces":0/' tracks/tracks.jsonl > empty.jsonl
mkdir faceless
mv empty.jsonl faceless/tracks.jsonl
refuses "20 without a face" "$rye" avatar faceless --preset tiny --quiet --out faceless.avatar
[ ! -e faceless.avatar ] || fail "an avatar without a face"
echo "avatars of videos: whole, continued, refused"
