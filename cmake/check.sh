#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# check.sh [--all | --release]: builds with rye's warnings as errors, and tests. Without an option
# what a change must pass while one works on it, in twenty minutes on two processors; with --all
# most tests, the newest Eigen and xsimd, and 32-bit pointers; with --release all of them, and what
# takes hours: all processors, compilers and systems, numerical variants and sanitizers, README's
# first command and a release on bare systems. Ends with a list of what was not run, and why.
set -eu
cd "$(dirname "$0")/.."
. cmake/steps.sh

level=${1:-}
case $level in
"") set -- -DRYE_TESTS=quick -DRYE_BUILD_C=OFF -DRYE_BUILD_BENCHMARKS=OFF ;;
# Of the benchmarks it demands that they compile and link.
--all | --release)
    set -- -DRYE_TESTS="${level#--}" -DRYE_BUILD_C=ON -DRYE_BUILD_BENCHMARKS=ON \
        -DRYE_BENCHMARK_OPTIMISATION=-O0 ;;
*) echo "check.sh: got $level, expected --all, --release or nothing" >&2; exit 2 ;;
esac

build=${BUILD:-build/check}

step "Dependencies" sh cmake/install_dependencies.sh
step "Configure" configure "$build" -DRYE_WARNINGS=ON -DRYE_MERGE_UNITS=ON "$@"
step "Build" cmake --build "$build" --parallel "$jobs"
step "Test" ctest --test-dir "$build" --parallel "$jobs" --output-on-failure

# quickstart_on SUITE: README's first command on a bare system; one that cannot be made is named.
quickstart_on() {
    bare_log=$build/quickstart_$1.log
    if sh tests/bare.sh "$1" sh cmake/quickstart.sh > "$bare_log" 2>&1; then
        tail -n 12 "$bare_log"
    elif [ $? = 77 ]; then
        echo "skipped: quickstart on $1: $(tail -n 1 "$bare_log")" | tee -a "$build/all.log"
    else
        tail -n 30 "$bare_log"
        return 1
    fi
}

# What a version is published as, made and tried; parts that cannot be are named.
release_here() {
    sh tests/packaging/published.sh > "$build/published.log" 2>&1 || { tail -n 30 "$build/published.log"; return 1; }
    grep -vE '^(not run|not made)' "$build/published.log"
    sed -n 's/^not made/not run: release/p; /^not run/p' "$build/published.log" >> "$build/all.log"
}

# Tests say so in lines that begin with "not run", "skipped" or "NAME: skipped".
log=$build/Testing/Temporary/LastTest.log
: > "$build/all.log"
not_run() { echo "not run: $1" >> "$build/all.log"; }
case $level in
"") not_run "all other tests (check.sh --all)" ;;
--all) # what takes a minute
    step "Newer headers, 32-bit pointers" sh tests/portability.sh newest bits32 ;;
--release)
    step "Other processors, compilers and systems" sh tests/portability.sh
    step "Numerical variants and sanitizers" sh tests/variants.sh
    for suite in bookworm trixie; do
        step "README's first command on a bare $suite" quickstart_on "$suite"
    done
    step "A release, on bare systems" release_here ;;
esac
if [ "$level" != --release ]; then
    not_run "other processors, compilers and systems (tests/portability.sh; check.sh --release)"
    not_run "numerical variants and sanitizers (tests/variants.sh; check.sh --release)"
    not_run "README's first command on bare systems (check.sh --release)"
    not_run "a release and its first minutes (tests/packaging/published.sh; check.sh --release)"
fi
if left_out=$(grep -ihE '^(not run|skipped|[a-z_]+: skipped)[,:]? ' "$log" "$build/all.log" | sort -u)
then
    printf '\nNot run:\n%s\n' "$left_out"
else
    printf '\nNothing was left out.\n'
fi
printf '\nAll of it took %s s.\n' "$(seconds_since "$begin")"
