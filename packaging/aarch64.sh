#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# aarch64.sh SOURCE WORK OUT: the static program for aarch64 Linux, OUT/rye, with the copyright files of
# what is inside of it, OUT/licences. Debian's cross compiler builds it in WORK from the sources SOURCE,
# with Debian's static libraries for arm64, which are unpacked there; qemu-user runs it once.
# Ends with 77, and says why, where a tool or a mirror is missing.
set -eu
[ $# -eq 3 ] || { echo "aarch64.sh: expected three arguments, SOURCE WORK OUT" >&2; exit 2; }
source=$(cd "$1" && pwd)
mkdir -p "$2" "$3"
work=$(cd "$2" && pwd) out=$(cd "$3" && pwd)
# shellcheck source=tests/portability/unpack.sh
. "$source/tests/portability/unpack.sh"
cross=aarch64-linux-gnu
missing() { echo "$1"; exit 77; }
gxx=${AARCH64_CXX:-$(cd /usr/bin && find . -name "$cross-g++-[0-9]*" | sed 's|./||' | sort -V | tail -n 1)}
command -v "${gxx:-none}" > /dev/null || missing "no $cross-g++ (Debian package g++-12-$cross)"
command -v qemu-aarch64 > /dev/null || missing "no qemu-aarch64 (Debian package qemu-user)"
# shellcheck source=/dev/null
suite=$(. /etc/os-release && echo "${VERSION_CODENAME:-stable}")
libraries="libxsimd-dev libeigen3-dev libcli11-dev nlohmann-json3-dev libasio-dev libjpeg62-turbo-dev libpng-dev zlib1g-dev
libzstd-dev"
# shellcheck disable=SC2086 # a list
unpack "$suite" arm64 "$work/sysroot" $libraries || missing "no Debian mirror that has arm64's packages could be read"

echo 'set(CMAKE_FIND_LIBRARY_SUFFIXES .a)' > "$work/static.cmake"
cmake -S "$source" -B "$work/build" -DCMAKE_TOOLCHAIN_FILE="$source/tests/portability/aarch64.cmake" \
    -DRYE_SYSROOT="$work/sysroot" -DRYE_CROSS_COMPILER="$gxx" -DCMAKE_BUILD_TYPE=Release \
    -DCMAKE_CXX_FLAGS=-march=armv8-a -DCMAKE_EXE_LINKER_FLAGS=-static \
    -DCMAKE_PROJECT_rye_INCLUDE="$work/static.cmake" -DRYE_HDF5_LIBRARY= -DRYE_HDF5_INCLUDE= \
    -DRYE_MERGE_UNITS=ON -DRYE_NATIVE=OFF -DRYE_BUILD_C=OFF -DRYE_BUILD_TESTS=OFF -DRYE_BUILD_EXAMPLES=OFF \
    -DRYE_BUILD_BENCHMARKS=OFF > "$work/build.txt"
cmake --build "$work/build" --target rye_program >> "$work/build.txt"
"$cross-strip" -o "$out/rye" "$work/build/rye"
if "$cross-readelf" -l "$out/rye" | grep -q INTERP; then
    echo "aarch64.sh: not static" >&2
    exit 1
fi
qemu-aarch64 "$out/rye" --version

mkdir -p "$out/licences"
# shellcheck disable=SC2086 # a list
for package in $libraries; do
    cp "$work/sysroot/usr/share/doc/$package/copyright" "$out/licences/$package"
done
for package in libc6-dev-arm64-cross "libgcc-${gxx##*-}-dev-arm64-cross"; do
    cp "/usr/share/doc/$package/copyright" "$out/licences/$package"
done
