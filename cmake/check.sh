#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# check.sh: builds everything with rye's warnings as errors, and runs every test. Ends with a list of
# what this machine could not run, and why. Other processors: sh tests/portability.sh.
set -eu
cd "$(dirname "$0")/.."
. cmake/steps.sh

build=${BUILD:-build/check}

step "Dependencies" sh cmake/install_dependencies.sh
# Of the benchmarks it demands that they compile and link.
step "Configure" configure "$build" -DRYE_WARNINGS=ON -DRYE_MERGE_UNITS=ON \
    -DRYE_BENCHMARK_OPTIMISATION=-O0
step "Build everything" cmake --build "$build" --parallel "$jobs"
step "Test" ctest --test-dir "$build" --parallel "$jobs" --output-on-failure

# Tests say so in lines that begin with "not run", "skipped" or "NAME: skipped".
log=$build/Testing/Temporary/LastTest.log
if left_out=$(grep -ihE '^(not run|skipped|[a-z_]+: skipped)[,:]? ' "$log" | sort -u); then
    printf '\nNot run on this machine:\n%s\n' "$left_out"
else
    printf '\nNothing was left out.\n'
fi
printf '\nAll of it took %s s.\n' "$(seconds_since "$begin")"
