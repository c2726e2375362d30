#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# reject.sh COMPILER FLAGS_FILE SOURCE PRECOMPILED: SOURCE does not compile with -DREJECT=1; the error
# matches the pattern of its line "// expect: ..." in its first ten lines, names a line of SOURCE in
# its first three, and is at most 25 lines long (or as many as "// lines: ..." says). Chains of
# includes depend on what is precompiled, and do not count. That all sources compile without their
# faults is checked by valid.sh.
set -eu
cxx=$1
flags=$(tr '\n' ' ' < "$2")
source=$3
pattern=$(sed -n 's|^// expect: ||p' "$source")
[ -n "$pattern" ] || { echo "$source: no line // expect:"; exit 1; }
# shellcheck disable=SC2086 # the flags are several words
if said=$($cxx $flags -include "$4/eigen.hpp" -fsyntax-only -DREJECT=1 "$source" 2>&1); then
    echo "$source: compiles with the fault"
    exit 1
fi
echo "$said"
own=$(echo "$said" | grep -vE '^(In file included| +) ?from ')
echo "$own" | head -n 10 | grep -Eq "$pattern" ||
    { echo "$source: the first ten lines do not say: $pattern"; exit 1; }
echo "$own" | head -n 3 | grep -Fq "$source:" ||
    { echo "$source: the first three lines name no line of it"; exit 1; }
lines=$(echo "$own" | wc -l)
most=$(sed -n 's|^// lines: ||p' "$source")
most=${most:-25}
# g++ writes more about candidates since version 13.
[ "$($cxx -dumpversion | cut -d. -f1)" -lt 13 ] || most=$((most + 2))
[ "$lines" -le "$most" ] ||
    { echo "$source: the error takes $lines lines, at most $most"; exit 1; }
