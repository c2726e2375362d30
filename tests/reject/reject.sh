#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# reject.sh COMPILER FLAGS_FILE SOURCE PRECOMPILED: SOURCE does not compile with -DREJECT=1; the error
# matches the pattern of its line "// expect: ...", is at most 25 lines long (or as many as
# "// lines: ..." says; the chains of includes depend on what is precompiled, and do not count), and
# begins in SOURCE itself. That all of them compile without their faults is checked by valid.sh.
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
echo "$said" | grep -Eq "$pattern" || { echo "$source: the error does not say: $pattern"; exit 1; }
lines=$(echo "$said" | grep -cvE '^(In file included| +) ?from ')
most=$(sed -n 's|^// lines: ||p' "$source")
most=${most:-25}
# g++ writes more about candidates since version 13.
[ "$($cxx -dumpversion | cut -d. -f1)" -lt 13 ] || most=$((most + 2))
[ "$lines" -le "$most" ] ||
    { echo "$source: the error takes $lines lines, at most $most"; exit 1; }
case $said in
    "$source"*) ;;
    *) echo "$source: the error begins elsewhere"; exit 1 ;;
esac
