#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# ranks.sh RYE RYE_EMULATED WORK: steps of several pictures by one rank and by several in threads,
# on the CPU and on devices that RYE_EMULATED runs on the host: the same bits with changes of
# density, stopped, killed and resumed by another number of ranks; and what is refused.
set -eu
plain=$1
emulated=$2
work=$3
rm -rf "$work"
mkdir -p "$work"
cd "$work"
fail() { echo "FAILED: $*" >&2; exit 1; }
same() { cmp "$1" "$2" || fail "$1 and $2 differ"; }
refuses() { # WORDS OPTION...: a training that is not begun, by a line of these words
    words=$1
    shift
    if "$plain" train --capture cap --preset tiny --config small.json --quiet "$@" > out.txt 2>&1; then
        fail "accepted: $*"
    fi
    grep -q -- "$words" out.txt || { cat out.txt; fail "no word of '$words' from: $*"; }
}

"$plain" capture --out cap --size 50 --cameras 3 --frames 3 --test-frames 1 --apart-frames 0 \
    --samples 1 --quiet
cat > small.json << 'END'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.5, "subdivide": false},
 "mesh": {"steps": 4, "image_size": 24, "pretrain_steps": 30, "fit_steps": 5},
 "gaussians": {"steps": 6, "views": 8, "rate_decay": 1, "mouth_points": 10, "spacing": 0.3, "panel_every": 6,
  "checkpoint_every": 3, "density": {"every": 2, "first": 2, "last": 4, "grow": 0.1},
  "augment": true, "planes": 3, "eyeball": {"points": 40}, "upsampler": {"capacity": 2}}}
END

# whole RYE NAME RANKS...: a training by one rank, and by each of these numbers of them.
whole() {
    rye=$1
    name=$2
    shift 2
    train() { "$rye" train --capture cap --preset tiny --config small.json --quiet "$@" 2>> errors.txt; }
    train --out "$name" || { cat errors.txt; fail "$name: no training of one rank"; }
    for ranks in "$@"; do
        train --out "${name}_$ranks" --ranks "$ranks" || { cat errors.txt; fail "$name by $ranks ranks"; }
        same "$name/checkpoint.safetensors" "${name}_$ranks/checkpoint.safetensors"
        same "$name/log.jsonl" "${name}_$ranks/log.jsonl"
        for panel in "$name"/panels/step_*.png; do
            same "$panel" "${name}_$ranks/panels/${panel##*/}"
        done
    done
}
whole "$plain" cpu 2 4 8
# Ended after step 3, and gone on with by fewer ranks. The log ends alike.
train --out cut --ranks 4 --steps 3
train --out cut --ranks 1 --resume --steps 6
tail -n 1 cpu/log.jsonl > whole.txt
tail -n 1 cut/log.jsonl > cut.txt
same whole.txt cut.txt
cp small.json large.json
sed -i 's/"steps": 6, "views": 8/"steps": 4, "views": 2/; s/"panel_every": 6/"panel_every": 4/' small.json
whole "$emulated" device 2
cp large.json small.json

# A signal stops all ranks after the same step, whichever sees it first.
"$plain" train --capture cap --preset tiny --config small.json --quiet --steps 100000 --ranks 2 \
    --out stopped > stopped.txt 2>&1 &
pid=$!
trap 'kill -9 "$pid" 2> /dev/null || true' EXIT
n=0
until grep -q '"stage":"avatar"' stopped/log.jsonl 2> /dev/null; do
    kill -0 "$pid" || { cat stopped.txt; fail "the training ended by itself"; }
    n=$((n + 1))
    [ $n -lt 1200 ] || fail "no step after 120 s"
    sleep 0.1
done
kill -TERM "$pid"
code=0
wait "$pid" || code=$?
[ $code -eq 143 ] || { cat stopped.txt; fail "stopped with code $code"; }
grep -q -- "--resume" stopped.txt || fail "nothing is said of going on"

# ... and in stage 1, which rank 0 trains while the others wait.
sed 's/"mesh": {"steps": 4/"mesh": {"steps": 1000000/' small.json > long.json
"$plain" train --capture cap --preset tiny --config long.json --quiet --ranks 2 --out halted \
    > halted.txt 2>&1 &
pid=$!
n=0
until grep -q '"stage":"mesh"' halted/log.jsonl 2> /dev/null; do
    kill -0 "$pid" || { cat halted.txt; fail "stage 1 ended by itself"; }
    n=$((n + 1))
    [ $n -lt 1200 ] || fail "no step of stage 1 after 120 s"
    sleep 0.1
done
kill -TERM "$pid"
code=0
wait "$pid" || code=$?
[ $code -eq 143 ] || { cat halted.txt; fail "stopped in stage 1 with code $code"; }

# Three ranks of eight pictures: another order of sums, and nearly the same losses.
"$plain" train --capture cap --preset tiny --config small.json --quiet --out three --ranks 3 2> /dev/null
for run in cpu three; do
    tail -n 1 $run/log.jsonl | tr ',' '\n' | sed -n 's/"loss"://p' > $run.loss
    [ -s $run.loss ] || fail "no loss in $run/log.jsonl"
done
paste -d ' ' cpu.loss three.loss |
    awk '{ exit !($1 - $2 < 1e-4 * $1 && $2 - $1 < 1e-4 * $1) }' || fail "losses of 1 and 3 ranks"

refuses "gaussians.views: got 8 pictures a step, expected 9 or more: one for each of the --ranks" \
    --out none --ranks 9
refuses "expected a number from 1 to 1024, torchrun, mpi or slurm" --out none --ranks 0
refuses "the variables SLURM_PROCID and SLURM_NTASKS are not in the environment" --out none --ranks slurm
RANK=2 WORLD_SIZE=2 refuses "RANK: got 2, expected less than WORLD_SIZE, 2" --out none --ranks torchrun
RANK=0 WORLD_SIZE=1 LOCAL_RANK=0 refuses \
    "got torchrun, but stage 2 is trained on the CPU, where ranks are threads of one process" \
    --out none --ranks torchrun
[ ! -e none/checkpoint.safetensors ] || fail "a training that was refused left a run"
echo "ranks: passed"
