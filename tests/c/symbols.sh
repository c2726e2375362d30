#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# symbols.sh LIBRARY HEADER: the shared library defines every function that the header declares, and
# shows nothing else: no name of C++ can meet one of a program's.
set -eu
declared=$(grep -o '^RYE_API.*' "$2" | grep -o 'rye_[a-z_]*(' | tr -d '(' | sort)
shown=$(nm -D --defined-only "$1" | awk '$2 != "A" { sub(/@.*/, "", $3); print $3 }' | sort)
[ -n "$declared" ] || { echo "no functions in $2"; exit 1; }
if [ "$declared" != "$shown" ]; then
    printf 'declared:\n%s\nshown:\n%s\n' "$declared" "$shown"
    exit 1
fi
echo "$(printf '%s\n' "$shown" | wc -l) functions, and nothing else"
