#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# check.sh [--run] [FLAGS_FILE]: compiles the formulas of families.hpp for the device with nvcc,
# where there is one: $NVCC, of the PATH, or of /usr/local/cuda. Calls across the two sides and all
# warnings are errors: by default nvcc only warns of such a call and leaves its kernel empty. So no
# kernel may be without a store, either. $ARCHITECTURES is for which devices (sm_80).
# With --run, where there is a device, every kernel runs too, and its results are compared with the
# host's. FLAGS_FILE says where Eigen is: one argument a line; else it is /usr/include/eigen3.
set -eu
run=no
if [ "${1:-}" = --run ]; then
    run=yes
    shift
fi
here=$(cd "$(dirname "$0")" && pwd)
not_compiled="device_formulas: skipped, no nvcc is there, so the device formulas were not compiled"
. "$here/find_nvcc.sh"
# nvcc reads -isystem and its folder as two words.
includes="-isystem /usr/include/eigen3"
if [ $# -gt 0 ]; then includes=$(sed -n 's/^-isystem/-isystem /p' "$1" | tr '\n' ' '); fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Of Eigen's own headers alone: 20012, a mark on what is defaulted; 20015, a call without a place.
compile() {  # ARGUMENTS
    # shellcheck disable=SC2086 # the folders are several words
    "$nvcc" -std=c++20 -O2 -DNDEBUG -DEIGEN_DONT_PARALLELIZE -Werror all-warnings \
        -diag-suppress 20012,20015 -I"$here/../../include" $includes "$@" "$here/formulas.cu"
}

if [ $run = yes ]; then
    compile -arch=native -o "$work/formulas"
    "$work/formulas"
    exit
fi
for architecture in ${ARCHITECTURES:-sm_80}; do
    compile -arch="$architecture" -ptx -o "$work/formulas.ptx"
    awk -v architecture="$architecture" '
        /\.entry /   { entry = $0; stores = 0; ++kernels }
        /st\.global/ { ++stores }
        /^}/ && entry != "" {
            if (stores == 0) { print "an empty kernel: " entry; ++empty }
            entry = ""
        }
        END {
            printf "%s: %d kernels of device formulas, %d of them empty\n",
                architecture, kernels, empty
            exit empty > 0 || kernels == 0
        }' "$work/formulas.ptx"
done
