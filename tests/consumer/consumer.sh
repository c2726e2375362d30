#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# consumer.sh WAY SOURCE_DIR BUILD_DIR CMAKE GENERATOR COMPILER [RYE]: a project of a user's, which
# gets rye by WAY (find_package or pkg_config after an install, add_subdirectory or fetch_content),
# builds the program that README.md shows, and runs it. By find_package also the programs with a
# user's own parts; with the program RYE one more, which trains on a capture that RYE makes.
set -eu
way=$1 source=$2 build=$3 cmake=$4 generator=$5 cxx=$6 rye=${7:-}
work=$build/tests/consumer_$way
rm -rf "$work"
mkdir -p "$work/project"
cp "$source/tests/consumer/CMakeLists.txt" "$work/project/"
awk '/^```cpp/ { inside = 1; next } /^```/ { if (inside) exit } inside' "$source/README.md" \
    > "$work/project/main.cpp"
[ -s "$work/project/main.cpp" ] || { echo "README.md shows no C++ program"; exit 1; }
if [ "$way" = find_package ]; then
    cp "$source/tests/consumer/redirect.cpp" "$source/tests/consumer/parts.cpp" "$work/project/"
    [ -z "$rye" ] || cp "$source/examples/12_train_my_part.cpp" "$work/project/"
    # The skeletons of the page, of which parts.cpp makes an avatar.
    awk '/^## / { there = $2 == "Skeletons" } /^```/ { inside = !inside; next } there && inside' \
        "$source/docs/parts.md" > "$work/project/skeletons.hpp"
    [ -s "$work/project/skeletons.hpp" ] || { echo "docs/parts.md shows no skeletons"; exit 1; }
    "$cmake" --install "$build" --prefix "$work/prefix" --component Unspecified > "$work/install.txt"
fi
if [ "$way" = pkg_config ]; then
    "$cmake" --install "$build" --prefix "$work/prefix" --component Unspecified > "$work/install.txt"
    PKG_CONFIG_PATH=$(dirname "$(find "$work/prefix" -name rye.pc)")
    export PKG_CONFIG_PATH
    flags=$(pkg-config --cflags --libs rye)
    wanted="-O2 -Wall -Wextra -Werror"
    if "$cxx" -march=native -fsyntax-only -x c++ /dev/null; then wanted="$wanted -march=native"; fi
    echo "$cxx -std=c++20 $wanted main.cpp $flags"
    # shellcheck disable=SC2086 # a list of options
    "$cxx" -std=c++20 $wanted "$work/project/main.cpp" $flags -o "$work/consumer"
    "$work/consumer"
    exit 0
fi
"$cmake" -S "$work/project" -B "$work/build" -G "$generator" -DCMAKE_CXX_COMPILER="$cxx" \
    -DCMAKE_BUILD_TYPE=Release -DCMAKE_PREFIX_PATH="$work/prefix" -DWAY="$way" -DRYE_SOURCE="$source"
"$cmake" --build "$work/build"
cd "$work/build"
./consumer
[ "$way" = find_package ] || exit 0
./redirect
./parts
[ -n "$rye" ] || exit 0
"$rye" capture --out capture --frames 2 --test-frames 0 --apart-frames 0 --cameras 3 --size 64 --samples 1 --png --quiet
./12_train_my_part capture
! ./12_train_my_part missing 2> said.txt || { echo "12_train_my_part reads what is not there"; exit 1; }
grep -q "missing: no such folder" said.txt || { cat said.txt; exit 1; }
