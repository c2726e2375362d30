#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# run.sh [MINUTES] [TARGET...]: gives the fuzz targets what is kept (seeds, crashes), then searches for
# MINUTES each, and prints executions, crashes and seconds of each. Fails where there was a crash.
# The environment may set
#   BIN           folder of programs that are built already (fuzz_*, seeds), as on another machine;
#                 without it they are built with clang in BUILD (build/fuzz)
#   JOBS          processes at a time, by default one for each processor. More than there are targets
#                 are shared among them, so that a target may have several, on one corpus
#   SECONDS_EACH  instead of MINUTES
#   OUT           folder of corpora, logs and crashes, kept between runs (BUILD/out)
#   TIMEOUT       seconds that one input may take (1)
#   LOADER        what the programs are started by, such as a dynamic loader brought to a machine
#                 whose own C library is older
set -eu
here=$(cd "$(dirname "$0")" && pwd)
minutes=${1:-0}
[ $# -eq 0 ] || shift
seconds=${SECONDS_EACH:-$((minutes * 60))}
targets=${*:-ply splats bases gltf npy npz safetensors avatar capture config transforms picture cameras drivers frames sources checkpoint experiments import_record expression_shapes flame_params lpips corrected_cameras}
build=${BUILD:-$here/../../build/fuzz}
jobs=${JOBS:-$(nproc)}

if [ -z "${BIN:-}" ]; then
    [ -n "${CXX:-}" ] || CXX=$(command -v clang++ || command -v clang++-14) || {
        echo "run.sh: no clang++, which has libFuzzer; or name a folder of programs in BIN" >&2
        exit 77
    }
    options=
    ! command -v ninja > /dev/null || options=-GNinja
    ! command -v ccache > /dev/null || options="$options -DCMAKE_CXX_COMPILER_LAUNCHER=ccache"
    mkdir -p "$build"
    # shellcheck disable=SC2086 # a list of options
    cmake -S "$here" -B "$build" $options -DCMAKE_CXX_COMPILER="$CXX" \
        > "$build/configure.log" 2>&1 ||
        { cat "$build/configure.log"; exit 1; }
    cmake --build "$build" --parallel "$jobs" > "$build/build.log" 2>&1 ||
        { cat "$build/build.log"; exit 1; }
    BIN=$build
fi
BIN=$(cd "$BIN" && pwd)
out=${OUT:-$BIN/out}
mkdir -p "$out"
out=$(cd "$out" && pwd)
# Written once, not by each of the processes that this script starts.
# shellcheck disable=SC2086 # a program and its options
[ "${RYE_FUZZ_ONE:-}" ] || ${LOADER:-} "$BIN/seeds" "$out/seeds"

# An input may ask for no more memory than it can hold: packed a thousandfold, and in a picture each
# bit a pixel of 3 or 4 bytes.
limits() {
    case $1 in
        picture) echo "-max_len=2048 -malloc_limit_mb=80" ;;
        avatar) echo "-max_len=65536 -malloc_limit_mb=32" ;;
        checkpoint) echo "-max_len=131072 -malloc_limit_mb=32" ;;
        npz | splats | expression_shapes | flame_params) echo "-max_len=8192 -malloc_limit_mb=32" ;;
        *) echo "-max_len=8192 -malloc_limit_mb=16" ;;
    esac
}

# one TARGET PROCESS SECONDS: the search of one process.
one() {
    mkdir -p "$out/corpus/$1" "$out/crashes/$1"
    set -- "$1" "$2" "$3" "$out/corpus/$1" "$out/seeds/$1"
    [ ! -d "$here/crashes/$1" ] || set -- "$@" "$here/crashes/$1"
    target=$1 process=$2 search=$3
    shift 3
    # shellcheck disable=SC2046,SC2086 # lists of options
    ${LOADER:-} "$BIN/fuzz_$target" $(limits "$target") -max_total_time="$search" -timeout="${TIMEOUT:-1}" \
        -rss_limit_mb=2048 -dict="$out/seeds/$target.dict" -print_final_stats=1 -verbosity=1 \
        -artifact_prefix="$out/crashes/$target/" "$@" > "$out/$target-$process.log" 2>&1 ||
        echo "$target: crash, see $out/$target-$process.log" >&2
}

if [ "${RYE_FUZZ_ONE:-}" ]; then
    # shellcheck disable=SC2086 # three words
    one $RYE_FUZZ_ONE
    exit 0
fi

count=$(echo "$targets" | wc -w)
each=$((jobs / count))
[ "$each" -ge 1 ] || each=1
rm -rf "$out"/*.log "$out/crashes"
# At least one input each, even where no search is wanted: what is kept is read before it begins.
[ "$seconds" -ge 1 ] || seconds=1
for process in $(seq "$each"); do
    for target in $targets; do echo "$target $process $seconds"; done
done > "$out/list"
begin=$(date +%s)
export BIN OUT="$out" TIMEOUT="${TIMEOUT:-1}"
tr '\n' '\0' < "$out/list" |
    xargs -0 -P "$jobs" -I{} env RYE_FUZZ_ONE={} sh "$here/run.sh" "$minutes"

awk -v targets="$targets" -v out="$out" '
    BEGIN {
        n = split(targets, name, " ")
        printf "%-17s %9s %14s %10s %8s %8s %8s\n", "target", "processes", "executions", "a second",
            "crashes", "seconds", "corpus"
        for (i = 1; i <= n; ++i) {
            t = name[i]; runs = 0; each = 0; slowest = 0; processes = 0
            while ((("ls " out "/" t "-*.log") | getline log_file) > 0) {
                ++processes
                while ((getline line < log_file) > 0) {
                    split(line, word, ":")
                    if (line ~ /^stat::number_of_executed_units/) runs += word[4]
                    if (line ~ /^Done .* runs in/) { split(line, done, " "); each = done[5] }
                }
            }
            crashes = 0
            while ((("ls " out "/crashes/" t) | getline f) > 0) ++crashes
            corpus = 0
            while ((("ls " out "/corpus/" t) | getline f) > 0) ++corpus
            printf "%-17s %9d %14d %10d %8d %8d %8d\n", t, processes, runs,
                (each > 0 ? runs / each : 0), crashes, each, corpus
            all += runs; bad += crashes
            if (runs == 0 || each == 0) ++bad
        }
        printf "%d executions, %d crashes\n", all, bad
        exit bad > 0
    }' && status=0 || status=1
echo "all of it took $(($(date +%s) - begin)) s"
[ "$status" = 0 ] || echo "inputs that crash: $(find "$out/crashes" -type f | head -40)"
exit "$status"
