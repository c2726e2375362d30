#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# judge.sh WORK: benchmarks/judge without its models: what it computes (judge_test.js, by node), its
# words on what is missing, and the tables that read judge.json (by Python).
set -eu
work=$1
here=$(cd "$(dirname "$0")" && pwd)
benchmarks=$here/../../benchmarks
rm -rf "$work"
mkdir -p "$work/models"
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }
holds() { grep -qF -- "$1" "$2" || { cat "$2"; fail "no '$1'"; }; }
judge() { MODULES=models CHROMIUM=chromium FACE_LANDMARKER='' sh "$benchmarks/judge/judge.sh" "$@"; }
refuses() { # WORDS ARGUMENT...: by code 2
    words=$1
    shift
    code=0
    judge "$@" > out.txt 2>&1 || code=$?
    [ $code = 2 ] || { cat out.txt; fail "code $code, expected 2: $*"; }
    holds "$words" out.txt
}
refuses "expected folders of rye evaluate"
refuses "no results.json beside evaluate_SPLIT in models" models
refuses "no capture.json in models" --photographs models

# ---- tables ---------------------------------------------------------------------------------------
gaze='{"degrees": 2.5, "degrees_where_found": 2, "degrees_to_label": 3, "found": 4}'
all="{\"head\": {\"psnr\": 30, \"ssim\": 0.9}, \"face\": {\"psnr\": 29}, \"eyes\": {\"psnr\": 25},
  \"eyes_visible\": 4,
  \"gaze\": {\"render\": $gaze, \"at_rest\": $gaze, \"nearest_training\": $gaze, \"photograph\": $gaze},
  \"gaze_without_labels\": {\"render\": $gaze, \"photograph\": $gaze}}"
results="{\"split\": \"test\", \"step\": 5, \"missed_degrees\": 90, \"all\": $all}"
evaluation() { # FOLDER: with a picture that no model has seen
    mkdir -p "$1/evaluate_test"
    echo "$results" > "$1/results.json"
    echo '[{"frame": "1", "camera": "0", "picture": "frame_1.png"}]' > "$1/per_view.json"
    : > "$1/evaluate_test/frame_1.png"
}
evaluation labels/cap/clean_1/run
mkdir labels/cap/clean_1/by_run
echo "$results" > labels/cap/clean_1/by_run/results.json
echo 7 > labels/cap/clean_1/seconds
ladder=ladder/runs/cap/L0/seed_1
evaluation $ladder/evaluation_test
echo '{"rows": [{"name": "L0", "run": "L0"}]}' > ladder/ladder_gpu.json
echo '{"L0": ["L0"]}' > ladder/ladder_names.json
echo '[1/1] L0, cap, seed 1: 12 s' > ladder/compare.log
evaluation figures/measured
echo '{"preset": "cpu"}' > figures/measured/config.json
echo 3 > figures/measured/seconds
judgement='{"all": {"gaze": {"degrees": 6.25}, "irises": 4.44, "blink": 0.0123, "landmarks": 1.5,
  "coefficients": null}}'
tables() { # the three tables
    mkdir -p cap
    python3 "$benchmarks/wrong_labels.py" labels cap --sets clean --seeds 1 --rye /bin/false
    python3 "$benchmarks/ladder.py" table ladder test all
    echo
    python3 "$benchmarks/figures.py" figures cap measured
}
if command -v python3 > /dev/null; then
    tables > tables.txt || { cat tables.txt; fail "a table"; }
    [ "$(grep -c '| judge: gaze | irises' tables.txt)" = 3 ] || { cat tables.txt; fail "columns"; }
    none='not run | not run | not run | not run | not run | not run |'
    [ "$(grep -c "$none" tables.txt)" = 3 ] || { cat tables.txt; fail "not run"; }
    for folder in labels/cap/clean_1/run $ladder/evaluation_test figures/measured; do
        echo "$judgement" > $folder/judge.json
    done
    tables > tables.txt || { cat tables.txt; fail "a table"; }
    [ "$(grep -c '| 6.25° | 4.4 | 0.012 | 1.50 | not run | not run |' tables.txt)" = 3 ] ||
        { cat tables.txt; fail "the judge's numbers"; }
    awk -F'|' '/^[|] / { if (n && n != NF) bad = 1; n = NF } /^$/ { n = 0 } END { exit bad }' tables.txt ||
        { cat tables.txt; fail "lines of one table have different numbers of cells"; }
else
    echo "not run: tables with the judge's columns: no python3"
fi

# ---- what it computes -----------------------------------------------------------------------------
if ! command -v node > /dev/null; then
    judge labels > out.txt
    holds "not run: the judge: no node" out.txt
    echo "not run: what the judge computes: no node (Debian package nodejs)"
    exit 0
fi
rm -f labels/cap/clean_1/run/judge.json
judge labels > out.txt
holds "not run: landmarks, irises, gaze, coefficients: no @mediapipe/tasks-vision in models" out.txt
[ ! -e labels/cap/clean_1/run/judge.json ] || fail "judge.json of nothing"
echo '{"train_frames": [], "test_frames": [], "camera_ids": []}' > cap/capture.json
judge --photographs cap > out.txt
holds "not run: gaze of the judge on photographs: no @mediapipe/tasks-vision in models" out.txt
node "$here/judge_test.js" "$work"
