#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# peers.sh OPENSPLAT [WORK]: compiles rye and OpenSplat's rasterizer of the CPU, from its clone in
# OPENSPLAT, by the same compiler and flags, and times both on the scenes of bench_splatting, in turn
# and with one thread each (against_peer.cpp). Results lie in WORK (build/splatting_peers). Ends with
# 77 where libtorch is missing. From the environment:
#   TORCH    the folder above libtorch's include and lib (/usr)
#   ROUNDS   how often each is timed (7)
#   CXX      the compiler (g++), EIGEN the folder of Eigen (/usr/include/eigen3)
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$here/../../..
[ $# -ge 1 ] || { echo "usage: peers.sh OPENSPLAT [WORK]" >&2; exit 2; }
peer=$(cd "$1" && pwd)
work=${2:-$root/build/splatting_peers}
torch=${TORCH:-/usr}
cxx=${CXX:-g++}
eigen=${EIGEN:-/usr/include/eigen3}

for file in project_gaussians.cpp rasterize_gaussians.cpp rasterizer/gsplat-cpu/gsplat_cpu.cpp; do
    [ -f "$peer/$file" ] || { echo "peers.sh: no $file in $peer, expected a clone of OpenSplat" >&2; exit 2; }
done
library=$(find "$torch/lib" "$torch/lib/$(uname -m)-linux-gnu" -maxdepth 1 -name libtorch.so 2> /dev/null | head -n 1)
if [ -z "$library" ] || [ ! -d "$torch/include/torch" ]; then
    echo "not run: peers of the rasterizer: no libtorch below $torch (Debian package libtorch-dev); name its folder in TORCH"
    exit 77
fi
libraries=$(dirname "$library")

mkdir -p "$work"
optimised="-O3 -march=native -DNDEBUG"
commit=$(git -C "$peer" rev-parse --short HEAD 2> /dev/null || echo unknown)
objects=
for source in "$peer/project_gaussians.cpp" "$peer/rasterize_gaussians.cpp" \
    "$peer/rasterizer/gsplat-cpu/gsplat_cpu.cpp" "$here/opensplat.cpp"; do
    object=$work/$(basename "$source" .cpp).o
    objects="$objects $object"
    # shellcheck disable=SC2086 # a list of options
    "$cxx" -std=c++17 $optimised -w "-DPEER_COMMIT=\"$commit\"" -isystem "$torch/include" \
        -isystem "$torch/include/torch/csrc/api/include" -I"$peer" -I"$peer/rasterizer" -c "$source" -o "$object"
done
# shellcheck disable=SC2086 # likewise
"$cxx" -std=c++20 $optimised -I"$root/include" -isystem "$eigen" -c "$here/against_peer.cpp" \
    -o "$work/against_peer.o"
# shellcheck disable=SC2086 # a list of objects
"$cxx" $objects "$work/against_peer.o" -o "$work/against_peer" "-L$libraries" "-Wl,-rpath,$libraries" \
    -Wl,--allow-shlib-undefined -Wl,--no-as-needed -ltorch -ltorch_cpu -lc10 -pthread
OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 "$work/against_peer" "${ROUNDS:-7}"
