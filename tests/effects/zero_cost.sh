#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# zero_cost.sh COMPILER FLAGS_FILE SOURCE [EFFECT...]: for each effect, or these, an avatar without
# it takes as many instructions as a kernel written without it, 1.000 +- 0.001 (callgrind), gives the
# same bits, has parameters of the same size (static_assert), and its program has no symbol of the
# effect. Pupils are at rest, lids cast no shadow, and cost nothing then
# either.
# Skipped without valgrind.
set -eu
cxx=$1
flags=$(tr '\n' ' ' < "$2")
source=$3
shift 3
chosen=" $* "
if ! command -v valgrind > /dev/null; then
    echo "zero_cost: skipped, there is no valgrind (Debian: valgrind)"
    exit 77
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

count() {  # PROGRAM KERNEL
    valgrind --tool=callgrind --callgrind-out-file=/dev/null --toggle-collect="by_$2" "$1" "$2" \
        2>&1 | sed -n 's/.*Collected : \([0-9]*\).*/\1/p'
}

# One set of instructions and one rounding, whatever the machine and the inlining.
compile() {  # ARGUMENTS
    # shellcheck disable=SC2086 # the flags are several words
    $cxx $flags -O2 -DNDEBUG -march=x86-64-v3 -ffp-contract=off -fno-openmp "$@"
}
# What every program parses first, once.
grep '^#include <' "$source" > "$work/headers.hpp"
compile -x c++-header "$work/headers.hpp" -o "$work/headers.hpp.gch"

bad=0
# check EFFECT WORDS: the words are what only the effect's symbols have in their names.
check() {
    case $chosen in *" $1 "* | "  ") ;; *) return ;; esac
    program="$work/$1"
    compile -include "$work/headers.hpp" "-DWITHOUT_$1=1" "$source" -o "$program"
    "$program" || bad=1
    found=$(nm -C "$program" | grep -E "$2" || true)
    if [ -n "$found" ]; then
        echo "$1: its symbols are in a program without it: $(echo "$found" | head -3)"
        bad=1
    fi
    types=$(count "$program" types)
    hand=$(count "$program" hand)
    awk -v effect="$1" -v a="$types" -v b="$hand" 'BEGIN {
        printf "%-14s %10d instructions by types, %10d by hand: %.4f\n", effect, a, b, a / b
        exit !(a > 1e6 && b > 1e6 && a / b <= 1.001 && a / b >= 0.999) }' || bad=1
    rm -f "$program"
}

check EXPRESSION 'Expression'
check HEAD_POSE 'rye::HeadPose|HeadTransform|to_world|carry_eye|matrix_quat'
check POSE_RESIDUAL 'PoseResidual|PoseField'
check LEFT_GAZE 'LeftGaze|GazeField<0'
check RIGHT_GAZE 'RightGaze|GazeField<1'
check EYE_OFFSET 'EyeOffset|eye_offset'
check KAPPA 'Kappa|kappa'
check PERIOCULAR 'Periocular|GazeField'
check CORNEAL_BULGE 'CornealBulge|cornea_offset'
check CORNEAL_REFRACTION 'CornealRefraction|seen_through'
check GLINT 'Glint|glint_at|mirror_image'
check PUPIL 'Pupil|StretchEyePoint|iris_of'
check LID_SHADOW 'LidShadow|LidOfEye|ShadeEyePoint|place_lid'
check HEAD_SHADING 'Shading|ShadedFrame|LogLight'
check VIEW_COLOR 'ViewColor|view_color'
exit $bad
