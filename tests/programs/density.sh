#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# density.sh RYE RYE_EMULATED WORK: `rye train` with gaussians.density, on the CPU and with stage 2 on
# a device, whose kernels RYE_EMULATED runs on the host: stopped and killed runs go on to the same
# bits, whether a change of the face is before or behind their checkpoint; losses of the device are
# the CPU's; each kind of avatar, and either side with the other's checkpoint.
set -eu
plain=$1
emulated=$2
work=$3
rm -rf "$work"
mkdir -p "$work"
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }
same() { cmp "$1" "$2" || fail "$1 and $2 differ"; }

"$plain" capture --out cap --size 32 --cameras 2 --frames 2 --test-frames 1 --apart-frames 1 \
    --samples 1 --quiet
cat > small.json << 'EOF'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.5, "subdivide": false},
 "mesh": {"steps": 8, "image_size": 24, "pretrain_steps": 30, "fit_steps": 5},
 "gaussians": {"steps": 6, "mouth_points": 10, "spacing": 0, "panel_every": 4,
  "checkpoint_every": 3, "augment": true, "planes": 3, "eyeball": {"points": 40},
  "upsampler": {"capacity": 2},
  "density": {"every": 2, "first": 1, "last": 5, "grow": 0.2, "most": 100000, "prune": 0.2},
  "rates": {"opacity": 0.2}}}
EOF
# begun RUN PROGRAM: a training that is under way, until its log tells of a change.
begun() {
    "$2" train --capture cap --preset tiny --config small.json --quiet --out "$1" > log.txt 2>&1 &
    pid=$!
    while ! grep -q '"grown"' "$1/log.jsonl" 2> /dev/null && kill -0 $pid 2> /dev/null; do
        sleep 0.01
    done
}
# gone_on RUN PROGRAM LIKE: the run to its end, whose files are those of LIKE.
gone_on() {
    wait $pid 2> /dev/null || true
    "$2" train --out "$1" --resume --quiet > log.txt 2>&1
    for file in checkpoint.safetensors log.jsonl panels/step_0000004.png; do
        same "$3/$file" "$1/$file"
    done
}
for side in cpu device; do
    program=$plain
    [ $side = cpu ] || program=$emulated
    "$program" train --capture cap --preset tiny --config small.json --out $side > log.txt 2>&1 ||
        { cat log.txt; fail "no training on the side $side"; }
    [ "$(grep -c '"stage":"avatar","step":[24],"grown":[1-9][0-9]*,"pruned":[0-9]*,"face":' \
        $side/log.jsonl)" -eq 2 ] || { cat $side/log.jsonl; fail "$side: no two changes in the log"; }
    grep -q '"pruned":[1-9]' $side/log.jsonl || fail "$side: none is pruned"
    grep -q "^the face has [0-9]* Gaussians: [0-9]* were split and [0-9]* were pruned, in 2 changes of density$" \
        log.txt || { cat log.txt; fail "$side: nothing is said of the changes"; }
    grep -q "about .* Gaussians, at most .* by gaussians.density, at least " log.txt ||
        fail "$side: nothing is said of the most Gaussians"
    begun stopped_$side "$program" # its checkpoint has the change
    kill -TERM $pid 2> /dev/null || true
    gone_on stopped_$side "$program" $side
    begun killed_$side "$program" # its checkpoint is of an earlier step
    kill -9 $pid 2> /dev/null || true
    gone_on killed_$side "$program" $side
done
"$plain" train --capture cap --preset tiny --config small.json --threads 1 --quiet --out alone 2> err.txt
same cpu/checkpoint.safetensors alone/checkpoint.safetensors

# The device's losses are the CPU's, and it says at least what memory it holds.
losses() { tail -n 1 "$1/log.jsonl" | tr ',{}' '\n\n\n' | tr -d '"' | tr ':' ' ' | grep -v '^checksum'; }
losses device > device.txt
losses cpu > cpu.txt
paste -d ' ' device.txt cpu.txt | awk '
    $1 != $3 { print "another field: " $0; bad = 1 }
    $2 + 0 == $2 && ($2 - $4 > 2e-3 * ($4 + 1) || $4 - $2 > 2e-3 * ($4 + 1)) { print; bad = 1 }
    END { exit bad }' || fail "losses of device and CPU differ"
[ "$(grep -c '"grown"' device/log.jsonl)" -eq "$(grep -c '"grown"' cpu/log.jsonl)" ]
"$emulated" train --capture cap --preset tiny --config small.json --quiet --json --out told > told.json \
    2> err.txt
tr -d '",' < told.json | awk '$1 == "stated:" { stated = $2 } $1 == "held:" { held = $2 }
    END { exit !(held > 1e6 && stated > 0.95 * held && stated < 1.3 * held) }' ||
    { cat told.json; fail "what was stated is not what was held"; }

# Each kind of avatar; either side goes on with the other's checkpoint.
for part in '"gaze_axis": "visual", "avatar": {' \
    '"avatar": {"gaze_mechanism": "condition", "shading": "head_pose", ' \
    '"avatar": {"eye_appearance": "driven", "shading": "head_pose", '; do
    sed "s/^{\"avatar\": {/{$part/; s/\"steps\": 6/\"steps\": 3/" small.json > part.json
    rm -rf part
    "$emulated" train --capture cap --preset tiny --config part.json --quiet --out part > log.txt 2>&1 ||
        { cat log.txt; fail "no training of $part"; }
    grep -q '"step":2,"grown":[1-9]' part/log.jsonl || fail "no change of density with $part"
    "$plain" train --out part --resume --steps 5 --quiet --device cpu > log.txt 2>&1
    "$emulated" train --out part --resume --steps 6 --quiet --device cuda > log.txt 2>&1
    [ "$(grep -c '"grown"' part/log.jsonl)" -eq 2 ] || { cat part/log.jsonl; fail "changes of $part"; }
    "$plain" redirect --run part --gaze-left 5,5 --out part.png > log.txt
done
echo "density: the same bits again, on either side, by every kind of avatar"
