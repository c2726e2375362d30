#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# doxygen.sh SOURCE WORK [FOLDER...]: every name of namespace rye in the headers has a docstring: types,
# concepts, functions, aliases, constants, by Doxygen's own warnings; and no docstring has a fault. Not
# asked for: members and types inside of types, which these describe; specialisations and
# deduction guides, which are the primary template's. Nothing is asked of the FOLDERs named.
set -eu
source=$1 work=$2
shift 2
command -v doxygen > /dev/null || { echo "not run: docstrings, for there is no doxygen"; exit 77; }
rm -rf "$work"
mkdir -p "$work"
sed -e "s|@SOURCE@|$source|; s|@WORK@|$work|; s|@VERSION@||" "$source/docs/site/Doxyfile.in" \
    > "$work/Doxyfile"
doxygen "$work/Doxyfile" > "$work/said.txt" 2>&1 || { cat "$work/said.txt"; exit 1; }
names=$(grep -c . "$work/warnings.txt" || true)
# "Compound rye::NAME" and "Member NAME ... of namespace rye"; a specialisation has "<" in its name.
grep -E 'warning: (Compound [a-z]+::[^<:]*|Member .* of (namespace|file) .*) is not documented' \
    "$work/warnings.txt" | grep -vE -- ' -> |Member [A-Za-z_]+< ' > "$work/undocumented.txt" || true
grep -v 'is not documented' "$work/warnings.txt" | grep . > "$work/faults.txt" || true
for folder in "$@"; do
    left=$(grep -c "/include/rye/$folder/" "$work/undocumented.txt" || true)
    echo "not run: docstrings of $folder/, of which $left names have none"
    sed -i "\\|/include/rye/$folder/|d" "$work/undocumented.txt"
done
bad=$(cat "$work/undocumented.txt" "$work/faults.txt" | wc -l)
if [ "$bad" -gt 0 ]; then
    sed "s|^$source/||" "$work/undocumented.txt" "$work/faults.txt"
    echo "$bad names without a docstring, or with one that has a fault"
    exit 1
fi
[ "$names" -gt 0 ] || { echo "doxygen has looked at nothing"; exit 1; }
echo "every name of namespace rye has a docstring"
