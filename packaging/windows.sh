#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# windows.sh OUT: makes OUT/rye-VERSION-windows-x86_64.zip from the checkout that it lies in: rye.exe
# with all libraries inside, LICENSE and the licences of what is inside. By Debian's mingw-w64; zlib is
# its package, libpng and libjpeg-turbo are built from Debian's sources. Ends with 77 and a sentence
# where a tool is missing. From the environment:
#   WORK               folder of what is built on the way, kept for the next time (default: OUT.work)
#   LEVEL              of processors, as -march has them (default: x86-64)
#   SOURCE_DATE_EPOCH  date of the files in the archive (default: the commit's)
# Not above x86-64-v2 by itself: Windows aligns the stack to 16 bytes, and g++ moves vectors of 32
# and 64 bytes to and from it as if it were aligned to their size (GCC bug 54412).
set -eu
[ $# -eq 1 ] || { echo "windows.sh: expected one argument, OUT" >&2; exit 2; }
source=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$1"
out=$(cd "$1" && pwd)
work=${WORK:-$out.work}
mkdir -p "$work"
work=$(cd "$work" && pwd)
level=${LEVEL:-x86-64}
jobs=${JOBS:-$(nproc 2> /dev/null || echo 2)}
host=x86_64-w64-mingw32
sysroot=$work/sysroot
missing=
for tool in "$host-g++-posix:g++-mingw-w64-x86-64-posix" nasm:nasm zip:zip dpkg-source:dpkg-dev cmake:cmake; do
    command -v "${tool%%:*}" > /dev/null || missing="$missing ${tool##*:}"
done
[ -e "/usr/$host/lib/libz.a" ] || missing="$missing libz-mingw-w64-dev"
[ -z "$missing" ] || { echo "missing, by the names of their Debian packages:$missing"; exit 77; }
version=$(sed -n 's/#define RYE_VERSION_[A-Z]* \([0-9]*\)/\1/p' "$source/include/rye/core/config.hpp" | paste -sd .)
name=rye-$version-windows-x86_64

# ---- libraries -----------------------------------------------------------------------------------
# copy PACKAGE...: an installed package whose files are the same on every system.
copy() {
    for package; do
        dpkg -L "$package" | grep -E '^/usr/(include|share/.*cmake|lib/.*cmake)' | while read -r file; do
            [ ! -f "$file" ] || install -D -m 644 "$file" "$sysroot$file"
        done
    done
}
# sources LABELS PACKAGE...: Debian's, with its changes, from its archives of these labels, unpacked
# into $work/sources.
sources() {
    apt=$work/sources/apt labels=$1
    shift
    rm -rf "$work/sources"
    mkdir -p "$apt/lists/partial" "$apt/archives/partial"
    keys=/usr/share/keyrings/debian-archive-keyring.gpg
    if [ -e "$keys" ]; then keys="[signed-by=$keys] "; else keys=; fi
    apt-get indextargets --format '$(LABEL)|$(REPO_URI) $(RELEASE)' 'Created-By: Packages' |
        sed -n "s#^$labels|#deb-src $keys#p" | sort -u | sed 's/$/ main/' > "$apt/sources.list"
    [ -s "$apt/sources.list" ] || return 1
    cat > "$apt/apt.conf" << END
Dir::State "$apt";
Dir::State::status "/dev/null";
Dir::Cache "$apt";
Dir::Etc::SourceList "$apt/sources.list";
Dir::Etc::SourceParts "/dev/null";
APT::Sandbox::User "root";
Acquire::Languages "none";
END
    ( export APT_CONFIG="$apt/apt.conf"
        cd "$work/sources"
        apt-get -qq update && apt-get -qq source "$@" ) > "$work/sources.txt" 2>&1
}
# library FOLDER OPTIONS...: builds what is in $work/sources/FOLDER and installs it into the sysroot.
library() {
    folder=$1
    shift
    cmake -S "$work/sources/$folder" -B "$work/$folder" -DCMAKE_TOOLCHAIN_FILE="$source/packaging/windows.cmake" \
        -DRYE_SYSROOT="$sysroot" -DCMAKE_BUILD_TYPE=Release -DCMAKE_INSTALL_PREFIX="$sysroot/usr" "$@"
    cmake --build "$work/$folder" --parallel "$jobs"
    cmake --install "$work/$folder"
}
if [ ! -e "$sysroot/complete" ]; then
    rm -rf "$sysroot"
    copy libeigen3-dev libxsimd-dev libcli11-dev nlohmann-json3-dev libasio-dev
    # A mirror may lack the newest of the security archive.
    sources 'Debian[^|]*' libpng1.6 libjpeg-turbo || sources Debian libpng1.6 libjpeg-turbo ||
        { echo "no Debian mirror that has the sources of libpng and libjpeg-turbo could be read"; exit 77; }
    for package in libpng1.6:png libjpeg-turbo:jpeg; do
        mv "$work/sources/${package%%:*}"-*/ "$work/sources/${package##*:}"
    done
    library png -DPNG_SHARED=OFF -DPNG_TESTS=OFF > "$work/png.txt" 2>&1 || { tail -n 20 "$work/png.txt"; exit 1; }
    library jpeg -DENABLE_SHARED=OFF -DWITH_TURBOJPEG=OFF -DREQUIRE_SIMD=ON > "$work/jpeg.txt" 2>&1 ||
        { tail -n 20 "$work/jpeg.txt"; exit 1; }
    touch "$sysroot/complete"
fi

# ---- the program ---------------------------------------------------------------------------------
launcher=
if command -v ccache > /dev/null; then launcher=-DCMAKE_CXX_COMPILER_LAUNCHER=ccache; fi
cmake -S "$source" -B "$work/$level" -DCMAKE_TOOLCHAIN_FILE="$source/packaging/windows.cmake" $launcher \
    -DRYE_SYSROOT="$sysroot" -DCMAKE_BUILD_TYPE=Release -DRYE_NATIVE=OFF -DCMAKE_CXX_FLAGS="-march=$level" \
    -DRYE_BUILD_TESTS=OFF -DRYE_BUILD_EXAMPLES=OFF -DRYE_BUILD_BENCHMARKS=OFF -DRYE_BUILD_C=OFF \
    -DRYE_INSTALL=OFF -DRYE_MERGE_UNITS=ON > "$work/$level.txt"
cmake --build "$work/$level" --parallel "$jobs" --target rye_program >> "$work/$level.txt" ||
    { tail -n 20 "$work/$level.txt"; exit 1; }
rm -rf "${work:?}/$name"
mkdir -p "$work/$name/licences"
"$host-strip" -o "$work/$name/rye.exe" "$work/$level/rye.exe"
own=$("$host-objdump" -p "$work/$name/rye.exe" | sed -n 's/.*DLL Name: //p' | grep -Eivx '(kernel32|msvcrt|shell32|advapi32|user32|ws2_32|mswsock)\.dll' || true)
[ -z "$own" ] || { echo "windows.sh: rye.exe needs $own" >&2; exit 1; }

# ---- the archive ---------------------------------------------------------------------------------
cp "$source/LICENSE" "$work/$name/"
for package in libeigen3-dev libxsimd-dev libcli11-dev nlohmann-json3-dev libasio-dev libz-mingw-w64-dev mingw-w64-x86-64-dev \
    gcc-mingw-w64-x86-64-posix-runtime; do
    cp "/usr/share/doc/$package/copyright" "$work/$name/licences/$package.txt"
done
for package in png jpeg; do cp "$work/sources/$package/debian/copyright" "$work/$name/licences/lib$package.txt"; done
date=${SOURCE_DATE_EPOCH:-$(git -C "$source" show -s --format=%ct HEAD)}
find "$work/$name" -exec touch -d "@$date" {} +
rm -f "$out/$name.zip"
(cd "$work" && find "$name" -type f | LC_ALL=C sort | TZ=UTC zip -qX9@ "$out/$name.zip")
echo "$name.zip: $(wc -c < "$out/$name.zip") bytes, rye.exe $(wc -c < "$work/$name/rye.exe") bytes, for $level"
