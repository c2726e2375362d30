#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# lanes.sh COMPILER FLAGS_FILE TESTS_DIR: the main kernels compile, without a warning, for sets of
# instructions that this machine may not have: 4 and 16 lanes; 16 lanes also without optimisation,
# where the compiler's AVX-512 headers are macros.
set -eu
flags=$(tr '\n' ' ' < "$2")
warnings="-Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Werror"
compile() {  # COMPILER ARCH SOURCE OPTIONS
    # shellcheck disable=SC2086 # the flags and options are several words
    $1 $flags "-march=$2" $4 $warnings "$3" ||
        { echo "$3 does not compile for $2 with $4"; exit 1; }
}
compile "$1" x86-64 "$3/instructions/kernels.cpp" "-O1 -fsyntax-only"
compile "$1" skylake-avx512 "$3/instructions/kernels.cpp" "-O1 -fsyntax-only"
# Those errors show only where code is made.
compile "$1" skylake-avx512 "$3/instructions/kernels.cpp" "-O0 -c -o /dev/null"
echo "the main kernels compile for 4 and 16 lanes, and for 16 without optimisation"
