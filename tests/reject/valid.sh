#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# valid.sh COMPILER FLAGS_FILE FOLDER: the sources of this folder compile without their faults, all in
# one unit: each in a namespace of its own, after the headers that any of them includes.
set -eu
flags=$(tr '\n' ' ' < "$2")
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$3"
{
    sed -n 's/^ *# *include *<.*/&/p' "$here"/*.cpp | sort -u
    echo '#define REJECT 0'
    for source in "$here"/*.cpp; do
        echo "namespace reject_$(basename "$source" .cpp) {"
        echo "#include \"$source\""
        echo '}'
    done
} > "$3/valid.cpp"
# shellcheck disable=SC2086 # the flags are several words
$1 $flags -fsyntax-only -Wall -Wextra -Werror "$3/valid.cpp"
echo "$(ls "$here"/*.cpp | wc -l) sources compile without their faults"
