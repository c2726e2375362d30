#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# check.sh: builds everything with rye's warnings as errors, and runs every test.
set -eu
cd "$(dirname "$0")/.."
. cmake/steps.sh

build=${BUILD:-build/check}

step "Dependencies" sh cmake/install_dependencies.sh
step "Configure" configure "$build" -DRYE_WARNINGS=ON
step "Build everything" cmake --build "$build" --parallel "$jobs"
step "Test" ctest --test-dir "$build" --parallel "$jobs" --output-on-failure

printf '\nAll of it took %s s.\n' "$(seconds_since "$begin")"
