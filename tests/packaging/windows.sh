#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# windows.sh SOURCE WORK: makes the archive of packaging/windows.sh and runs its rye.exe by wine: a
# capture, a training, pictures, measurements and files of a head, in a folder whose name has spaces
# and letters beyond ASCII; wrong words; a training that is killed and goes on. With the program of
# Linux for the same instructions it compares files. RYE of the environment names that program, and
# MADE a folder with the archive; otherwise they are built.
# Ends with 77, and a sentence, where a tool is missing.
set -eu
source=$1 work=$2
fail() { echo "FAILED: $*"; exit 1; }
mkdir -p "$work"
work=$(cd "$work" && pwd)
for tool in wine:wine unzip:unzip; do
    command -v "${tool%%:*}" > /dev/null || { echo "missing, by the name of its Debian package: ${tool##*:}"; exit 77; }
done
made=${MADE:-$work/out}
if [ -z "${MADE:-}" ]; then
    status=0
    WORK="$work/build" sh "$source/packaging/windows.sh" "$made" > "$work/made.txt" 2>&1 || status=$?
    [ $status = 0 ] || { tail -n 20 "$work/made.txt"; exit $status; }
    cat "$work/made.txt"
fi
linux=${RYE:-$work/linux/rye}
if [ -z "${RYE:-}" ]; then
    . "$source/cmake/steps.sh"
    (cd "$source" && configure "$work/linux" -DCMAKE_BUILD_TYPE=Release -DRYE_NATIVE=OFF -DCMAKE_CXX_FLAGS=-march=x86-64 \
        -DRYE_MERGE_UNITS=ON -DRYE_BUILD_TESTS=OFF -DRYE_BUILD_EXAMPLES=OFF -DRYE_BUILD_BENCHMARKS=OFF -DRYE_BUILD_C=OFF \
        -DRYE_INSTALL=OFF && cmake --build "$work/linux" --parallel "$jobs" --target rye_program) > "$work/linux.txt" 2>&1 ||
        { tail -n 20 "$work/linux.txt"; fail "the program of Linux"; }
fi

# ---- the archive ---------------------------------------------------------------------------------
rm -rf "$work/unpacked" "$work/run"
unzip -q "$made"/rye-*-windows-x86_64.zip -d "$work/unpacked"
cd "$work/unpacked"/rye-*
cmp LICENSE "$source/LICENSE" || fail "another licence"
[ "$(find licences -type f -size +0 | wc -l)" -ge 9 ] || fail "too few licences"
exe=$PWD/rye.exe
export WINEPREFIX="$work/wine" WINEDEBUG=-all DISPLAY=
here="$work/run/a head é 中"
mkdir -p "$here"
cd "$here"
wine "$exe" --version > version.txt 2> "$work/wine.txt" || { cat "$work/wine.txt"; fail "rye --version"; }
[ "$(cat version.txt)" = "$("$linux" --version)" ] || fail "another version"
rye() { wine "$exe" "$@" 2> "$work/errors.txt" || { tail -n 3 "$work/errors.txt"; fail "rye $1"; }; }
# refused CODE WORDS ARGUMENTS...: what a wrong command line ends with, and says
refused() {
    code=$1 words=$2
    shift 2
    status=0
    wine "$exe" "$@" > "$work/said.txt" 2>&1 || status=$?
    [ "$status" = "$code" ] || fail "rye $*: code $status, expected $code"
    grep -qF -e "$words" "$work/said.txt" || { cat "$work/said.txt"; fail "rye $*: expected the words: $words"; }
}

# ---- all of a head -------------------------------------------------------------------------------
small="--size 48 --cameras 3 --frames 4 --test-frames 2 --apart-frames 0 --samples 1"
# shellcheck disable=SC2086 # several words
rye capture --out "köpf 1" $small > said.txt
grep -qx 'köpf 1: 6 frames x 3 cameras, 48 x 48 pixels' said.txt || { cat said.txt; fail "what capture says"; }
# shellcheck disable=SC2086 # several words
"$linux" capture --out linux $small --quiet
rye info "köpf 1" > said.txt
grep -q 'köpf 1' said.txt || fail "rye info has another name"
cat > small.json << 'END'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 20, "image_size": 48, "pretrain_steps": 20},
 "gaussians": {"steps": 20, "checkpoint_every": 5, "mouth_points": 20, "eyeball": {"points": 120},
  "upsampler": {"capacity": 2}}}
END
train="--preset tiny --config small.json --quiet"
# shellcheck disable=SC2086 # several words
for threads in 1 2; do rye train --capture "köpf 1" --out "run $threads" --threads $threads $train; done
cmp "run 1/checkpoint.safetensors" "run 2/checkpoint.safetensors" || fail "two threads give other bits than one"
# shellcheck disable=SC2086 # several words
"$linux" train --capture "köpf 1" --out "run linux" $train
rye redirect --run "run 1" --sweep --out "sweep é.png" > said.txt
rye redirect --run "run 1" --idle 0.2 --out film.y4m > said.txt
rye redirect --run "run 1" --idle 0.2 --out - > pipe.y4m
cmp film.y4m pipe.y4m || fail "standard output changes bytes"
rye evaluate --run "run 1" --capture "köpf 1" --out measured > said.txt
rye export --run "run 1" --ply head.ply > said.txt
rye export --run "run 1" --out head.avatar > said.txt
rye info "köpf 1" --json > info.json
for file in "sweep é.png" film.y4m measured/results.json head.ply head.avatar info.json; do
    [ -s "$file" ] || fail "no $file"
done
if grep -lr "$(printf '\r')$" --include='*.json' --include='*.jsonl' .; then fail "line ends of Windows"; fi

# ---- beside the files of Linux -------------------------------------------------------------------
same() { if cmp -s "$1" "$2"; then echo "$3: the same bits as on Linux"; else echo "$3: other bits than on Linux"; fi; }
others=$(diff -rq linux "köpf 1" | grep -c . || true)
echo "capture: $others of $(find linux -type f | wc -l) files have other bits than on Linux"
same "run 1/checkpoint.safetensors" "run linux/checkpoint.safetensors" "checkpoint"
cmp "run 1/config.json" "run linux/config.json" || fail "another config.json"
# Each reads the other's run.
"$linux" evaluate --run "run 1" --capture "köpf 1" --out "measured linux" > said.txt
rye redirect --run "run linux" --out other.png > said.txt
same measured/results.json "measured linux/results.json" "results of evaluate"

# ---- what goes wrong -----------------------------------------------------------------------------
refused 2 "no_such' is no command" no_such
refused 1 "nirgends é" info "nirgends é"
refused 2 "--steps" train --capture "köpf 1" --out x --stps 3
refused 2 "exists already; --overwrite replaces it" capture --out "köpf 1"
refused 2 "/no" train --capture /no/such --out x
refused 2 "film.mp4: needs ffmpeg, which is not installed" capture --out x --video film.mp4 --size 32
[ ! -e x ] || fail "a refused command left a folder"
# A training that is killed, or stopped by Ctrl-C, goes on to the bits that it would have had.
# begin OUT: starts a training, and waits for its first checkpoint
begin() {
    # shellcheck disable=SC2086 # several words
    wine "$exe" train --capture "köpf 1" --out "$1" $train 2> "$work/errors.txt" &
    running=$!
    for _ in $(seq 600); do
        [ ! -e "$1/checkpoint.safetensors" ] || return 0
        sleep 0.1
    done
    fail "no checkpoint in a minute"
}
go_on() { # OUT WORDS
    rye train --capture "köpf 1" --out "$1" --resume --quiet
    cmp "run 1/checkpoint.safetensors" "$1/checkpoint.safetensors" || fail "a run $2 has other bits"
    [ -z "$(find "$1" -name '*.tmp-*')" ] || fail "a run $2 left temporary files"
}
begin killed
refused 2 "is in use by rye train, process" train --capture "köpf 1" --out killed --resume
kill -9 $running
wait $running 2> /dev/null || true
go_on killed "that was killed"
begin stopped
kill -INT $running
status=0
wait $running || status=$?
[ $status = 130 ] || fail "Ctrl-C: code $status, expected 130"
go_on stopped "that was stopped"
# What is half written does not have its name.
wine "$exe" capture --out half --size 256 --quiet 2> "$work/errors.txt" &
running=$!
sleep 3
kill -9 $running
wait $running 2> /dev/null || true
[ ! -e half ] || fail "a capture that was killed is there"
# shellcheck disable=SC2086 # several words
rye capture --out half $small --quiet
[ ! -e half.tmp ] || fail "what a killed capture left is still there"
# A command that starts others of itself.
cat > list.json << 'END'
{"title": "Two rows", "columns": ["head_psnr"],
 "rows": [{"name": "as it is"}, {"name": "no blank loss", "config": {"gaussians": {"weights": {"blank": 0}}}}]}
END
# shellcheck disable=SC2086 # several words
rye compare --list list.json --capture "köpf 1" --out compared --preset tiny --config small.json --seeds 1 --jobs 2 --quiet > said.txt
[ -s compared/list.csv ] || fail "rye compare wrote no table"
echo "rye.exe: a capture, trainings that end, are killed and stopped, pictures, measurements, a comparison"
