#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# appearance.sh RYE WORK: runs with eyes whose features are driven, with a shaded head, and with eyes
# that move in the head, as a user trains and shows them. Checks that results have the same bits for
# any number of threads and after an interruption, and that what does not fit is refused.
set -eu
rye=$1
work=$2
rm -rf "$work"
mkdir -p "$work"
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }
same() { cmp "$1" "$2" || fail "$1 and $2 differ"; }
refuses() {  # WORDS COMMAND...: fails with one line that holds the words
    words=$1
    shift
    if "$@" > out.txt 2> err.txt; then fail "accepted: $*"; fi
    grep -q -- "$words" err.txt || { cat out.txt err.txt; fail "no word of '$words' from: $*"; }
    [ "$(wc -l < err.txt)" -eq 1 ] || { cat err.txt; fail "more than a line from: $*"; }
}
has() { grep -q "$2" "$1" || fail "$1 has no $2"; }
has_not() { if grep -q "$2" "$1"; then fail "$1 has a $2"; fi; }

make() {  # OUT OPTIONS...
    out=$1
    shift
    "$rye" capture --out "$out" --size 32 --cameras 2 --frames 4 --test-frames 1 --apart-frames 0 \
        --samples 1 --quiet "$@"
}
make cap --eye-translation 3
"$rye" info cap > info.txt || { cat info.txt; fail "rye info finds errors in rye's own capture"; }
has cap/capture.json '"eye_translation_mm": 3'
make still
make still0 --eye-translation 0
diff -r still still0 > /dev/null || fail "a translation of 0 mm changes the capture"
has_not still/capture.json eye_translation
refuses "got 7.*eye translation \[mm\], expected 0 to 5" "$rye" capture --out never \
    --eye-translation 7
[ ! -e never ] || fail "a refused capture leaves a folder"

config() {  # FIELDS OF avatar: a small run
    cat << END
{"avatar": {$1 "feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 8, "image_size": 32, "pretrain_steps": 40, "fit_steps": 20},
 "gaussians": {"steps": 8, "mouth_points": 20, "panel_every": 8, "checkpoint_every": 4,
  "eyeball": {"points": 120}, "upsampler": {"capacity": 2}}}
END
}
config '' > plain.json
config '"eye_appearance": "driven",' > eyes.json
config '"shading": "head_pose",' > shading.json
config '"eye_appearance": "driven", "shading": "head_pose",' > both.json
train() {
    "$rye" train --preset tiny --quiet "$@" > log.txt 2>&1 || { cat log.txt; fail "train $*"; }
}
for name in plain eyes shading both; do
    train --capture cap --config $name.json --out $name --threads 1
done
train --capture cap --config both.json --out two --threads 2
same both/checkpoint.safetensors two/checkpoint.safetensors
has both/config.json '"eye_appearance": "driven"'
has both/config.json '"shading": "head_pose"'
for tensor in avatar.eyes.left_appearance_mlp avatar.shading.light; do
    has both/checkpoint.safetensors $tensor
    has_not plain/checkpoint.safetensors $tensor
done
has_not shading/checkpoint.safetensors appearance_mlp
has_not eyes/checkpoint.safetensors shading.light

# Killed once there is a checkpoint, and gone on with.
"$rye" train --preset tiny --quiet --capture cap --config both.json --out cut --threads 1 \
    > log.txt 2>&1 &
pid=$!
while [ ! -e cut/checkpoint.safetensors ] && kill -0 "$pid" 2> /dev/null; do sleep 0.05; done
kill -9 "$pid" 2> /dev/null || true
wait "$pid" 2> /dev/null || true
"$rye" train --out cut --resume --quiet --threads 1 > log.txt 2>&1
same both/checkpoint.safetensors cut/checkpoint.safetensors
refuses "field 'avatar.shading': got \"none\", expected \"head_pose\", as the run in both began" \
    "$rye" train --out both --resume --preset tiny --config eyes.json
refuses "field 'avatar.eye_appearance': got \"free\", expected \"driven\"" \
    "$rye" train --out both --resume --preset tiny --config shading.json
config '"shading": "sun",' > wrong.json
refuses "wrong.json: field 'avatar.shading': got \"sun\", expected \"none\" or \"head_pose\"" \
    "$rye" train --capture cap --preset tiny --config wrong.json --out never
[ ! -e never ] || fail "a refused run leaves a folder"

for name in plain eyes shading both; do
    "$rye" evaluate --run $name --split test --threads 2 > table.txt
    has table.txt "^Eyeball centres"
    "$rye" evaluate --run $name --split test --json > results.txt
    has results.txt '"mm_without_offset"'
    "$rye" redirect --run $name --gaze-left 5,10 --gaze-right -5,-10 --out look_$name.png
    "$rye" redirect --run $name --sweep --out sweep_$name.png > variant.txt
done
has variant.txt "^variant  *gaze (head pose, .*, head shading, eye appearance)"
for name in eyes shading both; do
    if cmp -s look_plain.png look_$name.png; then fail "$name draws what plain draws"; fi
done
"$rye" redirect --run both --sweep --effects gaze --out gaze.png
same sweep_both.png gaze.png
"$rye" info cap --effects --run both > variant.txt
has variant.txt "yes  head shading"
has variant.txt "within the bound"
"$rye" export --run both --ply head.ply
for name in plain both; do
    "$rye" export --run $name --out $name.avatar --full-precision > export.txt
    has export.txt "its pictures are the run's, bit for bit"
done
for tensor in avatar.eyes.left_appearance_mlp avatar.shading.light; do
    has both.avatar $tensor
    has_not plain.avatar $tensor
done
echo "driven eyes, shading and moving eyes: trained, drawn, exported, refused where they do not fit"
