#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# run.sh BUILD_DIR [OUT.json [BASELINE.json]]: runs every benchmark of a build, gathers what they
# report in one JSON, and prints it as tables, beside a baseline if one is given. With PAGE set
# (docs/results/performance.md), the tables of ratios and counts replace those in that page. Also
# from the environment, to run a part:
#   QUESTIONS  the programs, without bench_ (default: all, and the compiler's times)
#   FILTER     their benchmarks, by a regular expression (default: all)
set -eu
build=$1
out=${2:-$build/benchmarks.json}
baseline=${3:-}
here=$(cd "$(dirname "$0")" && pwd)
parts=$(mktemp -d)
trap 'rm -rf "$parts"' EXIT

for question in ${QUESTIONS:-roofline splatting mlp convolution step primitives effects}; do
    echo "run.sh: $question" >&2
    "$build/benchmarks/bench_$question" --benchmark_out="$parts/$question.json" \
        --benchmark_out_format=json --benchmark_filter="${FILTER:-.}" > /dev/null
done
if [ -z "${QUESTIONS:-}" ]; then
    echo "run.sh: compile" >&2
    sh "$here/compile/compile.sh" "$here/../include" > "$parts/compile.md"
    sh "$here/compile/variants.sh" "$here/.." > "$parts/variants.md"
fi
python3 "$here/tables.py" "$out" "$baseline" "${PAGE:-}" "$parts"/*
