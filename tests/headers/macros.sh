#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# macros.sh COMPILER FLAGS_FILE INCLUDE_DIR: including all of rye defines no macro but RYE_*, beyond
# what the headers of others that it includes define.
set -eu
cxx=$1
flags=$(tr '\n' ' ' < "$2")
include=$3
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

find "$include/rye" -name '*.hpp' | sort > "$work/files"
xargs sed -n 's/^ *# *include *\(<[^>]*>\).*/\1/p' < "$work/files" | sort -u > "$work/included"
grep -v '^<rye/' "$work/included" |     # some are of other systems
    sed 's/.*/#if __has_include(&)\n#include &\n#endif/' > "$work/foreign.cpp"
sed "s|^$include/\(.*\)|#include <\1>|" "$work/files" > "$work/rye.cpp"

for unit in foreign rye; do
    # shellcheck disable=SC2086 # the flags are several words
    $cxx $flags -E -dM -x c++ "$work/$unit.cpp" > "$work/$unit.defines"
    awk '{ sub(/\(.*/, "", $2); print $2 }' "$work/$unit.defines" | sort -u > "$work/$unit.macros"
done
leaked=$(comm -13 "$work/foreign.macros" "$work/rye.macros" | grep -v '^RYE_' || true)
if [ -n "$leaked" ]; then
    echo "macros that leak out of rye:"
    echo "$leaked"
    exit 1
fi
echo "macros of rye: $(grep -c '^RYE_' "$work/rye.macros"), leaked: none"
