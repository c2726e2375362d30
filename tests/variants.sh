#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# variants.sh [NAME...]: builds the tests of numbers (hard cases, laws of derivatives, math,
# autodiff, geometry, gaussian, splat) in each of the ways below and runs them, with denormals
# flushed to zero and without. A way takes several minutes to build, so no ctest runs this.
#   contract_off   -march=x86-64-v3 -ffp-contract=off: no product is fused
#   contract_fast  -march=x86-64-v3 -ffp-contract=fast: every product may be
#   sanitizers     the address and undefined-behaviour sanitizers, at -O1, fewer draws; the program's
#                  whole pipeline too (tests/programs/pipeline.sh)
#   clang          clang++ (or the compiler named by CLANG)
#   clang_sanitizers  as sanitizers, by clang++, whose undefined-behaviour sanitizer finds more
# A sanitizer's first report ends the test.
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
sanitized() { # NAME FLAGS CMAKE_OPTIONS...: the numerical tests, then the pipeline
    name=$1 flags="-fno-sanitize-recover=all -g1 $2"; shift 2
    build_and_test "$name" -DRYE_LAW_DRAWS=500 "-DCMAKE_CXX_FLAGS=$flags" "$@" &&
    pipeline_of "${BUILD:-build/variants}/$name/program" "$flags" "$@"
}
pipeline_of() { # BUILD FLAGS CMAKE_OPTIONS...
    build=$1 flags=$2; shift 2
    configure "$build" -DCMAKE_BUILD_TYPE=None "-DCMAKE_CXX_FLAGS=-O1 $flags" -DRYE_OPENMP=OFF \
        -DRYE_BUILD_EXAMPLES=OFF -DRYE_BUILD_BENCHMARKS=OFF "$@" &&
    cmake --build "$build" --parallel "$jobs" --target rye_program corrupt &&
    sh tests/programs/pipeline.sh "$PWD/$build/rye" "$PWD/$build/tests/corrupt" \
        "$PWD/$build/pipeline"
}

variant() {
    case $1 in
    contract_off | contract_fast)
        build_and_test "$1" -DRYE_NATIVE=OFF \
            -DCMAKE_CXX_FLAGS="-march=x86-64-v3 -ffp-contract=${1#contract_}" ;;
    sanitizers) sanitized "$1" "-fsanitize=address,undefined" ;;
    clang_sanitizers)
        sanitized "$1" "-fsanitize=address,undefined" -DCMAKE_CXX_COMPILER="${CLANG:-clang++}" ;;
    clang)
        build_and_test "$1" -DCMAKE_CXX_COMPILER="${CLANG:-clang++}" -DRYE_WARNINGS=ON ;;
    *)
        echo "variants.sh: got $1, expected a name of the list in its first lines" >&2
        return 2 ;;
    esac
}

[ $# -gt 0 ] || set -- contract_off contract_fast sanitizers clang clang_sanitizers
for name in "$@"; do step "$name" variant "$name"; done
printf '\nAll %s variants passed, in %s s.\n' "$#" "$(seconds_since "$begin")"
