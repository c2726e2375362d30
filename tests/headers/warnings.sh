#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# warnings.sh COMPILER FLAGS_FILE README FOLDER OPTIONS...: the program of README.md, compiled with
# -Wall -Wextra and each of OPTIONS, gives no warning: neither of rye, nor of Eigen, xsimd and
# the compiler's own headers, though these are no system folders to a user who gives them by -I.
set -eu
cxx=$1
flags=$(sed 's/^-isystem/-I/' "$2" | tr '\n' ' ')
readme=$3
work=$4
shift 4
mkdir -p "$work"
awk '/^```cpp/ { inside = 1; next } /^```/ { if (inside) exit } inside' "$readme" > "$work/main.cpp"
[ -s "$work/main.cpp" ] || { echo "README.md shows no C++ program"; exit 1; }
bad=0
for way in "$@"; do
    # shellcheck disable=SC2086 # a list of options
    $cxx $flags -I/usr/include/eigen3 -Wall -Wextra $way -c "$work/main.cpp" \
        -o "$work/main.o" 2> "$work/said.txt" || { cat "$work/said.txt"; exit 1; }
    found=$(grep -c 'warning:' "$work/said.txt") || true
    echo "-Wall -Wextra $way: $found warnings"
    [ "$found" = 0 ] || { grep 'warning:' "$work/said.txt" | sort | uniq -c | head -n 5; bad=1; }
done
exit $bad
