#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# device.sh RYE RYE_EMULATED WORK: `rye train` with stage 2 on a device, whose kernels RYE_EMULATED
# runs on the host: losses are those of the CPU, a stopped run goes on to the same bits, checkpoints
# are taken by either side, and what does not fit is refused before anything is written. Then
# pictures of these runs, on both sides.
set -eu
plain=$1
rye=$2
work=$3
rm -rf "$work"
mkdir -p "$work"
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }
same() { cmp "$1" "$2" || fail "$1 and $2 differ"; }
refuses() {
    words=$1
    shift
    if "$@" > out.txt 2> err.txt; then fail "accepted: $*"; fi
    grep -v "^rye: warning: " err.txt > error.txt || true
    grep -q -- "$words" error.txt || { cat out.txt err.txt; fail "no word of '$words' from: $*"; }
    [ "$(wc -l < error.txt)" -eq 1 ] || { cat err.txt; fail "more than a line from: $*"; }
}

"$rye" capture --out cap --size 48 --cameras 2 --frames 2 --test-frames 1 --apart-frames 1 \
    --samples 1 --quiet
cat > small.json << 'EOF'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.5, "subdivide": false},
 "mesh": {"steps": 8, "image_size": 24, "pretrain_steps": 30, "fit_steps": 5},
 "gaussians": {"steps": 6, "mouth_points": 10, "spacing": 0.3, "panel_every": 4, "checkpoint_every": 3,
  "augment": true, "planes": 3, "eyeball": {"points": 40}, "upsampler": {"capacity": 2},
  "weights": {"face_smooth": 1, "face_mirror": 0.5}}}
EOF
train() { "$rye" train --capture cap --preset tiny --config small.json "$@" > log.txt 2>&1; }

train --out device || { cat log.txt; fail "no training on the device"; }
grep -q "^stage 2 is trained on an emulated device: about .* of device memory: parameters" log.txt ||
    { cat log.txt; fail "nothing is said of the device's memory"; }
grep -q "^device memory held: .* GB (.*); waited .* s for panels and checkpoints$" log.txt ||
    fail "nothing is said of what was held and waited for"
train --out cpu --device cpu --quiet
# The last line of a log, as "name value" lines.
losses() { tail -n 1 "$1/log.jsonl" | tr ',{}' '\n\n\n' | tr -d '"' | tr ':' ' ' | grep -v '^checksum'; }
# compares DEVICE CPU: the last losses of two runs.
compares() {
    losses "$1" > device.txt
    losses "$2" > cpu.txt
    paste -d ' ' device.txt cpu.txt | awk '
        $1 != $3 { print "another field: " $0; bad = 1 }
        $1 == "loss" { ++seen }
        $2 + 0 == $2 && ($2 - $4 > 2e-3 * ($4 + 1) || $4 - $2 > 2e-3 * ($4 + 1)) {
            print "the device has " $1 " " $2 ", the CPU " $4; bad = 1
        }
        END { exit bad || seen != 1 }' || fail "losses of $1 and $2 differ"
}
compares device cpu
[ "$(ls device/panels)" = "$(ls cpu/panels)" ] || fail "panels differ in number"

# Killed in stage 2, then gone on with.
"$rye" train --capture cap --preset tiny --config small.json --quiet --out cut > log.txt 2>&1 &
pid=$!
while ! grep -q '"avatar"' cut/log.jsonl 2> /dev/null && [ ! -e cut/panels/step_0000004.png ] &&
    kill -0 "$pid" 2> /dev/null; do sleep 0.02; done
kill -9 "$pid" 2> /dev/null || true
wait "$pid" 2> /dev/null || true
"$rye" train --out cut --resume --quiet > log.txt
same device/checkpoint.safetensors cut/checkpoint.safetensors
"$rye" train --capture cap --preset tiny --config small.json --quiet --json --profile --out told > told.json
grep -q '"device": "an emulated device"' told.json && grep -q '"part": "steps on the device"' told.json ||
    { cat told.json; fail "--json does not tell the device"; }
# holds FILE: what was counted at the start of stage 2 is what is held at its end, to the byte.
holds() {
    tr -d '",' < "$1" | awk '$1 == "stated:" { stated = $2 } $1 == "held:" { held = $2 }
        END { exit !(held > 1e6 && stated == held) }' || { cat "$1"; fail "not what was counted is held"; }
}
holds told.json
same device/checkpoint.safetensors told/checkpoint.safetensors
# With a byte less than it needs, pictures stay in the host's memory: the same bits.
stated=$(sed -n 's/.*"stated": \([0-9]*\).*/\1/p' told.json)
train --out fetched --device-memory "$((stated - 1))"
grep -q " of .* pictures stay in the host's memory" log.txt || { cat log.txt; fail "no picture stays"; }
for file in checkpoint.safetensors log.jsonl; do same device/$file fetched/$file; done

# Asked to stop in stage 2, gone on with.
small="train --capture cap --preset tiny --config small.json --quiet"
begun() { # RUN: waits for the checkpoint that stage 2 begins with
    while [ ! -e "$1/checkpoint.safetensors" ] && kill -0 "$pid" 2> /dev/null; do sleep 0.02; done
}
# shellcheck disable=SC2086 # several words
"$rye" $small --out stopped > log.txt 2>&1 &
pid=$!
begun stopped
kill -TERM $pid 2> /dev/null || true
code=0
wait $pid || code=$?
[ $code = 143 ] && grep -q "^stopped; the checkpoint is saved" log.txt ||
    { cat log.txt; fail "code $code of a training that is asked to stop"; }
"$rye" train --out stopped --resume --quiet > log.txt
for file in checkpoint.safetensors log.jsonl; do same device/$file stopped/$file; done
[ "$(ls device/panels)" = "$(ls stopped/panels)" ] || fail "panels of a stopped run"
for panel in device/panels/*; do same "$panel" "stopped/panels/${panel##*/}"; done

# A checkpoint that cannot be written, which is made beside the steps, ends the training in a line.
# shellcheck disable=SC2086
"$rye" $small --out full > out.txt 2> err.txt &
pid=$!
begun full
# Halted meanwhile: a checkpoint of its own could come between the two commands.
kill -STOP $pid
mv full/checkpoint.safetensors kept
mkdir full/checkpoint.safetensors
kill -CONT $pid
code=0
wait $pid || code=$?
[ $code = 2 ] && [ "$(grep -vc '^rye: warning' err.txt)" -eq 1 ] &&
    grep -q "^rye train: full/checkpoint.safetensors" err.txt ||
    { cat err.txt; fail "code $code of a training whose checkpoint cannot be written"; }

# Either side goes on with the other's checkpoint.
"$plain" train --out cut --resume --device cpu --steps 8 --quiet > log.txt
"$rye" train --out cpu --resume --device cuda --steps 8 --quiet > log.txt
for run in cut cpu; do
    tail -n 1 $run/log.jsonl | grep -q '"step":8,' || fail "$run does not end at step 8"
done
"$plain" evaluate --run told --split test > log.txt

# By lines of sight, with kappa.
sed 's/^{"avatar"/{"gaze_axis": "visual", "avatar"/
     s/"gaussians": {/"gaussians": {"rates": {"kappa": 0.001}, /' small.json > sight.json
"$rye" train --capture cap --preset tiny --config sight.json --steps 2 --quiet --out sight > log.txt
grep -q "avatar.eyes.kappa" sight/checkpoint.safetensors || fail "no kappa in the checkpoint"

# Compared rows, two at once on the device, share stage 1.
echo '{"preset": "tiny", "captures": ["cap"], "seeds": [1], "rows": [{"name": "a"},
  {"name": "b", "config": {"gaussians": {"rates": {"opacity": 0}}}}]}' > rows.json
"$rye" compare --list rows.json --config small.json --steps 1 --device cuda --jobs 2 \
    --out table > log.txt 2>&1
grep -q "^2 runs, 2 of them to do, 2 at once; stage 1 is trained for 1$" log.txt ||
    { cat log.txt; fail "rows with a stage 1 of their own"; }
sed 's/"gaussians": {/"gaussians": {"rates": {"opacity": 0}, /' small.json > row.json
"$rye" train --capture cap --preset tiny --config row.json --steps 1 --quiet --out row > log.txt
same row/checkpoint.safetensors table/runs/cap/b/seed_1/checkpoint.safetensors
# The parts of an avatar's eyes, and light: trained on either side, gone on with on the other.
for part in '"gaze_mechanism": "feature_rotation"' '"gaze_mechanism": "condition"' \
    '"gaze_mechanism": "latent_rotation"' '"gaze_mechanism": "learned_quaternion"' \
    '"gaze_mechanism": "none"' '"eye_appearance": "driven", "shading": "head_pose"'; do
    sed "s/^{\"avatar\": {/{\"avatar\": {$part, /" small.json > part.json
    rm -rf part_device part_cpu
    "$rye" train --capture cap --preset tiny --config part.json --steps 3 --json --out part_device > part_told.json ||
        fail "no training of $part"
    grep -q '"device": "an emulated device"' part_told.json || fail "$part is trained on the CPU"
    holds part_told.json
    "$rye" train --capture cap --preset tiny --config part.json --steps 3 --device cpu --quiet --out part_cpu
    compares part_device part_cpu
    "$plain" train --out part_device --resume --device cpu --steps 4 --quiet > log.txt
    "$rye" train --out part_cpu --resume --device cuda --steps 4 --quiet > log.txt
    compares part_cpu part_device
    mkdir -p parts
    cp -r part_device "parts/$(ls parts | wc -l)"
done

RYE_EMULATED_BYTES=1000 refuses \
    "rye train: small.json: got settings that need about .*, expected at most the 0.000 GB that are free" \
    "$rye" train --capture cap --preset tiny --config small.json --out none
# Room that is gone when stage 2 begins: stage 1 is not lost.
RYE_EMULATED_LATER_BYTES=1000 refuses "less: got settings that need about .*, expected at most the .*; \
stage 1 is kept, and .rye train --begin less. with lower fields goes on from it" \
    "$rye" train --capture cap --preset tiny --config small.json --quiet --out less
sed 's/"mouth_points": 10/"mouth_points": 5/' small.json > lower.json
"$rye" train --capture cap --preset tiny --config lower.json --steps 1 --quiet --out lower \
    --begin less > log.txt
tail -n 1 lower/log.jsonl | grep -q '"step":1,' || fail "no end of a run that begins from a refused one"
grep -q '"mesh"' lower/log.jsonl || fail "no stage 1 in its log"
sed 's/"feature": 8/"feature": 129/' small.json > wide.json
refuses '--device: got cuda, but avatar.feature is 129, kernels have room for 128' \
    "$rye" train --capture cap --preset tiny --config wide.json --device cuda --out none
[ ! -e none ] || fail "a refused training wrote something"
"$rye" train --capture cap --preset tiny --config wide.json --steps 1 --out wide > log.txt 2>&1
grep -q '^stage 2 is trained on the CPU: avatar.feature is 129' log.txt ||
    { cat log.txt; fail "the CPU takes over without a word"; }
# Pictures: those of the CPU but for rounding, by every gaze mechanism, driven eyes and shading.
# drawn RUN [OPTION...]: a video by both sides; no byte of a picture differs by more than 1.
drawn() {
    "$rye" redirect --run "$1" --driving "$@" --out on_device.y4m --device cuda > log.txt
    grep -q "^pictures are drawn on an emulated device$" log.txt ||
        { cat log.txt; fail "nothing is said of where $1 is drawn"; }
    "$plain" redirect --run "$1" --driving "$@" --effects paper --out by_cpu.y4m --device cpu > log.txt
    [ "$(wc -c < on_device.y4m)" -eq "$(wc -c < by_cpu.y4m)" ] || fail "videos of $1 differ in size"
    # cmp prints bytes in octal.
    { cmp -l on_device.y4m by_cpu.y4m || true; } | awk '
        function decimal(o,  n, k) { for (k = 1; k <= length(o); ++k) n = 8 * n + substr(o, k, 1); return n }
        { gap = decimal($2) - decimal($3); if (gap > 1 || gap < -1) bad = 1; ++apart }
        END { exit bad || apart > 2000 }' || fail "pictures of $1 differ between device and CPU"
}
for run in told sight parts/*; do drawn "$run"; done
drawn told --eye 1,0,9 --size 47x33 # sides that super-resolution's blocks exceed
# Labels refined by either side, and by the device to the same bits.
for side in device again cpu; do
    wish=cuda
    [ $side = cpu ] && wish=cpu
    "$rye" refine told --capture cap --size 24 --steps 4 --expression active --device $wish --out refined_$side > log.txt
done
diff -r refined_device refined_again || fail "labels refined twice differ"
residuals() { tr -d '",' < "$1/refine.json" | awk '$1 == "residual_before:" || $1 == "residual:" || $1 == "noise:"'; }
residuals refined_device > device.txt
residuals refined_cpu > cpu.txt
paste -d ' ' device.txt cpu.txt | awk '
    $2 - $4 > 1e-3 * $4 || $4 - $2 > 1e-3 * $4 { print "the device has " $0; bad = 1 }
    END { exit bad || NR != 6 }' || fail "residuals of refined labels differ"
"$rye" evaluate --run told --out on_device > log.txt
"$plain" evaluate --run told --out by_cpu --threads 1 > log.txt
grep -q '"device": "an emulated device"' on_device/results.json || fail "no device in results.json"
grep -q '"device": "cpu"' by_cpu/results.json || fail "no CPU in results.json"
for side in on_device by_cpu; do
    tr -d ' ,"' < $side/results.json | tr ':' ' ' | grep -v -e "^device" -e "checksum " > $side.txt
done
paste -d ' ' on_device.txt by_cpu.txt | awk '
    NF == 4 && $2 + 0 == $2 && ($2 - $4 > 1e-2 || $4 - $2 > 1e-2) { print; bad = 1 }
    END { exit bad || NR < 50 }' || fail "results of device and CPU differ"
"$rye" render told --out picture.png > log.txt
grep -q "^pictures are drawn on an emulated device$" log.txt || fail "rye render is silent"
"$rye" evaluate --run wide --out wide_results > log.txt
grep -q "^pictures are drawn on the CPU: avatar.feature is 129, kernels have room for 128$" log.txt ||
    { cat log.txt; fail "the CPU draws without a word"; }
refuses '--device: got cuda, but avatar.feature is 129, kernels have room for 128' \
    "$rye" evaluate --run wide --device cuda --out none
"$rye" redirect --run told --effects gaze --out picture.png > log.txt
grep -q "^pictures are drawn on the CPU: --effects gaze leaves effects out" log.txt ||
    { cat log.txt; fail "effects are left out without a word"; }
refuses '--device: got cuda, but --effects gaze leaves effects out, and a device draws all' \
    "$rye" redirect --run told --effects gaze --out none.png --device cuda
if "$plain" redirect --run told --out none.png --device cuda > out.txt 2> err.txt; then
    [ -e none.png ] # a machine with a device
else
    grep -q '^rye redirect: --device: got cuda, but ' err.txt || { cat err.txt; fail "no word of --device"; }
fi

if "$plain" train --capture cap --out none --device cuda > out.txt 2> err.txt; then
    [ -e none ] # a machine with a device
else
    grep -q '^rye train: --device: got cuda, but ' err.txt || { cat err.txt; fail "no word of --device"; }
fi
echo "stage 2 on an emulated device: losses of the CPU, the same bits again, either's checkpoints, pictures"
