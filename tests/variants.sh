#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# variants.sh [NAME...]: builds the tests of numbers (hard cases, laws of derivatives, math,
# autodiff, geometry, gaussian, splat) in each of the ways below and runs them, with denormals
# flushed to zero and without. A way takes several minutes to build, so no ctest runs this.
#   contract_off   -march=x86-64-v3 -ffp-contract=off: no product is fused
#   contract_fast  -march=x86-64-v3 -ffp-contract=fast: every product may be
#   sanitizers     the address and undefined-behaviour sanitizers, at -O1, fewer draws
#   clang          clang++ (or the compiler named by CLANG)
set -eu
cd "$(dirname "$0")/.."
. cmake/steps.sh

folders="math autodiff geometry gaussian splat"
targets="hard_cases"
for folder in $folders; do targets="$targets test_$folder"; done
for law in tests/mutation/laws_*.cpp; do targets="$targets $(basename "$law" .cpp)"; done
# The names of the tests themselves: those of these programs, twice each.
names="^(hard_cases|laws_[a-z]+|test_($(echo "$folders" | tr ' ' '|')))(_flush_to_zero)?\$"

build_and_test() { # NAME CMAKE_OPTIONS...
    name=$1; shift
    build=${BUILD:-build/variants}/$name
    # `set -e` is off in here, since step asks for the status.
    # shellcheck disable=SC2086 # a list
    configure "$build" -DRYE_BUILD_PROGRAMS=OFF -DRYE_BUILD_EXAMPLES=OFF \
        -DRYE_BUILD_BENCHMARKS=OFF "$@" &&
    cmake --build "$build" --parallel "$jobs" --target $targets &&
    ctest --test-dir "$build" -R "$names" --output-on-failure
}

variant() {
    case $1 in
    contract_off | contract_fast)
        build_and_test "$1" -DRYE_NATIVE=OFF \
            -DCMAKE_CXX_FLAGS="-march=x86-64-v3 -ffp-contract=${1#contract_}" ;;
    sanitizers)
        build_and_test "$1" -DRYE_LAW_DRAWS=500 \
            -DCMAKE_CXX_FLAGS="-fsanitize=address,undefined -fno-sanitize-recover=all -g1" ;;
    clang)
        build_and_test "$1" -DCMAKE_CXX_COMPILER="${CLANG:-clang++}" -DRYE_WARNINGS=ON ;;
    *)
        echo "variants.sh: got $1, expected a name of the list in its first lines" >&2
        return 2 ;;
    esac
}

[ $# -gt 0 ] || set -- contract_off contract_fast sanitizers clang
for name in "$@"; do step "$name" variant "$name"; done
printf '\nAll %s variants passed, in %s s.\n' "$#" "$(seconds_since "$begin")"
