#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# ladder.sh OUT CAPTURE [SEEDS]: what leads from the preset `paper-literal` to `gpu`, rung by rung:
# trains and measures lists of configurations by `rye compare`, and prints a table as Markdown. All
# of it lies in OUT; the same call goes on where it was stopped, and other rungs are added to it.
# CAPTURE and SEEDS (default: 1,2,3) are lists with commas. From the environment:
#   RYE      the program (default: build/release/rye)
#   RUNGS    which rungs, by name, with spaces (default: factorial):
#              L0            paper-literal
#              L1b ... L11   paper-literal with these fields of gpu (ladder.py has them): L1b rates,
#                            L2 no doublings, L3 no InstanceNorm and the skip, L4 the Laplacian in
#                            metres, L5 stage 1, L6 codes, L7 eyes, L8 blank, L9
#                            spacing, L10 D-SSIM, L11 all else
#              L1a64, ...    parts of these, and others: L1a288, L1pictures, L2a, L2auto, L3a, L3c,
#                            L5a to L5d, L7a to L7g, L8a, L11a to L11g
#              L1b+L2        both
#              to-L5         all to this one
#              gpu, gpu-L5   gpu, and gpu with the fields of a rung as paper-literal has them
#              gpu+L7b       gpu with the fields of a rung that gpu has not
#              paper         paper-literal with the readings of paper
#              alone, factorial, cumulative, removed, fine   sets of these
#   SPLITS   frames to measure (default: "test train")
#   GROUP    which of them to print (default: all; "novel gaze", "independent eyes")
#   COMPARE  further options of `rye compare`, such as "--device cuda --jobs 4"
# After `sh benchmarks/judge/judge.sh OUT` the same call prints the judge's columns, too.
# "seconds" are those of training and measuring, without a stage 1 that another run has trained, and
# with --jobs beside others.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
if [ $# -lt 2 ] || [ $# -gt 3 ]; then
    echo "ladder.sh: expected the folder to write, that of a capture, and perhaps seeds" >&2
    exit 2
fi
out=$1
capture=$2
seeds=${3:-1,2,3}
rye=${RYE:-$here/../build/release/rye}
[ -x "$rye" ] || { echo "ladder.sh: no program at $rye; build it, or name it by RYE" >&2; exit 2; }
splits=${SPLITS:-test train}
mkdir -p "$out"
# shellcheck disable=SC2086
python3 "$here/ladder.py" lists "$out" "$rye" ${RUNGS:-factorial}

failed=0
for split in $splits; do
    for preset in paper-literal gpu; do
        list=$out/ladder_$preset.json
        [ -e "$list" ] || continue
        # shellcheck disable=SC2086
        "$rye" compare --list "$list" --capture "$capture" --seeds "$seeds" --split "$split" \
            --out "$out" ${COMPARE:-} >> "$out/compare.log" || failed=1
    done
done
for split in $splits; do
    python3 "$here/ladder.py" table "$out" "$split" "${GROUP:-all}"
done > "$out/ladder.md"
cat "$out/ladder.md"
exit $failed
