#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# nothing_built.sh SOURCE WORK CMAKE GENERATOR COMPILER: of a folder that is configured, and where
# nothing is built, the headers are installed and packaged, and the rest is named with the command that
# builds it. With stand-ins for the libraries the package for C has its header.
set -eu
source=$1 work=$2 cmake=$3 generator=$4 cxx=$5
rm -rf "$work"
mkdir -p "$work"
cd "$work"
fail() { echo "nothing_built: $*"; exit 1; }
headers=$(find "$source/include/rye" -name '*.hpp' | wc -l)
"$cmake" -S "$source" -B build -G "$generator" -DCMAKE_CXX_COMPILER="$cxx" -DRYE_BUILD_TESTS=OFF \
    -DRYE_BUILD_EXAMPLES=OFF -DRYE_BUILD_BENCHMARKS=OFF > configure.txt 2>&1 ||
    { cat configure.txt; exit 1; }

"$cmake" --install build --prefix "$work/all" > all.txt 2>&1 || { cat all.txt; fail "--install fails"; }
found=$(find all/include/rye -name '*.hpp' | wc -l)
[ "$found" = "$headers" ] || fail "$found headers are installed, expected $headers"
[ -f all/share/cmake/rye/ryeConfig.cmake ] || fail "no ryeConfig.cmake is installed"
[ ! -e all/include/rye/c ] || fail "the header for C is installed without its library"
for target in "rye_program" "rye_c rye_c_static"; do
    grep -q "is not built.*cmake --build $work/build --target $target\$" all.txt ||
        { cat all.txt; fail "it is not said that $target is to be built"; }
done
for component in c programs; do
    if "$cmake" --install build --prefix "$work/one" --component $component > one.txt 2>&1; then
        fail "--component $component: installed, though nothing is built"
    fi
    tr -s '\n ' ' ' < one.txt | grep -q "is not built.*cmake --build" ||
        { cat one.txt; fail "--component $component: it is not said what is to be built"; }
done
[ ! -e one ] || fail "a component that is not built left files"
echo "installed: $found headers, nothing else"

command -v dpkg-deb > /dev/null || { echo "not run: packages, for there is no dpkg-deb"; exit 0; }
cpack=$(dirname "$cmake")/cpack
(cd build && "$cpack" -G DEB > ../cpack.txt 2>&1) || { cat cpack.txt; fail "cpack fails"; }
[ "$(find build -maxdepth 1 -name '*.deb' | wc -l)" = 1 ] || fail "expected librye-dev alone"
dpkg-deb --contents "$(find build -maxdepth 1 -name 'librye-dev_*.deb')" > headers.txt
found=$(grep -c '\.hpp$' headers.txt)
[ "$found" = "$headers" ] || fail "librye-dev has $found headers, expected $headers"
echo "packaged: $found headers, nothing else"

# ---- stand-ins for the libraries -----------------------------------------------------------------
sed -n 's/^rye_package_if_built(c "\([^"]*\)" "\([^"]*\)")$/\1 \2/p' build/ryePackaged.cmake > files.txt
read -r shared static < files.txt
echo 'int stand_in(void); int stand_in(void) { return 0; }' > stand_in.c
cc -c -fPIC stand_in.c
mkdir -p "$(dirname "$shared")"
cc -shared -Wl,-soname,librye_c.so.1 stand_in.o -o "$shared"
ar rc "$static" stand_in.o
for link in librye_c.so.1 librye_c.so; do
    ln -sf "$(basename "$shared")" "$(dirname "$shared")/$link"
done
"$cmake" --install build --prefix "$work/c" --component c > c.txt 2>&1 || { cat c.txt; exit 1; }
cc -std=c11 -fsyntax-only -I c/include "$source/examples/09_draw_from_c.c" ||
    fail "the component c has no header for C"
(cd build && "$cpack" -G DEB > ../cpack.txt 2>&1) || { cat cpack.txt; fail "cpack fails"; }
package=$(find build -maxdepth 1 -name 'librye-c-dev_*.deb')
[ -n "$package" ] || fail "there is no librye-c-dev"
dpkg-deb --contents "$package" > contents.txt
grep -q '\./usr/include/rye/c/rye\.h$' contents.txt || fail "librye-c-dev has no rye/c/rye.h"
dpkg-deb --contents "$(find build -maxdepth 1 -name 'librye-dev_*.deb')" > headers.txt
! grep -q 'include/rye/c/' headers.txt || fail "librye-dev has files of librye-c-dev"
dpkg-deb --field "$package" Package Depends Breaks Replaces
echo "librye-c-dev: with its header"
