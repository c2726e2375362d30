#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# check.sh [--all]: builds everything with rye's warnings as errors, and runs every test. With --all
# also what takes hours: other processors, compilers and systems, numerical variants and sanitizers,
# README's first command on bare systems. Ends with a list of what was not run, and why.
set -eu
cd "$(dirname "$0")/.."
. cmake/steps.sh

all=${1:-}
case $all in
"" | --all) ;;
*) echo "check.sh: got $all, expected --all or nothing" >&2; exit 2 ;;
esac

build=${BUILD:-build/check}

step "Dependencies" sh cmake/install_dependencies.sh
# Of the benchmarks it demands that they compile and link.
step "Configure" configure "$build" -DRYE_WARNINGS=ON -DRYE_MERGE_UNITS=ON \
    -DRYE_BENCHMARK_OPTIMISATION=-O0
step "Build everything" cmake --build "$build" --parallel "$jobs"
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

# Tests say so in lines that begin with "not run", "skipped" or "NAME: skipped".
log=$build/Testing/Temporary/LastTest.log
: > "$build/all.log"
if [ "$all" = --all ]; then
    step "Other processors, compilers and systems" sh tests/portability.sh
    step "Numerical variants and sanitizers" sh tests/variants.sh
    for suite in bookworm trixie; do
        step "README's first command on a bare $suite" quickstart_on "$suite"
    done
else
    cat > "$build/all.log" << 'EOF'
not run: other processors, compilers and systems (sh tests/portability.sh; check.sh --all)
not run: numerical variants and sanitizers (sh tests/variants.sh; check.sh --all)
not run: README's first command on bare systems (check.sh --all)
EOF
fi
if left_out=$(grep -ihE '^(not run|skipped|[a-z_]+: skipped)[,:]? ' "$log" "$build/all.log" | sort -u)
then
    printf '\nNot run:\n%s\n' "$left_out"
else
    printf '\nNothing was left out.\n'
fi
printf '\nAll of it took %s s.\n' "$(seconds_since "$begin")"
