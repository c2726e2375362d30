#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# lanes.sh COMPILER FLAGS_FILE TESTS_DIR: the main kernels compile, without a warning, for sets of
# instructions that this machine may not have: 4 and 16 lanes, and products of bfloat16. With -O1:
# without it the compiler's AVX-512 headers are macros, which xsimd 8.1 does not go with.
set -eu
flags=$(tr '\n' ' ' < "$2")
warnings="-Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Werror"
compile() {  # COMPILER ARCH SOURCE
    # shellcheck disable=SC2086 # the flags are several words
    $1 $flags "-march=$2" -O1 -fsyntax-only $warnings "$3" ||
        { echo "$3 does not compile for $2"; exit 1; }
}
compile "$1" x86-64 "$3/instructions/kernels.cpp"
compile "$1" skylake-avx512 "$3/instructions/kernels.cpp"
compile "$1" sapphirerapids "$3/nn/product_test.cpp"
echo "the main kernels compile for 4 and 16 lanes"
