#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# alone.sh COMPILER FLAGS_FILE INCLUDE_DIR PRECOMPILED: every header compiles by itself, twice in a
# row, without a warning. Two at a time; only the syntax, so that the whole is quick. A header that
# includes Eigen/Core, itself or through others, finds it parsed before (PRECOMPILED/eigen.hpp).
set -eu
RYE_CXX=$1
RYE_FLAGS=$(tr '\n' ' ' < "$2")
RYE_EIGEN=$4/eigen.hpp
RYE_WARNINGS="-Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Werror"
export RYE_CXX RYE_FLAGS RYE_EIGEN RYE_WARNINGS
cd "$3"
# Lines "HEADER 1" or "HEADER 0": whether Eigen is reached. A file says what it includes; what is
# reached by one file is reached by those that include it.
# shellcheck disable=SC2016 # awk and the inner shell expand these
find rye -name '*.hpp' | sort | xargs awk '
    FNR == 1 { order[++files] = FILENAME }
    /^ *# *include *</ {
        split($0, part, /[<>]/)
        if (part[2] ~ /^Eigen\//) reached[FILENAME] = 1
        if (part[2] ~ /^rye\//) { from[++edges] = FILENAME; to[edges] = part[2] }
    }
    END {
        for (more = 1; more;) {
            more = 0
            for (i = 1; i <= edges; ++i)
                if (reached[to[i]] && !reached[from[i]]) { reached[from[i]] = 1; more = 1 }
        }
        for (i = 1; i <= files; ++i) print order[i], reached[order[i]] + 0
    }' | xargs -P 2 -n 2 sh -c '
    first=; if [ "$2" = 1 ]; then first="-include $RYE_EIGEN"; fi
    printf "#include <%s>\n#include <%s>\n" "$1" "$1" |
        $RYE_CXX $RYE_FLAGS $first -fsyntax-only $RYE_WARNINGS -x c++ - ||
        { echo "does not compile alone: $1"; exit 1; }' sh
echo "$(find rye -name '*.hpp' | wc -l) headers compile alone"
