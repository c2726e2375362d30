#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# versions.sh SOURCE_DIR BUILD_DIR CMAKE GENERATOR COMPILER: a user's project is configured beside
# packages of Eigen and xsimd of several versions, which hold nothing else: newer major versions are
# taken, too old ones are named with what is expected, by find_package and by add_subdirectory.
set -eu
source=$1 build=$2 cmake=$3 generator=$4 cxx=$5
work=$build/tests/consumer_versions
rm -rf "$work"
mkdir -p "$work/project"
cp "$source/tests/consumer/CMakeLists.txt" "$work/project/"
echo 'int main() {}' > "$work/project/main.cpp"
"$cmake" --install "$build" --prefix "$work/prefix" --component Unspecified > "$work/install.txt"

# package NAME TARGET VERSION: into $work/NAME-VERSION, compatible with its own major version only.
package() {
    mkdir -p "$work/$1-$3"
    echo "add_library($2 INTERFACE IMPORTED)" > "$work/$1-$3/$1Config.cmake"
    cat > "$work/$1-$3/$1ConfigVersion.cmake" << EOF
set(PACKAGE_VERSION $3)
if(PACKAGE_FIND_VERSION)
  if(PACKAGE_FIND_VERSION_MAJOR STREQUAL ${3%%.*} AND NOT PACKAGE_FIND_VERSION VERSION_GREATER $3)
    set(PACKAGE_VERSION_COMPATIBLE TRUE)
  endif()
endif()
EOF
}
for version in 3.3.9 3.4.0 5.0.1; do package Eigen3 Eigen3::Eigen "$version"; done
for version in 8.0.5 8.1.0 14.3.0; do package xsimd xsimd "$version"; done

# configured WAY EIGEN XSIMD: what CMake says goes to out.txt.
configured() {
    "$cmake" -S "$work/project" -B "$work/build_$1" -G "$generator" -DCMAKE_CXX_COMPILER="$cxx" \
        -DWAY="$1" -DRYE_SOURCE="$source" -DRYE_OPENMP=OFF -DCMAKE_PREFIX_PATH="$work/prefix" \
        -DEigen3_DIR="$work/Eigen3-$2" -Dxsimd_DIR="$work/xsimd-$3" > "$work/out.txt" 2>&1
}
fail() { cat "$work/out.txt"; echo "FAILED: $*"; exit 1; }
accepts() { # a package that CMake passes over for the system's is not taken either
    configured "$@" || fail "refuses Eigen $2 and xsimd $3 by $1"
    for taken in "Eigen3-$2" "xsimd-$3"; do
        grep -q "_DIR:.*=$work/$taken\$" "$work/build_$1/CMakeCache.txt" ||
            fail "does not take $taken by $1"
    done
}
refuses() { # WAY EIGEN XSIMD WORDS
    if configured "$1" "$2" "$3"; then fail "accepts Eigen $2 and xsimd $3 by $1"; fi
    tr -s '\n ' '  ' < "$work/out.txt" | grep -q "$4" || fail "no word of '$4'"
}
for way in find_package add_subdirectory; do
    accepts $way 3.4.0 8.1.0
    accepts $way 5.0.1 14.3.0
    refuses $way 3.3.9 8.1.0 "found Eigen3 3.3.9 in .*, expected 3.4 or newer"
    refuses $way 3.4.0 8.0.5 "found xsimd 8.0.5 in .*, expected 8.1 or newer"
done
echo "newer major versions are taken, too old ones are named"
