#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# compare.sh RYE WORK: `rye compare` in small: every gaze mechanism trains, tables have the numbers
# of `rye evaluate`, what is there is not done again, a comparison that is killed or stopped goes on
# to the same bits, as do tasks that other programs start, and wrong lists get one sentence.
set -eu
rye=$1
work=$2
rm -rf "$work"
mkdir -p "$work"
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }
same() { cmp "$1" "$2" || fail "$1 and $2 differ"; }
refuses() { # WORDS COMMAND...: it must fail with one line that holds the words
    words=$1
    shift
    if "$@" > out.txt 2> err.txt; then fail "accepted: $*"; fi
    grep -q -- "$words" err.txt || { cat out.txt err.txt; fail "no word of '$words' from: $*"; }
    [ "$(wc -l < err.txt)" -eq 1 ] || { cat err.txt; fail "more than a line from: $*"; }
}

"$rye" capture --out cap --size 64 --cameras 3 --frames 3 --test-frames 1 --apart-frames 1 \
    --samples 2 --quiet
cat > small.json << 'JSON'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 8, "image_size": 32, "pretrain_steps": 40, "fit_steps": 20},
 "gaussians": {"steps": 12, "mouth_points": 20, "panel_every": 0, "checkpoint_every": 3,
  "spacing": 0, "eyeball": {"points": 120}, "upsampler": {"capacity": 2}}}
JSON

# ---- a list of one's own -------------------------------------------------------------------------
cat > mine.json << 'JSON'
{"title": "Two rows", "preset": "tiny", "captures": ["cap"], "seeds": [1, 5],
 "columns": ["head_psnr", "skin_ssim", "gaze", "irises"],
 "rows": [{"name": "as it is"},
          {"name": "no blank loss", "run": "blank0", "config": {"gaussians": {"weights": {"blank": 0}}}}]}
JSON
"$rye" compare --list mine.json --config small.json --out one --jobs 2 > one.txt
grep -q "^4 runs, 4 of them to do, 2 at once; stage 1 is trained for 2$" one.txt || { cat one.txt; fail "runs to do"; }
grep -q "± " one/mine.md || fail "no spread over seeds"
grep -q "^not run: FID" one/mine.md || fail "nothing is said of what is not measured"
[ -s one/mine_cap.png ] || fail "no contact sheet"
# A run and its numbers are those of rye train and rye evaluate.
run=one/runs/cap/as_it_is/seed_5
"$rye" train --capture cap --preset tiny --config small.json --seed 5 --quiet --out alone > log.txt
same alone/checkpoint.safetensors $run/checkpoint.safetensors
"$rye" evaluate --run alone --split test > log.txt
same alone/results.json $run/evaluation_test/results.json
# Rows share stage 1; a row that began from another's has the bits of one that trained its own.
sed 's/"gaussians": {/"gaussians": {"weights": {"blank": 0}, /' small.json > blank.json
"$rye" train --capture cap --preset tiny --config blank.json --seed 5 --quiet --out own > log.txt
"$rye" train --capture cap --preset tiny --config blank.json --seed 5 --quiet --out begun \
    --begin alone > log.txt
for file in checkpoint.safetensors log.jsonl config.json frames.safetensors; do
    same own/$file begun/$file
    same own/$file one/runs/cap/blank0/seed_5/$file
done
grep -q '"mesh"' begun/log.jsonl || fail "no stage 1 in the log of a run that begins from another's"
begins() { # WORDS COMMAND...: not from the run alone
    words=$1
    shift
    refuses "$words" "$rye" train --capture cap --preset tiny --out not --begin alone "$@"
    [ ! -e not ] || fail "a refused training wrote something"
}
begins "^rye train: --begin: alone: field 'seed': got 5, expected 6" --config blank.json --seed 6
sed 's/"cell": 0.35/"cell": 0.3/' small.json > cell.json
begins "field 'grid.cell': got 0.35, expected 0.3" --config cell.json --seed 5
sed 's/"geometry": \[16, 16\]/"geometry": [16, 8]/' small.json > other.json
begins "field 'avatar.networks.geometry': got \[16,16\], expected \[16,8\]" --config other.json --seed 5
begins "exclude each other" --resume --seed 5
"$rye" capture --out cap2 --size 64 --cameras 3 --frames 3 --test-frames 1 --apart-frames 1 \
    --samples 1 --quiet --seed 2
refuses "its frames, drivers or cameras are not those of the capture in 'cap2'" "$rye" train \
    --capture cap2 --preset tiny --config small.json --seed 5 --out not --begin alone
sed 's/"steps": 8/"steps": 1000000/' small.json > long.json
"$rye" train --capture cap --preset tiny --config long.json --seed 5 --quiet --out early > log.txt &
pid=$!
while ! grep -q mesh early/log.jsonl 2> /dev/null && kill -0 $pid 2> /dev/null; do sleep 0.02; done
kill -TERM $pid
wait $pid || true
refuses "early: this run is still in stage 1 (step" "$rye" train --capture cap --preset tiny \
    --config long.json --seed 5 --out not --begin early
psnr() { awk '/^  "all"/ { a = 1 } a && /"head"/ { h = 1 }
    h && /"psnr":/ { gsub(/[^0-9.]/, ""); print; exit }' "$1"; }
a=$(psnr one/runs/cap/as_it_is/seed_1/evaluation_test/results.json)
b=$(psnr $run/evaluation_test/results.json)
awk -F, -v a="$a" -v b="$b" '
    $3 == "all" && $4 == "as it is" && $5 == "head_psnr" {
        mean = (a + b) / 2; dev = a > b ? (a - b) / sqrt(2) : (b - a) / sqrt(2)
        if ($6 - mean < 1e-6 && mean - $6 < 1e-6 && $7 - dev < 1e-6 && dev - $7 < 1e-6 && $8 == 2) good = 1
    }
    END { exit !good }' one/mine.csv || { cat one/mine.csv; fail "mean and deviation of $a and $b"; }
grep -q "^mine,cap,as it is,5,all,head_psnr,$b" one/mine_runs.csv || fail "the number of one run"

# Nothing is done twice, and the tables stay.
cp one/mine.md before.md
stamp=$(ls -l --time-style=full-iso $run/checkpoint.safetensors)
"$rye" compare --list mine.json --config small.json --out one > two.txt
grep -q "^4 runs, 0 of them to do" two.txt || { cat two.txt; fail "done again"; }
[ "$stamp" = "$(ls -l --time-style=full-iso $run/checkpoint.safetensors)" ] || fail "trained again"
same before.md one/mine.md
"$rye" compare --list mine.json --config small.json --out one --json > one.json
grep -q '"name": "no blank loss"' one.json || fail "no row in --json"

# ---- killed, stopped, gone on with ---------------------------------------------------------------
interrupted() { # SIGNAL SECONDS: the exit code of a comparison that gets it after so long
    rm -rf cut
    "$rye" compare --list mine.json --config small.json --out cut --jobs 2 > cut.txt 2> cut.err &
    pid=$!
    sleep "$2"
    kill -"$1" "$pid" 2> /dev/null || true
    code=0
    wait "$pid" 2> /dev/null || code=$?
}
go_on() {
    "$rye" compare --list mine.json --config small.json --out cut --jobs 2 > cut.txt
    for r in as_it_is blank0; do
        for s in 1 5; do
            same one/runs/cap/$r/seed_$s/checkpoint.safetensors cut/runs/cap/$r/seed_$s/checkpoint.safetensors
        done
    done
    same one/mine.csv cut/mine.csv
    same one/mine.md cut/mine.md
}
for seconds in 0.3 0.8; do
    interrupted KILL $seconds
    go_on
done
interrupted TERM 0.6
if [ $code != 0 ]; then
    [ $code = 143 ] || fail "code $code of a comparison that is asked to stop, expected 143"
    grep -q "stopped; the same command goes on" cut.err || { cat cut.err; fail "no word of the stop"; }
fi
go_on

# ---- what is wrong is named ----------------------------------------------------------------------
compare() { "$rye" compare --capture cap --out bad --config small.json "$@"; }
refuses "got neither --table nor --list" compare
refuses "did you mean 'losses'" compare --table lossses
echo '{"rows": [{"name": "a", "config": {"avatar": {"gaze_mechanism": "turn"}}}]}' > list.json
refuses "row 'a': field 'avatar.gaze_mechanism': got \"turn\"" compare --list list.json
echo '{"rows": [{"name": "a"}], "row": 1}' > list.json
refuses "list.json: field 'row' is unknown" compare --list list.json
echo '{"rows": [{"name": "a"}, {"name": "a"}]}' > list.json
refuses "field 'rows\[1\].name': got 'a'" compare --list list.json
echo '{"rows": [{"name": "a", "run": "../b"}]}' > list.json
refuses "field 'rows\[0\].run': got '../b'" compare --list list.json
echo '{"rows": [{"name": "a"}], "columns": ["psnr"]}' > list.json
refuses "field 'columns\[0\]': got \"psnr\"" compare --list list.json
echo '{"rows": [{"name": "a"}], "seeds": [-1]}' > list.json
refuses "field 'seeds\[0\]': got -1" compare --list list.json
echo '{"rows": [{"name": "a"}], "captures": ["nowhere"]}' > list.json
refuses "which is no folder" "$rye" compare --list list.json --out bad
refuses "the tables\|which is no folder\|--capture is missing" "$rye" compare --table losses --out bad
[ ! -e bad ] || fail "a refused comparison wrote something"
refuses "config.json: field 'gaussians.weights.blank': got 0.0, expected" sh -c \
    "cp -r one/runs/cap/blank0/seed_1/. one/runs/cap/as_it_is/seed_1/ && exec '$rye' compare --list mine.json --config small.json --out one"

# A run that fails is named, and the others are done.
cp -r cap broken && rm broken/capture.json broken/params/*/gaze.npz
echo '{"preset": "tiny", "captures": ["cap", "broken"], "seeds": [1], "rows": [{"name": "a"}]}' > list.json
if "$rye" compare --list list.json --config small.json --out half > half.txt 2> half.err; then
    fail "a comparison with a failed run has code 0"
fi
grep -q "1 of 2 runs failed" half.err || { cat half.err; fail "the number of failed runs"; }
grep -q "^not run: a, broken, seed 1: rye train: " half/list.md || { cat half/list.md; fail "the reason"; }
grep -q "^list,cap,all,a,head_psnr," half/list.csv || { cat half/list.csv; fail "the run that is sound"; }

# ---- tasks that other programs start ------------------------------------------------------------
emit() { "$rye" compare --list mine.json --config small.json "$@"; }
emit --out tasks --emit slurm --threads 1 > emitted.txt
grep -q "^4 runs, 4 of them to do: sh tasks/submit.sh$" emitted.txt || { cat emitted.txt; fail "what is emitted"; }
cp tasks/plan.json plan.json
for launcher in parallel k8s; do emit --out tasks --emit $launcher --threads 1 > emitted.txt; done
same plan.json tasks/plan.json
for script in slurm.sbatch submit.sh parallel.sh; do sh -n tasks/$script || fail "$script"; done
code=0
"$rye" compare --collect --out tasks > tables.txt 2> missing.txt || code=$?
[ $code = 1 ] || fail "code $code of tables without runs, expected 1"
grep -q "^rye compare: as it is, cap, seed 1: not begun$" missing.txt || { cat missing.txt; fail "a missing run"; }
grep -q "^rye compare: 4 of 4 runs are not in the tables$" missing.txt || { cat missing.txt; fail "missing runs"; }
task() { "$rye" compare --out tasks --quiet --task "$@"; }
# Task 3 takes stage 1 from task 1; of two that are started at once one does the work.
task 1 --stage-one
task 1 --stage-one
task 1 & first=$!
task 1
wait $first || fail "a task that is started twice"
task 3
grep -q '^{"stage":"labels"' tasks/runs/cap/blank0/seed_5/log.jsonl && fail "task 3 trained a stage 1"
code=0
"$rye" compare --collect --out tasks --json > half.json 2> missing.txt || code=$?
[ $code = 1 ] && grep -q "2 of 4 runs are not" missing.txt || { cat missing.txt; fail "tables of half the runs"; }
grep -q '"reason": "not begun"' half.json || fail "no reason in --json"
task 0
task 2
task 2
"$rye" compare --collect --out tasks > tables.txt 2> missing.txt || { cat missing.txt; fail "tables of all runs"; }
[ ! -s missing.txt ] || fail "something is said of complete tables"
"$rye" compare --collect --list mine.json --config small.json --out tasks > with_list.txt
for file in mine.md mine.csv mine_runs.csv mine_cap.png; do same one/$file tasks/$file; done
for r in as_it_is blank0; do
    for s in 1 5; do
        [ ! -e tasks/runs/cap/$r/seed_$s/task.claim ] || fail "a claim of a task that has ended"
    done
done
emit --out tasks --emit slurm > emitted.txt
grep -q "^4 runs, 0 of them to do" emitted.txt || { cat emitted.txt; fail "to do again"; }
sh tasks/submit.sh | grep -qx "all runs are complete" || fail "complete tasks are submitted"

# One that is killed goes on from its checkpoint; one that is stopped, too.
long() { "$rye" compare --list mine.json --config small.json --capture "$PWD/cap" --steps 400 "$@"; }
long --out straight --jobs 2 > straight.txt
long --out killed --emit parallel > emitted.txt
for signal in KILL TERM; do
    run=killed/runs/cap/as_it_is/seed_1
    rm -rf killed/runs
    "$rye" compare --out killed --quiet --task 0 2> err.txt & pid=$!
    while [ ! -e $run/checkpoint.safetensors ] && kill -0 $pid 2> /dev/null; do sleep 0.02; done
    if [ $signal = TERM ]; then
        "$rye" compare --collect --out killed > tables.txt 2> missing.txt && fail "tables without runs"
        grep -q "as it is, cap, seed 1: running, by process $pid on" missing.txt || { cat missing.txt; fail "a run that is running"; }
        refuses "seed_1: is in use by a task, process $pid on .*; wait until" long --out killed
    fi
    kill -$signal $pid
    code=0
    wait $pid 2> /dev/null || code=$?
    [ $signal = KILL ] || [ $code = 143 ] || { cat err.txt; fail "code $code of a task that is stopped"; }
    "$rye" compare --out killed --quiet --task 0
    same straight/runs/cap/as_it_is/seed_1/evaluation_test/results.json $run/evaluation_test/results.json
    same straight/runs/cap/as_it_is/seed_1/checkpoint.safetensors $run/checkpoint.safetensors
done

# What is wrong is named; a task that fails is, too, until it succeeds.
refuses "^rye compare: --task: got 4, expected 0 to 3, as tasks/plan.json has$" task 4
refuses "^rye compare: --task: got --seeds too, expected only --out" task 1 --seeds 1
refuses "^rye compare: --collect: got --seeds too, expected only --out" "$rye" compare --collect --out tasks --seeds 1
refuses "^rye compare: one/plan.json: is not there, expected the --out of" "$rye" compare --out one --task 0
refuses "^rye compare: --with: got '--mem=1G', expected image=IMAGE" emit --out new --emit k8s --with --mem=1G
[ ! -e new ] || fail "a refused --emit wrote something"
refuses "^rye compare: tasks/plan.json: tasks\[1\]: got 'runs/cap/as_it_is/seed_5', which is no run of the list" \
    emit --out tasks --emit slurm --seeds 1
refuses "^rye compare: tasks/plan.json: tasks\[0\]: the configuration of 'runs/cap/as_it_is/seed_1' is not that" \
    emit --out tasks --emit slurm --steps 13
refuses "^rye compare: tasks/plan.json: tasks: got 4 runs, expected 6" emit --out tasks --emit slurm --seeds 1,5,6
cp tasks/plan.json whole.json
sed 's/"split": "test"/"split": "novel"/' whole.json > tasks/plan.json
refuses "plan.json: field 'checksum': is not that of the other fields: the file is damaged$" task 0
refuses "plan.json: field 'checksum'" "$rye" compare --collect --out tasks
head -c 300 whole.json > tasks/plan.json
refuses "tasks/plan.json: not JSON" task 0
cp whole.json tasks/plan.json
mv cap elsewhere
refuses "got '$work/cap', which is no folder" task 0
mv elsewhere cap
echo '{"preset": "tiny", "captures": ["cap", "broken"], "seeds": [1], "rows": [{"name": "a"}]}' > list.json
"$rye" compare --list list.json --config small.json --out fails --emit slurm > emitted.txt
refuses "^rye compare: a, broken, seed 1: rye train: " "$rye" compare --out fails --quiet --task 1
"$rye" compare --out fails --quiet --task 0
code=0
"$rye" compare --collect --out fails > tables.txt 2> missing.txt || code=$?
[ $code = 1 ] || fail "code $code with a run that failed, expected 1"
sed "s|$work/||g" fails/list.md > reasons.md
same half/list.md reasons.md
printf 'x' >> fails/runs/cap/a/seed_1/evaluation_test/results.json
"$rye" compare --collect --out fails > tables.txt 2> missing.txt && fail "damaged results are in a table"
grep -q "a, cap, seed 1: .*results.json: not JSON" missing.txt || { cat missing.txt; fail "damaged results"; }

# What Kubernetes demands of an indexed job.
emit --out tasks --emit k8s --device cuda --threads 4 --jobs 2 --with image=r/rye:1 \
    --with "volume=claim:$work" --with memory=8Gi > emitted.txt
if python3 -c 'import yaml' 2> /dev/null; then
    python3 - tasks/k8s.yaml "$work" << 'PY' || fail "k8s.yaml"
import sys, yaml
job = yaml.safe_load(open(sys.argv[1]))
assert (job["apiVersion"], job["kind"]) == ("batch/v1", "Job")
assert set(job) == {"apiVersion", "kind", "metadata", "spec"}
spec, pod = job["spec"], job["spec"]["template"]["spec"]
assert set(spec) == {"completionMode", "completions", "parallelism", "backoffLimitPerIndex",
                     "maxFailedIndexes", "podReplacementPolicy", "podFailurePolicy", "template"}
assert spec["completionMode"] == "Indexed" and spec["completions"] == 4 and spec["parallelism"] == 2
assert 0 <= spec["maxFailedIndexes"] <= spec["completions"] and spec["backoffLimitPerIndex"] == 2
# A policy of failures wants these two.
assert pod["restartPolicy"] == "Never" and spec["podReplacementPolicy"] == "Failed"
[rye] = pod["containers"]
assert rye["command"][:4] == ["rye", "compare", "--out", sys.argv[2] + "/tasks"]
assert rye["command"][-2:] == ["--task", "$(JOB_COMPLETION_INDEX)"]
assert rye["image"] == "r/rye:1" and rye["resources"]["requests"]["cpu"] == "4"
assert rye["resources"]["limits"] == {"memory": "8Gi", "nvidia.com/gpu": 1}
[volume], [mount] = pod["volumes"], rye["volumeMounts"]
assert volume["name"] == mount["name"] and mount["mountPath"] == sys.argv[2]
assert volume["persistentVolumeClaim"] == {"claimName": "claim"}
PY
else
    echo "not run: the fields of k8s.yaml: no python3 with yaml"
fi

# ---- every gaze mechanism ------------------------------------------------------------------------
"$rye" compare --table mechanisms,deformation --preset tiny --config small.json --capture cap \
    --seeds 1 --out tables --jobs 2 --device cpu > tables.txt
grep -q "^8 runs, 8 of them to do" tables.txt || { cat tables.txt; fail "runs of two tables"; }
"$rye" compare --table losses,deformation --preset tiny --config small.json --capture cap --steps 1 \
    --seeds 1 --out shared --jobs 2 --device cpu > tables.txt
grep -q "^10 runs, 10 of them to do" tables.txt || { cat tables.txt; fail "runs that tables share"; }
for name in rotation feature_rotation condition latent_rotation learned_quaternion none; do
    run=tables/runs/cap/$name/seed_1
    grep -q "\"gaze_mechanism\": \"$name\"" $run/config.json || fail "$name is not in config.json"
    "$rye" redirect --run $run --gaze-left 5,10 --gaze-right -5,-10 --out $name.png > log.txt
    "$rye" redirect --run $run --sweep --out sweep.png > log.txt
    "$rye" export --run $run --out $name.ply > log.txt
    "$rye" info cap --effects --run $run > log.txt
    if [ $name != rotation ]; then
        cmp -s rotation.png $name.png && fail "$name draws what rotation does"
        refuses "avatar.gaze_mechanism is '$name'" "$rye" export --run $run --out $name.avatar
        refuses "got 'gaze', expected auto or paper" "$rye" redirect --run $run --sweep \
            --effects gaze --out sweep.png
    fi
done
echo '{"avatar": {"gaze_mechanism": "condition", "eye_appearance": "free", "shading": "none"}}' \
    > other.json
refuses "field 'avatar.gaze_mechanism': got \"condition\", expected \"none\"" \
    "$rye" train --out tables/runs/cap/none/seed_1 --resume --config other.json
grep -q "eye crops, eyeballs white" tables/deformation.md || fail "table 3 has no eye crops"
"$rye" compare --table losses --print-list > losses.json
"$rye" compare --list losses.json --print-list > again.json
[ "$(grep -c '"run"' losses.json)" = 9 ] || fail "rows of the table of losses"
same losses.json again.json
echo "comparisons are whole, go on where they were, and refuse what is wrong"
