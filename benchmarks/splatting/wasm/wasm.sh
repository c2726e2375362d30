#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# wasm.sh WORK [ROOT...]: times the head of bench_splatting in WebAssembly, compiled as the gaze page
# is (examples/gaze_page/build.sh), on one thread of node: by the headers of each ROOT, a work tree
# of rye (this one), in turn (times.js). Results lie in WORK. Ends with 77 where emscripten or node is
# missing. From the environment:
#   AVATAR   a file of `rye export`: its frames are timed as well, by the page that each ROOT builds
#   ROUNDS   how often each is timed (31)
#   EIGEN, XSIMD   folders of these
set -eu
here=$(cd "$(dirname "$0")" && pwd)
[ $# -ge 1 ] || { echo "usage: wasm.sh WORK [ROOT...]" >&2; exit 2; }
mkdir -p "$1"
work=$(cd "$1" && pwd)
shift
[ $# -ge 1 ] || set -- "$here/../../.."
for need in em++ node; do
    command -v $need > /dev/null || { echo "not run: times in WebAssembly: no $need"; exit 77; }
done
page=$here/../../../examples/gaze_page
NODE_PATH=${NODE_PATH:-}${NODE_PATH:+:}/usr/share/nodejs
export NODE_PATH

mkdir -p "$work/headers"
ln -sfn "${XSIMD:-/usr/include/xsimd}" "$work/headers/xsimd"
flags="-O2 -msimd128 -msse4.1 -fwasm-exceptions -DNDEBUG -DEIGEN_DONT_VECTORIZE -DEIGEN_DONT_PARALLELIZE"
flags="$flags -include $page/simd.h -isystem $work/headers -isystem ${EIGEN:-/usr/include/eigen3}"
n=0
for root; do
    n=$((n + 1))
    # shellcheck disable=SC2086 # a list of options
    {
        em++ -std=c++20 -pthread $flags "-I$root/include" -c "$here/head.cpp" -o "$work/head$n.o"
        em++ $flags "$work/head$n.o" -o "$work/head$n.js" -sALLOW_MEMORY_GROWTH=1 -sSINGLE_FILE=1 \
            -sINITIAL_MEMORY=67108864 -sENVIRONMENT=node -sMODULARIZE=1 -sNODEJS_CATCH_EXIT=0
    }
    [ -z "${AVATAR:-}" ] || sh "$root/examples/gaze_page/build.sh" - "$work/page$n" > "$work/page$n.txt"
    echo "$n: $(git -C "$root" describe --always --dirty 2> /dev/null || echo "$root")"
done
node "$here/times.js" "$work" "$n" ${AVATAR:+"$AVATAR"}
