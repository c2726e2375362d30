#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# figures.sh OUT: the table of README and a sweep of gazes, by nothing but the program rye: makes a
# capture, trains on it, evaluates the frames kept aside, renders a sweep of gazes, and prints the
# table as Markdown. All of it lies in OUT; a call that was stopped goes on where it was. About
# 40 minutes on two cores. From the environment:
#   RYE       the program (default: build/release/rye)
#   CAPTURE   the folder of a capture to use, instead of making OUT/capture
#   VARIANTS  which trainings, of those below (default: "measured unmeasured"):
#               measured    the preset as it is
#               unmeasured  measured_eyes = false: eyeballs from landmarks alone, as in the paper
#               euclidean   avatar.metric = "euclidean"
#               round       gaussians.eyeball.thickness = 1: the eyeballs' Gaussians are no discs
#   AT_ONCE   1: the trainings side by side, for machines of many cores
#   PRESET    the preset (default: cpu; tiny for a look in minutes)
#   TRAIN     further options of `rye train`, such as "--threads 4"
#   MAKE      further options of `rye capture`
set -eu
here=$(cd "$(dirname "$0")" && pwd)
[ $# -eq 1 ] || { echo "figures.sh: expected one argument, the folder to write" >&2; exit 2; }
out=$1
rye=${RYE:-$here/../build/release/rye}
[ -x "$rye" ] || { echo "figures.sh: no program at $rye; build it, or name it by RYE" >&2; exit 2; }
variants=${VARIANTS:-measured unmeasured}
mkdir -p "$out"

settings() { # VARIANT: the fields that differ from the preset's
    case $1 in
        measured) echo '{}' ;;
        unmeasured) echo '{"measured_eyes": false}' ;;
        euclidean) echo '{"avatar": {"metric": "euclidean"}}' ;;
        round) echo '{"gaussians": {"eyeball": {"thickness": 1}}}' ;;
        *)
            echo "figures.sh: got the variant '$1', expected measured, unmeasured, euclidean or round" >&2
            exit 2
            ;;
    esac
}
for v in $variants; do settings "$v" > "$out/$v.json"; done

if [ -n "${CAPTURE:-}" ]; then
    capture=$CAPTURE
else
    capture=$out/capture
    # shellcheck disable=SC2086
    [ -e "$capture/capture.json" ] || "$rye" capture --out "$capture" --frames 32 \
        --test-frames 6 --apart-frames 2 ${MAKE:-}
fi

train() { # VARIANT
    run=$out/$1
    [ ! -e "$run/trained" ] || return 0
    begin=$(date +%s)
    if [ -e "$run/checkpoint.safetensors" ]; then
        "$rye" train --out "$run" --resume
    else
        # shellcheck disable=SC2086
        "$rye" train --capture "$capture" --out "$run" --preset "${PRESET:-cpu}" --config "$out/$1.json" \
            --overwrite ${TRAIN:-}
    fi
    echo "$(($(date +%s) - begin))" >> "$run/seconds"
    : > "$run/trained"
}
if [ "${AT_ONCE:-0}" = 1 ]; then
    jobs=
    for v in $variants; do
        train "$v" > "$out/$v.log" 2>&1 &
        jobs="$jobs $!:$v"
    done
    for job in $jobs; do
        wait "${job%%:*}" || { cat "$out/${job#*:}.log" >&2; exit 1; }
    done
else
    for v in $variants; do train "$v"; done
fi

for v in $variants; do
    echo "== $v"
    "$rye" evaluate --run "$out/$v" --capture "$capture" --split test | tee "$out/$v.txt"
done
sh "$here/judge/judge.sh" "$out" # says what is not installed
set -- $variants
"$rye" redirect --run "$out/$1" --capture "$capture" --sweep --out "$out/sweep.png"
# shellcheck disable=SC2086
python3 "$here/figures.py" "$out" "$capture" $variants | tee "$out/table.md"
