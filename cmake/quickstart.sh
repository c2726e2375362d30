#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# quickstart.sh: from a bare machine to an avatar whose eyes turn. Builds the program `rye`, makes a
# small capture of a procedural head, trains an avatar from it, renders a sweep of gazes and
# evaluates the frames that were not trained on. Results lie in quickstart/, which it replaces.
set -eu
cd "$(dirname "$0")/.."
. cmake/steps.sh

build=build/quickstart
out=quickstart
rye=$build/rye

step "Dependencies" sh cmake/install_dependencies.sh
step "Configure" configure "$build" -DRYE_MERGE_UNITS=ON -DRYE_BUILD_TESTS=OFF -DRYE_BUILD_EXAMPLES=OFF \
    -DRYE_BUILD_BENCHMARKS=OFF -DRYE_BUILD_C=OFF
mkdir -p "$out"
step "Build what draws the made-up head" cmake --build "$build" --parallel "$jobs" --target rye_portrait
step "Draw it: $out/portrait.png" "$build/portrait" "$out/portrait.png"
step "Build the program rye" cmake --build "$build" --parallel "$jobs"

rm -rf "$out/capture" "$out/run"
step "Make a capture" "$rye" capture --out "$out/capture" --cameras 9
step "Train an avatar" "$rye" train --capture "$out/capture" --out "$out/run" --preset tiny
step "Render a sweep of gazes" "$rye" redirect --run "$out/run" --sweep --out "$out/sweep.png"
step "Evaluate the frames kept aside" \
    "$rye" evaluate --run "$out/run" --capture "$out/capture" --split test

printf '\nAll of it took %s s. The pictures:\n' "$(seconds_since "$begin")"
find "$out" -name '*.png' ! -path "$out/capture/*" | sort
