#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# reject.sh COMPILER FLAGS_FILE SOURCE: SOURCE compiles with -DREJECT=0 and not with -DREJECT=1;
# then the error matches the pattern of its line "// expect: ...", is at most 25 lines long (or as
# many as "// lines: ..." says), and begins in SOURCE itself.
set -eu
cxx=$1
flags=$(tr '\n' ' ' < "$2")
source=$3
pattern=$(sed -n 's|^// expect: ||p' "$source")
[ -n "$pattern" ] || { echo "$source: no line // expect:"; exit 1; }
# shellcheck disable=SC2086 # the flags are several words
$cxx $flags -fsyntax-only -Wall -Wextra -Werror -DREJECT=0 "$source" ||
    { echo "$source: must compile without the fault"; exit 1; }
# shellcheck disable=SC2086
if said=$($cxx $flags -fsyntax-only -DREJECT=1 "$source" 2>&1); then
    echo "$source: compiles with the fault"
    exit 1
fi
echo "$said"
echo "$said" | grep -Eq "$pattern" || { echo "$source: the error does not say: $pattern"; exit 1; }
lines=$(echo "$said" | wc -l)
most=$(sed -n 's|^// lines: ||p' "$source")
[ "$lines" -le "${most:-25}" ] ||
    { echo "$source: the error takes $lines lines, at most ${most:-25}"; exit 1; }
case $said in
    "$source"*) ;;
    *) echo "$source: the error begins elsewhere"; exit 1 ;;
esac
