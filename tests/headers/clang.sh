#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# clang.sh COMPILER FLAGS_FILE ALL_HEADERS: a second compiler reads every header without a warning,
# and without OpenMP, which it may not have.
set -eu
flags=$(grep -v openmp "$2" | tr '\n' ' ')
# shellcheck disable=SC2086 # the flags are several words
$1 $flags -fsyntax-only -Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Werror -x c++ "$3" \
    -Wno-pragma-once-outside-header
echo "$("$1" --version | head -n 1) reads every header"
