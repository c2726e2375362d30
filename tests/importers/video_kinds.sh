#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# video_kinds.sh RYE WORK: videos as people have them, made of one filmed head: `rye import video` makes a
# capture of what shows one head, and says in one line what is wrong with the rest, which leaves nothing.
# Where a tool or a model is missing it says so and ends with 77. From the environment: as for video.sh.
set -eu
rye=$1
work=$2
not_run() { echo "skipped: video_kinds: $1"; exit 77; }
fail() { echo "FAILED: $*" >&2; exit 1; }
model=${RYE_DATA:-none}/ict/ict_light.npz
[ -f "$model" ] || not_run "no head that the tracker knows as a face (RYE_DATA/ict/ict_light.npz)"
rm -rf "$work"
mkdir -p "$work"
cd "$work"
: > none.mp4
said=$("$rye" import video none.mp4 --out none 2>&1) && fail "an empty file was taken"
case $said in *"needs what is not here"*) not_run "${said#*needs what is not here: }" ;; esac

# Ten pictures a second for 2 s.
"$rye" capture --model "$model" --seed 3 --video head.mp4 --frames 20 --rate 10 --size 480 --samples 1 \
    --out truth --quiet
make() { ffmpeg -hide_banner -loglevel error -y "$@"; }

# takes NAME WIDTH HEIGHT: a capture of NAME.mp4, whose tracked pictures have this size.
takes() {
    "$rye" import video "$1.mp4" --every 1 --out "$1" > "$1.txt" 2>&1 || { cat "$1.txt"; fail "$1 is refused"; }
    grep -q "20 tracked pictures of $2 x $3 pixels" "$1.txt" || { cat "$1.txt"; fail "$1: expected $2 x $3"; }
    "$rye" info "$1" > "$1.info" || { cat "$1.info"; fail "$1 is no usable capture"; }
}
# refuses NAME WORDS
refuses() {
    if "$rye" import video "$1.mp4" --every 1 --out "$1" > "$1.txt" 2> "$1.err"; then fail "$1 is taken"; fi
    grep -q -- "$2" "$1.err" || { cat "$1.err"; fail "$1: no word of '$2'"; }
    [ "$(wc -l < "$1.err")" -eq 1 ] || { cat "$1.err"; fail "$1: more than a line"; }
    [ ! -e "$1" ] || fail "$1: a capture is there of what was refused"
}

takes head 480 480
# A phone held upright: stored on its side, with a flag that turns it.
make -i head.mp4 -vf "pad=640:480:80:0,transpose=2" -c:v libx264 side.mp4
make -display_rotation 90 -i side.mp4 -c copy turned.mp4 2> turned.err ||
    make -i side.mp4 -c copy -metadata:s:v:0 rotate=270 turned.mp4
takes turned 640 480
# Pictures at uneven times, as phones film in the dark.
make -i head.mp4 -vf "setpts='PTS+mod(N\,3)*0.02/TB'" -fps_mode vfr -c:v libx264 uneven.mp4
takes uneven 480 480
# 4K, by the codec that phones have.
make -i head.mp4 -vf "scale=2160:2160,pad=3840:2160:840:0" -c:v libx265 -x265-params log-level=error large.mp4
takes large 1920 1080
make -f lavfi -i "testsrc2=size=480x480:rate=10:duration=2" -c:v libx264 pattern.mp4
refuses pattern "20 without a face"
make -i head.mp4 -i head.mp4 -filter_complex hstack -c:v libx264 two.mp4
refuses two "20 with several"
make -i head.mp4 -frames:v 5 -c:v libx264 short.mp4
refuses short "expected 8 or more"
head -c 9000 head.mp4 > cut.mp4
refuses cut "ffmpeg reads no pictures of it"
make -f lavfi -i "sine=duration=2" -c:a aac sound.mp4
refuses sound "ffmpeg reads no pictures of it"
echo "videos of all kinds: taken or refused in a line"
