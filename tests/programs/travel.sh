#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# travel.sh RYE WORK: a run without its capture, at another path: the same pictures, own cameras,
# videos by another run and by a table; and what a run says that lacks its frames. ffmpeg, where it
# is, reads the videos.
set -eu
rye=$1
work=$2
rm -rf "$work"
mkdir -p "$work"
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }
same() { cmp "$1" "$2" || fail "$1 and $2 differ"; }
differ() { if cmp -s "$1" "$2"; then fail "$1 and $2 are the same"; fi; }
# refuses WORDS COMMAND...: it fails with code 2 and one line that holds the words.
refuses() {
    words=$1
    shift
    code=0
    "$@" > out.txt 2> err.txt || code=$?
    [ "$code" -eq 2 ] || fail "exit code $code from: $*"
    grep -q -- "$words" err.txt || { cat err.txt; fail "no word of '$words' from: $*"; }
    [ "$(wc -l < err.txt)" -eq 1 ] || { cat err.txt; fail "more than a line from: $*"; }
}

cat > small.json << 'END'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 12, "image_size": 32, "pretrain_steps": 40},
 "gaussians": {"steps": 12, "mouth_points": 20, "eyeball": {"points": 120},
  "upsampler": {"capacity": 2}}}
END
make() { # CAPTURE RUN SEED
    "$rye" capture --out "$1" --size 64 --cameras 3 --frames 4 --test-frames 1 --apart-frames 1 \
        --samples 2 --seed "$3" --quiet
    "$rye" train --capture "$1" --preset tiny --config small.json --quiet --out "$2" > log.txt
}
make cap run 1
make other_cap other 2
"$rye" redirect --run run --capture cap --gaze-left 5,10 --out look.png
"$rye" redirect --run run --capture cap --sweep --out sweep.png > sweep.txt
"$rye" export --run run --capture cap --ply head.ply > export.txt

# ---- elsewhere, without the capture --------------------------------------------------------------
mkdir -p "far away/disk"
mv run "far away/disk/moved"
mv cap kept_cap
run="far away/disk/moved"
"$rye" redirect --run "$run" --gaze-left 5,10 --out look2.png
"$rye" redirect --run "$run" --sweep --out sweep2.png > sweep.txt
"$rye" export --run "$run" --ply head2.ply > export.txt
same look.png look2.png
same sweep.png sweep2.png
same head.ply head2.ply
"$rye" redirect --run "$run" --out plain.png
"$rye" redirect --run "$run" --eye 3,1,12 --fov 12 --size 61x47 --out own.png 2> notes.txt
[ ! -s notes.txt ] || { cat notes.txt; fail "the head is not in view of an own camera"; }
"$rye" redirect --run "$run" --eye 3,1,12 --look-at 0,0,500 --out away.png 2> notes.txt
grep -q "outside of 1 of 1" notes.txt || fail "no note that the head is out of view"
"$rye" render "$run" --out rendered.png > render.txt
same plain.png rendered.png
"$rye" render "$run" --eye 3,1,12 --fov 12 --size 61x47 --out rendered.png > render.txt
same own.png rendered.png

# ---- cameras of a file ---------------------------------------------------------------------------
cat > path.json << 'END'
{"look_at": [0, 0, 0], "up": [0, 1, 0], "fov": 16, "size": [61, 47],
 "cameras": [{"eye": [-4, 0, 12]}, {"eye": [0, 0, 12]}, {"eye": [4, 0, 12]}]}
END
cat > transforms.json << 'END'
{"w": 61, "h": 47, "fl_x": 167.2, "frames": [{"transform_matrix":
  [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 12], [0, 0, 0, 1]]}]}
END
"$rye" redirect --run "$run" --cameras path.json --out turn.apng > video.txt
grep -q "3 pictures of 61 x 47" video.txt || fail "a path of three cameras is no video of three"
"$rye" redirect --run "$run" --cameras path.json --view 1 --out view.png
"$rye" redirect --run "$run" --cameras path.json --out turn > video.txt
differ turn/frame_0000.png turn/frame_0001.png
"$rye" redirect --run "$run" --cameras transforms.json --out nerf.png
refuses "3 cameras" "$rye" redirect --run "$run" --cameras path.json --out never.png
refuses "below 3" "$rye" redirect --run "$run" --cameras path.json --view 3 --out never.png
refuses "holds pictures already" "$rye" redirect --run "$run" --cameras path.json --out turn

# ---- driven by others ----------------------------------------------------------------------------
"$rye" redirect --run "$run" --driving other --out driven > video.txt
grep -q "6 pictures of 64 x 64" video.txt || { cat video.txt; fail "another run has six frames"; }
"$rye" redirect --run "$run" --driving other_cap --out by_capture > video.txt
for picture in driven/*.png; do same "$picture" "by_capture/$(basename "$picture")"; done
"$rye" redirect --run "$run" --driving other --pose relative --range 1:3 --out driven.apng > video.txt
grep -q "3 pictures" video.txt || fail "--range 1:3 is not three pictures"
refuses "within 0:5" "$rye" redirect --run "$run" --driving other --range 1:6 --out never.apng
"$rye" redirect --run "$run" --driving other --fps 30000/1001 --out - > driven.y4m 2> notes.txt
header=$(head -n 1 driven.y4m)
[ "$header" = "YUV4MPEG2 W64 H64 F30000:1001 Ip A1:1 C444 XCOLORRANGE=LIMITED" ] ||
    fail "the stream begins with: $header"
size=$((${#header} + 1 + 6 * (6 + 3 * 64 * 64)))
[ "$(wc -c < driven.y4m)" -eq $size ] || fail "the stream has not $size bytes"
printf 'frame\nonly\n' > still.csv
"$rye" redirect --run "$run" --driving still.csv --out still > video.txt
same plain.png still/frame_0000.png
"$rye" drivers --run "$run" --out drivers.csv > drivers.txt
[ "$(wc -l < drivers.csv)" -eq 7 ] || fail "rye drivers does not write a line a frame"
"$rye" redirect --run "$run" --driving drivers.csv --out by_table > video.txt
"$rye" redirect --run "$run" --driving "$run" --out by_run > video.txt
printf 'gaze_left_pitch,gaze_left_yaw\n5,10\n-5,-10\n' > gaze.csv
"$rye" redirect --run "$run" --driving gaze.csv --out gazes.y4m > video.txt
printf 'gaze_left_pitch,gaze_left_yaw\n5,10\n-5,ten\n' > gaze.csv
refuses "gaze.csv: line 3: column 'gaze_left_yaw': got 'ten'" \
    "$rye" redirect --run "$run" --driving gaze.csv --out never.apng
# Eyes alone, by OpenXR's structs: the expression stays.
printf '{"gaze":[{"gazePose":{"orientation":{"x":0,"y":0,"z":0,"w":1}}},{"gazePose":{"orientation":{"x":0,"y":0,"z":0,"w":1}}}]}' > eyes.json
"$rye" drivers --run "$run" --driving eyes.json --out eyes.csv > /dev/null 2> said.txt
grep -q "$(sed -n 2p eyes.csv | cut -d, -f2-20)" drivers.csv || fail "eyes alone changed the expression"
refuses "small.json: has neither faceBlendshapes" "$rye" redirect --run "$run" --driving small.json --out never.apng
refuses "CSV\|.csv" "$rye" redirect --run "$run" --driving video.txt --out never.apng
refuses "as many of both" "$rye" redirect --run "$run" --driving other --cameras path.json \
    --out never.apng
[ ! -e never.apng ] && [ ! -e never.png ] || fail "a refused command wrote a file"

# ---- ffmpeg reads them ---------------------------------------------------------------------------
# least_db DECIBELS VIDEO PATTERN: each picture of the video against those of a folder.
least_db() {
    ffmpeg -v info -i "$2" -start_number 0 -i "$3" -lavfi \
        "[0:v]scale=in_color_matrix=bt601,format=gbrp,settb=1/25,setpts=N[a];
         [1:v]format=gbrp,settb=1/25,setpts=N[b];[a][b]psnr" \
        -f null - 2> ffmpeg.txt || { cat ffmpeg.txt; fail "ffmpeg cannot read $2"; }
    found=$(sed -n 's/.*PSNR.* min:\([^ ]*\).*/\1/p' ffmpeg.txt)
    echo "$2: $(tr '\r' '\n' < ffmpeg.txt | sed -n 's/^frame= *\([0-9]*\).*/\1/p' | tail -n 1) pictures by ffmpeg, at least $found dB"
    [ "$found" = inf ] || awk "BEGIN { exit !($found >= $1) }" || fail "$2 differs from $3"
}
if command -v ffmpeg > /dev/null 2>&1; then
    least_db 45 driven.y4m driven/frame_%04d.png
    least_db 999 turn.apng turn/frame_%04d.png
    least_db 55 by_table/frame_%04d.png by_run/frame_%04d.png
else
    echo "not run: videos are not read by ffmpeg, which is not installed"
fi

# ---- a run without its frames, or with another's --------------------------------------------------
mv "$run/frames.safetensors" frames.kept
refuses "frames.safetensors.*--capture.*--resume" "$rye" redirect --run "$run" --out never.png
"$rye" redirect --run "$run" --capture kept_cap --gaze-left 5,10 --out look3.png
same look.png look3.png
refuses "name its folder by --capture" "$rye" redirect --run "$run" --compare --out never.png
refuses "name its folder by --capture" "$rye" evaluate --run "$run"
cp other/frames.safetensors "$run/frames.safetensors"
refuses "of another run" "$rye" redirect --run "$run" --out never.png
"$rye" train --out "$run" --capture kept_cap --resume --quiet > log.txt
same "$run/frames.safetensors" frames.kept
"$rye" redirect --run "$run" --gaze-left 5,10 --out look4.png
same look.png look4.png
"$rye" evaluate --run "$run" --capture kept_cap --json > results.txt
same results.txt "$run/results.json"
"$rye" info kept_cap --effects --json > info.txt
grep -q '"called": true' info.txt || { cat info.txt; fail "no effect in --effects --json"; }
"$rye" train --capture kept_cap --preset tiny --config small.json --steps 1000000 --quiet \
    --out stopped > log.txt &
pid=$!
while [ ! -e stopped/checkpoint.safetensors ] && kill -0 $pid 2> /dev/null; do sleep 0.05; done
kill -TERM $pid
code=0
wait $pid || code=$?
[ $code -eq 143 ] || fail "a stopped training ends with $code, expected 128 and the signal's number"
"$rye" info kept_cap --json > info.txt
grep -q '"verdict": "usable"' info.txt || { cat info.txt; fail "no verdict in --json"; }
echo "1 passed, 0 failed"
