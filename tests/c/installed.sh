#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# installed.sh SOURCE_DIR BUILD_DIR CMAKE GENERATOR: the C lesson as a project of a user's, with an
# installed rye_c: by find_package, without a C++ compiler; by pkg-config, shared and static.
set -eu
source=$1 build=$2 cmake=$3 generator=$4
work=$build/tests/c_installed
rm -rf "$work"
mkdir -p "$work/project"
lesson=$source/examples/09_draw_from_c.c
"$cmake" --install "$build" --prefix "$work/prefix" --component c > "$work/install.txt"
cat > "$work/project/CMakeLists.txt" << EOF
cmake_minimum_required(VERSION 3.20)
project(client LANGUAGES C)
find_package(rye_c 0.2 REQUIRED)
add_executable(client $lesson)
target_link_libraries(client PRIVATE rye::c m)
EOF
"$cmake" -S "$work/project" -B "$work/build" -G "$generator" -DCMAKE_PREFIX_PATH="$work/prefix"
"$cmake" --build "$work/build"
"$work/build/client"

command -v pkg-config > /dev/null || { echo "not run: rye_c by pkg-config, which is absent"; exit 0; }
PKG_CONFIG_PATH=$(dirname "$(find "$work/prefix" -name rye_c.pc)")
export PKG_CONFIG_PATH
folder=$(pkg-config --variable=libdir rye_c)
# shellcheck disable=SC2046 # lists of options
cc -std=c11 "$lesson" $(pkg-config --cflags --libs rye_c) -Wl,-rpath,"$folder" -lm -o "$work/shared"
"$work/shared"
# shellcheck disable=SC2046 # lists of options
cc -std=c11 "$lesson" $(pkg-config --static --cflags rye_c) -DRYE_C_STATIC "$folder/librye_c.a" \
    $(pkg-config --static --libs-only-l rye_c | sed 's/-lrye_c//') -lm -o "$work/static"
"$work/static"
