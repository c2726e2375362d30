#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# alone.sh COMPILER FLAGS_FILE INCLUDE_DIR: every header compiles by itself, twice in a row, without
# a warning. Two at a time; only the syntax, so that the whole is quick.
set -eu
RYE_CXX=$1
RYE_FLAGS=$(tr '\n' ' ' < "$2")
RYE_WARNINGS="-Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Werror"
export RYE_CXX RYE_FLAGS RYE_WARNINGS
cd "$3"
# shellcheck disable=SC2016 # the inner shell expands these
find rye -name '*.hpp' | sort | xargs -P 2 -I '{}' sh -c '
    printf "#include <%s>\n#include <%s>\n" "$1" "$1" |
        $RYE_CXX $RYE_FLAGS -fsyntax-only $RYE_WARNINGS -x c++ - ||
        { echo "does not compile alone: $1"; exit 1; }' sh '{}'
echo "$(find rye -name '*.hpp' | wc -l) headers compile alone"
