#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# spz_library.sh SOURCE WORK: compares SPZ files of versions 1 to 4 between rye and Niantic's library,
# whose sources (github.com/nianticlabs/spz) lie in SOURCE, both ways; prints the largest differences.
# Builds the library and spz_library.cpp in WORK, with zlib and libzstd. Ends with 77 where one of them
# is missing.
set -eu
[ $# -eq 2 ] || { echo "usage: spz_library.sh SOURCE WORK" >&2; exit 2; }
here=$(cd "$(dirname "$0")/../.." && pwd)
cxx=${CXX:-c++}
has_header() { printf '#include <%s>\n' "$1" | $cxx -E -x c++ - > /dev/null 2>&1; }
for need in zlib.h zstd.h; do
    has_header $need || { echo "not run: SPZ of Niantic's library, for there is no $need"; exit 77; }
done
[ -e "$1/src/cc/load-spz.cc" ] ||
    { echo "not run: SPZ of Niantic's library, for $1 has no src/cc/load-spz.cc"; exit 77; }
source=$(cd "$1" && pwd)
mkdir -p "$2"
cd "$2"
for unit in load-spz splat-types splat-c-types; do
    [ ! -e "$source/src/cc/$unit.cc" ] || $cxx -std=c++20 -O1 -c "$source/src/cc/$unit.cc" -o "$unit.o"
done
$cxx -std=c++20 -O1 -DRYE_ZSTD -I"$here/include" -I"$here/examples/trainer" -isystem /usr/include/eigen3 \
    -isystem "$source/src/cc" "$here/tests/viewers/spz_library.cpp" "$here/examples/trainer/data/zstd.cpp" \
    "$here/examples/trainer/data/deflate.cpp" ./*.o -lz -lzstd -lpthread -o spz_library
./spz_library > rows.txt && status=0 || status=$?
grep -v '^\[SPZ' rows.txt
exit $status
