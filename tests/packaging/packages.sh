#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# packages.sh SOURCE WORK CMAKE GENERATOR COMPILER: builds the Debian package of the headers and lists
# it, runs the steps of the vcpkg port and of the Conan recipe with stand-ins for those programs, and
# looks for the headers in each result.
set -eu
source=$1 work=$2 cmake=$3 generator=$4 cxx=$5
here=$(cd "$(dirname "$0")" && pwd)
rm -rf "$work"
mkdir -p "$work"
cd "$work"
fail() { echo "packages: $*"; exit 1; }
version=$(sed -n 's/^#define RYE_VERSION_[A-Z]* //p' "$source/include/rye/core/config.hpp" |
    paste -sd .)
headers=$(find "$source/include/rye" -name '*.hpp' | wc -l)

# ---- Debian --------------------------------------------------------------------------------------
if command -v dpkg-deb > /dev/null; then
    "$cmake" -S "$source" -B build -G "$generator" -DCMAKE_CXX_COMPILER="$cxx" \
        -DRYE_BUILD_PROGRAMS=OFF -DRYE_BUILD_EXAMPLES=OFF -DRYE_BUILD_TESTS=OFF \
        -DRYE_BUILD_BENCHMARKS=OFF -DRYE_BUILD_C=OFF > configure.txt || { cat configure.txt; exit 1; }
    (cd build && "$(dirname "$cmake")/cpack" -G DEB > ../cpack.txt) || { cat cpack.txt; exit 1; }
    package=build/librye-dev_${version}_all.deb
    [ -f "$package" ] || fail "no $package"
    dpkg-deb --contents "$package" > contents.txt
    found=$(grep -c '\./usr/include/rye/.*\.hpp$' contents.txt)
    [ "$found" = "$headers" ] || fail "the .deb has $found headers, expected $headers"
    for file in share/cmake/rye/ryeConfig.cmake share/cmake/rye/ryeTargets.cmake \
        share/pkgconfig/rye.pc share/doc/rye/LICENSE; do
        grep -q "\./usr/$file\$" contents.txt || fail "the .deb has no /usr/$file"
    done
    dpkg-deb --field "$package" Package Version Architecture Depends > fields.txt
    cat fields.txt
    grep -q '^Depends: libeigen3-dev (>= 3.4), libxsimd-dev (>= 8.1)$' fields.txt ||
        fail "the .deb depends on something else"
    dpkg-deb --extract "$package" deb
    echo "librye-dev: $found headers, $(wc -c < "$package") bytes"
else
    echo "not run: the Debian package, for there is no dpkg-deb"
fi

grep -qx "version: $version" "$source/CITATION.cff" ||
    fail "CITATION.cff has another version than $version"

# ---- vcpkg ---------------------------------------------------------------------------------------
port=$source/packaging/vcpkg/rye
grep -q "\"version\": \"$version\"" "$port/vcpkg.json" ||
    fail "packaging/vcpkg/rye/vcpkg.json has another version than $version"
"$cmake" -DCURRENT_PACKAGES_DIR="$work/vcpkg" -DGENERATOR="$generator" -DCXX="$cxx" \
    -DPORT="$port" -DBUILD="$work/vcpkg_build" -P "$here/vcpkg_stand_in.cmake" > vcpkg.txt 2>&1 ||
    { cat vcpkg.txt; fail "the vcpkg port fails"; }
found=$(find vcpkg/include/rye -name '*.hpp' | wc -l)
[ "$found" = "$headers" ] || fail "the vcpkg port has $found headers, expected $headers"
for file in share/rye/ryeConfig.cmake share/rye/ryeTargets.cmake share/rye/copyright; do
    [ -f "vcpkg/$file" ] || fail "the vcpkg port has no $file"
done
echo "vcpkg: $found headers by its port, run by a stand-in"

# ---- Conan ---------------------------------------------------------------------------------------
if python3 -c 'import shutil' 2> /dev/null; then # python3-minimal has few modules
    python3 -B "$here/conan_stand_in.py" "$source/packaging/conan/conanfile.py" "$work/conan" \
        "$version" || fail "the Conan recipe fails"
    found=$(find conan/package/include/rye -name '*.hpp' | wc -l)
    [ "$found" = "$headers" ] || fail "the Conan recipe has $found headers, expected $headers"
    echo "conan: $found headers by its recipe, run by a stand-in"
else
    echo "not run: the Conan recipe, for there is no whole python3"
fi
