#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# two_trainings.sh RYE WORK: two trainings into one folder. The second is told who has it and writes
# nothing, of two that begin at once one goes on, and a training that was killed leaves no lock. One
# that is shown in the browser is the same.
set -eu
rye=$1
work=$2
rm -rf "$work"
mkdir -p "$work"
cd "$work"
fail() { echo "FAILED: $*" >&2; exit 1; }

"$rye" capture --out cap --size 50 --cameras 3 --frames 3 --test-frames 1 --apart-frames 0 \
    --samples 1 --quiet
cat > small.json << 'EOF'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 2, "image_size": 32, "pretrain_steps": 5, "fit_steps": 2},
 "gaussians": {"steps": 1000000, "mouth_points": 20, "panel_every": 0, "checkpoint_every": 3,
  "spacing": 0, "eyeball": {"points": 120}, "upsampler": {"capacity": 2, "doublings": 2}}}
EOF
begin() { "$rye" train --capture cap --preset tiny --config small.json --quiet --threads 1 "$@"; }
await() { # PID FILE: until the file is there
    n=0
    until [ -e "$2" ]; do
        kill -0 "$1" 2> /dev/null || fail "the training ended before it wrote $2: $(cat first.txt)"
        n=$((n + 1))
        [ $n -lt 1200 ] || fail "no $2 after 120 s"
        sleep 0.1
    done
}

# No function here: its shell would have another number.
"$rye" train --capture cap --preset tiny --config small.json --quiet --threads 1 --out run \
    > first.txt 2>&1 &
first=$!
trap 'kill -9 "$first" 2> /dev/null || true' EXIT
await "$first" run/config.json
cp run/config.json config.kept
for more in "--seed 7" "--resume" "--overwrite --seed 7"; do
    code=0
    # shellcheck disable=SC2086 # a list of options
    begin --out run $more > second.txt 2>&1 || code=$?
    { [ $code -ne 0 ] && [ $code -lt 126 ]; } || fail "train $more beside another one ended with code $code"
    grep -q "run: is in use by rye train, process $first on .* since 2" second.txt ||
        fail "train $more: $(cat second.txt)"
done
cmp -s run/config.json config.kept || fail "the second training wrote a config.json"
kill -0 "$first" || fail "the first training ended: $(cat first.txt)"
await "$first" run/checkpoint.safetensors
kill -9 "$first"
wait "$first" 2> /dev/null || true
begin --out run --overwrite --steps 1 > third.txt 2>&1 || fail "after a kill: $(cat third.txt)"

# Two at once, into a folder that is not there yet: one of them trains.
begin --out both --seed 1 --steps 2 > a.txt 2>&1 &
a=$!
begin --out both --seed 2 --steps 2 > b.txt 2>&1 &
b=$!
ended=0
wait $a || ended=$((ended + 1))
wait $b || ended=$((ended + 1))
cat a.txt b.txt
[ $ended -eq 1 ] || fail "$ended of two trainings at once were refused, expected one"
seed=$(grep -o '"seed": *[0-9]*' both/config.json | grep -o '[0-9]*$')
grep -a -q "\\\\\"seed\\\\\":$seed" both/checkpoint.safetensors ||
    fail "config.json has seed $seed, and the checkpoint another"
echo "two trainings: one is refused, by name"

# A training that is shown in the browser has the bits of one that is not.
begin --out plain --steps 4 > plain.txt 2>&1 || fail "$(cat plain.txt)"
code=0
begin --out shown --steps 4 --view 0 > shown.txt 2>&1 || code=$?
if grep -q "built without Asio" shown.txt; then
    echo "not run: two_trainings: train --view: $(cat shown.txt)"
    exit 0
fi
[ $code -eq 0 ] || fail "train --view: $(cat shown.txt)"
grep -q '^rye: note: shown at http://127.0.0.1:[0-9]*/[0-9a-f]*/$' shown.txt || fail "no address: $(cat shown.txt)"
cmp plain/checkpoint.safetensors shown/checkpoint.safetensors || fail "train --view changed the training"
echo "a training that is shown: the same bits"
