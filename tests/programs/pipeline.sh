#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# pipeline.sh RYE CORRUPT WORK: the whole job in small, as a user runs it, and what goes wrong in it.
# Checks that results have the same bits for any number of threads and after an interruption, and
# that bad input gives one sentence, a code other than 0, and leaves what was there.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
rye=$1
corrupt=$2
work=$3
rm -rf "$work"
mkdir -p "$work"
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }
same() { cmp "$1" "$2" || fail "$1 and $2 differ"; }

# refuses WORDS COMMAND...: the command must fail with one line, beside warnings, that holds the
# words.
refuses() {
    words=$1
    shift
    if "$@" > out.txt 2> err.txt; then fail "accepted: $*"; fi
    grep -q -- "$words" err.txt || { cat out.txt err.txt; fail "no word of '$words' from: $*"; }
    [ "$(grep -cv '^rye: warning: ' err.txt)" -eq 1 ] || { cat err.txt; fail "more than a line from: $*"; }
}

"$rye" capture --out cap --size 64 --cameras 4 --frames 4 --test-frames 1 --apart-frames 1 \
    --samples 2 --quiet
"$rye" info cap > info.txt || { cat info.txt; fail "rye info finds errors in rye's own capture"; }

cat > small.json << 'EOF'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 12, "image_size": 32, "pretrain_steps": 40},
 "gaussians": {"steps": 12, "mouth_points": 20, "panel_every": 6, "checkpoint_every": 5,
  "augment": true, "eyeball": {"points": 120}, "upsampler": {"capacity": 2}}}
EOF
train() { "$rye" train --capture cap --preset tiny --config small.json --quiet "$@" > log.txt; }

train --out one --threads 1
train --out two --threads 2
same one/checkpoint.safetensors two/checkpoint.safetensors
for panel in one/panels/*.png; do same "$panel" "two/panels/$(basename "$panel")"; done

# Killed without a word once there is a checkpoint, then gone on with.
"$rye" train --capture cap --preset tiny --config small.json --quiet --out cut --threads 2 > log.txt &
pid=$!
while [ ! -e cut/checkpoint.safetensors ] && kill -0 "$pid" 2> /dev/null; do sleep 0.05; done
kill -9 "$pid" 2> /dev/null || true
wait "$pid" 2> /dev/null || true
"$rye" train --out cut --threads 1 --resume --quiet > log.txt
same one/checkpoint.safetensors cut/checkpoint.safetensors
"$rye" evaluate --run one --split test > table_one.txt
"$rye" evaluate --run cut --split test > table_cut.txt
same one/results.json cut/results.json
same one/per_view.json cut/per_view.json

"$rye" redirect --run one --gaze-left 5,10 --gaze-right -5,-10 --out look.png
"$rye" redirect --run two --gaze-left 5,10 --gaze-right -5,-10 --out look2.png --threads 1
same look.png look2.png
"$rye" redirect --run one --sweep --out sweep.png > variant.txt
grep -q "^variant .*gaze (" variant.txt || { cat variant.txt; fail "a sweep of gazes is not drawn by gaze"; }
"$rye" redirect --run one --sweep --effects paper --out all.png > variant.txt
grep -q "^variant .*paper (" variant.txt || { cat variant.txt; fail "--effects paper is not obeyed"; }
"$rye" info cap --effects --run one > variant.txt
grep -q "they differ .*, within the bound" variant.txt || { cat variant.txt; fail "another picture"; }
"$rye" info cap --effects=still --run one > variant.txt
grep -q "^variant .*still (" variant.txt || { cat variant.txt; fail "--effects=still is not obeyed"; }

# By lines of sight the avatar learns a kappa, which its checkpoint and configuration tell.
sed 's/^{"avatar"/{"gaze_axis": "visual", "avatar"/
     s/"gaussians": {/"gaussians": {"rates": {"kappa": 0.001}, /' small.json > sight.json
for threads in 1 2; do
    "$rye" train --capture cap --preset tiny --config sight.json --quiet --out sight$threads \
        --threads $threads > log.txt
done
same sight1/checkpoint.safetensors sight2/checkpoint.safetensors
"$rye" train --capture cap --preset tiny --config small.json --device cpu --json \
    --profile --out told > told.json
grep -q '"done": true' told.json && grep -q '"part": "render"' told.json ||
    { cat told.json; fail "--json does not print what was done"; }
grep -q '"gaze_axis": "visual"' sight1/config.json || fail "config.json does not tell the gaze axis"
grep -q "avatar.eyes.kappa" sight1/checkpoint.safetensors || fail "no kappa in the checkpoint"
grep -q "avatar.eyes.kappa" one/checkpoint.safetensors && fail "a kappa that nobody asked for"
"$rye" redirect --run sight1 --gaze-left 5,10 --out sight.png
"$rye" evaluate --run sight1 --split test > table_sight.txt
"$rye" info cap --effects --run sight1 > variant.txt
grep -q "yes  kappa" variant.txt || { cat variant.txt; fail "its kappa is not called for"; }

# Labels by the run's pictures: a capture that the program takes, with other labels in training frames.
for threads in 1 2; do
    "$rye" refine one --capture cap --out refined$threads --steps 2 --expression none \
        --threads $threads > refined.txt
    "$rye" info refined$threads > info.txt || { cat info.txt; fail "rye refine writes no capture"; }
done
grep -q "^10 unknowns a frame" refined.txt || { cat refined.txt; fail "rye refine says little"; }
for frame in cap/params/*; do
    same "refined1/${frame#cap/}/params.npz" "refined2/${frame#cap/}/params.npz"
    same "refined1/${frame#cap/}/gaze.npz" "refined2/${frame#cap/}/gaze.npz"
done
refuses "exists already" "$rye" refine one --capture cap --out refined1

# Without a run by each other and by irises: nothing is said by four frames, eight are enough.
"$rye" refine --capture cap --out same > refined.txt
grep -q "4 training frames say too little" refined.txt || { cat refined.txt; fail "four frames judge"; }
refuses "--capture is missing" "$rye" refine --out none
refuses "frames all needs a run" "$rye" refine --capture cap --out none --frames all
"$rye" capture --out eight --size 64 --cameras 4 --frames 8 --test-frames 1 --apart-frames 0 \
    --samples 1 --seed 3 --quiet
"$rye" flaw --capture eight --out turned --seed 1 --pose 2,3 > log.txt
for threads in 1 2; do
    "$rye" refine --capture turned --out straight$threads --threads $threads > refined.txt
done
grep -q "^head poses: .* deg off, aligned" refined.txt || { cat refined.txt; fail "poses stay wrong"; }
for frame in turned/params/*; do
    same "straight1/${frame#turned/}/params.npz" "straight2/${frame#turned/}/params.npz"
done
"$rye" info straight1 > info.txt
grep -q "head poses: .* deg off, aligned" info.txt && { cat info.txt; fail "refined poses are off"; }
sed 's/^{"avatar"/{"correct_labels": true, "correct_colours": true, "correct_cameras": true, "avatar"/' \
    small.json > corrected.json
"$rye" train --capture turned --preset tiny --config corrected.json --out corrected > log.txt
grep -q "^cameras: too few irises are seen" log.txt || { cat log.txt; fail "no word of cameras"; }
[ ! -e corrected/cameras.json ] || fail "cameras that were not judged are corrected"
grep -q "^stage 2 goes on refining the head poses" log.txt || { cat log.txt; fail "poses are left"; }
head -n 1 corrected/log.jsonl | grep -q '"stage":"labels"' || fail "the log does not tell of labels"
# A run's poses take along the landmarks that agree with the labels' poses, and no others.
for points in eight turned; do
    "$rye" refine corrected --capture $points --out by_run --size 32 --steps 1 > refined.txt
    if [ $points = turned ]; then
        grep -q "^landmarks and eyeballs stay where they were measured: by them head poses are" refined.txt &&
            same turned/params/0001/lmk_3d.npy by_run/params/0001/lmk_3d.npy
    else
        ! grep -q "stay where they were" refined.txt &&
            ! cmp -s eight/params/0001/lmk_3d.npy by_run/params/0001/lmk_3d.npy
    fi || { cat refined.txt; fail "landmarks of $points"; }
    rm -r by_run
done
grep -q '"centre_corrections": true' corrected/config.json || fail "config.json does not tell"

"$rye" export --run one --ply head.ply
"$rye" export --run one --ply canonical.ply --canonical --sh 3
"$rye" render head.ply --eye 0,0,-10 --target 0,0,0 --up 0,-1,0 --fov 18 --size 64x64 \
    --background 1,1,1 --out render.png
"$rye" render head.ply --eye 0,0,-10 --target 0,0,0 --up 0,-1,0 --fov 18 --size 64x64 \
    --max-error 1/255 --out chosen.png | grep -q "^accuracy" || fail "no word of the chosen accuracy"
# The formats of viewers: written by the name's extension, two of them read back.
for kind in splat spz glb usda; do
    "$rye" export --run one --out head.$kind > export_$kind.txt
done
"$rye" export --run one --spz-version 4 --out head4.spz > export_spz4.txt
grep -q "^rounded: position by at most" export_spz.txt || fail "no word of an SPZ's rounding"
for kind in splat spz glb; do
    "$rye" render head.$kind --eye 0,0,-10 --target 0,0,0 --fov 18 --size 64x64 --out $kind.png
done
# Version 4 holds the same numbers; a program without libzstd names the one that converts it.
if "$rye" render head4.spz --eye 0,0,-10 --target 0,0,0 --fov 18 --size 64x64 --out spz4.png 2> spz4.txt; then
    cmp spz.png spz4.png || fail "SPZ 4 is drawn otherwise than SPZ 3"
    grep -q "^rounded: position by at most" export_spz4.txt || fail "no word of an SPZ 4's rounding"
else
    grep -q "built without zstd; convert it with" spz4.txt || fail "SPZ 4 is refused without its reason"
fi
"$rye" export --run one --gaze-sweep 10,3 --out sweep.usda
grep -q "positions.timeSamples = {" sweep.usda || fail "no samples of a sweep of the gaze"
grep -q "endTimeCode = 2" sweep.usda || fail "a sweep of three gazes has no third time code"
"$rye" info --effects head.spz | grep -q "^scene" || fail "rye info reads no SPZ"
refuses "ends in .ply, .splat, .spz, .glb, .usda or .avatar" "$rye" export --run one --out head.txt
refuses "axes of its own" "$rye" export --run one --axes world --out never.spz
refuses "has no harmonics" "$rye" export --run one --sh 3 --out never.splat
refuses "OpenUSD, which is not read" "$rye" render head.usda --eye 0,0,-10 --target 0,0,0 --out never.png
refuses "is no .spz" "$rye" export --run one --spz-version 4 --out never.ply
refuses "holds one moment" "$rye" export --run one --gaze-sweep 10,3 --out never.ply
refuses "expected RADIUS,FRAMES" "$rye" export --run one --gaze-sweep 10,2.5 --out never.usda
# Bases beside a splat file, read and applied without rye; sight1 has a kappa.
if command -v node > /dev/null; then
    for run in one sight1; do node "$here/bases.mjs" "$rye" $run; done
else
    echo "not run: bases of splats, for there is no node"
fi
refuses "ends in .safetensors" "$rye" export --run one --out never.ply --bases never.bases
refuses "moves by itself" "$rye" export --run one --out never.avatar --bases never.safetensors
refuses "all Gaussians of one moment" "$rye" export --run one --stream eyes --out never.ply --bases never.safetensors
refuses "column 1 is 'no-such-name'" "$rye" export --run one --expression no-such-name=1 --out never.ply
refuses "expected NAME=VALUE" "$rye" export --run one --expression expression_0 --out never.ply
refuses "got 'wide', expected a number" "$rye" export --run one --expression expression_0=wide --out never.ply
# Through the camera of a photograph, whose lens bends or does not.
lens() {
    cat << EOF
{"w": 64, "h": 64, "fl_x": 190, $1 "frames": [{"file_path": "a.png", "transform_matrix":
  [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, -10], [0, 0, 0, 1]]}]}
EOF
}
lens '"k1": 0,' > straight.json
lens '"k1": -0.9, "k2": 0.1,' > bent.json
lens '"camera_model": "OPENCV_FISHEYE",' > fisheye.json
"$rye" render head.ply --cameras straight.json --out straight.png > straight.txt
"$rye" render head.ply --cameras bent.json --view 0 --out bent.png > bent.txt
grep -q "lens that bends" bent.txt || fail "rye render does not say that the lens bends"
if cmp -s straight.png bent.png; then fail "a lens changes nothing"; fi
refuses "OPENCV_FISHEYE" "$rye" render head.ply --cameras fisheye.json --out never.png
refuses "view" "$rye" render head.ply --cameras bent.json --view 1 --out never.png
refuses "max-error" "$rye" render head.ply --cameras bent.json --max-error 0.01 --out never.png
refuses "eye" "$rye" render head.ply --out never.png
refuses "max-error" "$rye" render head.ply --eye 0,0,-10 --target 0,0,0 --max-error nothing --out x.png

# Bad input. The run stays as it is through all of it.
cat one/checkpoint.safetensors one/config.json one/log.jsonl one/results.json > before.bin
refuses "holds a run" "$rye" train --capture cap --out one --config small.json
refuses "nowhere" "$rye" train --capture nowhere --out x1
refuses "gaze_axis" "$rye" train --out one --resume --config sight.json
refuses "checkpoint" "$rye" redirect --run nowhere --out x.png
refuses "at most 70" "$rye" redirect --run one --gaze-left 80,0 --gaze-right 0,0 --out x.png
refuses "got 'smile'" "$rye" redirect --run one --sweep --effects smile --out x.png
refuses "frame" "$rye" redirect --run one --frame 999 --out x.png
refuses "--size: a picture of 16000 x 16000 pixels would take 3840000000 bytes of memory, expected at most the limit of 2147483648" \
    "$rye" redirect --run one --gaze-left 5,10 --gaze-right -5,-10 --size 16000x16000 --out x.png
echo '{"gaussians": {"rates": {"position": "fast"}}}' > bad.json
refuses "gaussians.rates.position" "$rye" train --capture cap --out x2 --config bad.json
echo '{"gausians": {}}' > bad.json
refuses "gausians" "$rye" train --capture cap --out x2 --config bad.json
cp one/checkpoint.safetensors kept.safetensors
head -c 5000 kept.safetensors > one/checkpoint.safetensors
refuses "checkpoint.safetensors" "$rye" evaluate --run one
cp kept.safetensors one/checkpoint.safetensors
head -c 400 head.ply > cut.ply
refuses "cut.ply" "$rye" render cut.ply --eye 0,0,-10 --target 0,0,0 --out never.png
[ ! -e never.png ] || fail "a picture of a broken file"
break_capture() { rm -rf broken; cp -r cap broken; }
first=$(ls cap/params | head -n 1)
image=$(find cap/images/"$first" -name 'image_0*' ! -name '*lowres*' | sort | head -n 1)
break_capture; rm broken/params/"$first"/gaze.npz
refuses "gaze.npz" "$rye" train --capture broken --out x3 --config small.json
break_capture; head -c 100 cap/params/"$first"/params.npz > broken/params/"$first"/params.npz
refuses "params.npz" "$rye" train --capture broken --out x3 --config small.json
break_capture; : > broken/"${image#cap/}"
refuses "$(basename "$image")" "$rye" train --capture broken --out x3 --config small.json
camera=$(ls cap/cameras/"$first" | head -n 1)
break_capture; "$corrupt" nan broken/cameras/"$first/$camera" intrinsic
refuses "$camera.*intrinsic" "$rye" train --capture broken --out x3 --config small.json
break_capture; "$corrupt" infinite broken/cameras/"$first/$camera" extrinsic
refuses "$camera.*extrinsic" "$rye" train --capture broken --out x3 --config small.json
break_capture; "$corrupt" flat broken/cameras/"$first/$camera" extrinsic
refuses "$camera.*extrinsic" "$rye" train --capture broken --out x3 --config small.json
break_capture; "$corrupt" nan broken/params/"$first"/params.npz pose
refuses "params.npz.*pose" "$rye" train --capture broken --out x3 --config small.json
break_capture; tr -d '\n' < cap/capture.json | sed 's/"test_frames": *\[[^]]*\]/"test_frames": []/' \
    > broken/capture.json
refuses "test" "$rye" evaluate --run one --capture broken --split test
break_capture; tr -d '\n' < cap/capture.json | sed 's/"train_frames": *\[[^]]*\]/"train_frames": []/' \
    > broken/capture.json
refuses "train_frames" "$rye" train --capture broken --out x3 --config small.json
[ ! -e x3 ] || fail "a run was begun from a broken capture"
cat one/checkpoint.safetensors one/config.json one/log.jsonl one/results.json > after.bin
same before.bin after.bin
echo "1 passed, 0 failed"
