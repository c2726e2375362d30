#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# release.sh TAG OUT: what a version is published as, in the folder OUT, from the commit TAG alone:
#   source     rye-VERSION.tar.gz
#   programs   rye-VERSION-linux-x86_64.tar.gz: static programs for each level of processor, and `rye`,
#              which starts the best one that the machine has (launcher.sh)
#   windows    rye-VERSION-windows-x86_64.zip: a static program of the lowest level (windows.sh)
#   aarch64    rye-VERSION-linux-aarch64.tar.gz: the static program (aarch64.sh)
#   packages   Debian packages, of the lowest level; the program is the static one
#   container  Containerfile, which makes an image of the programs beside it
#   site       rye-VERSION-site.tar.gz
#   page       rye-VERSION-page.tar.gz: the gaze page with the avatar file HEAD, for web servers and for a
#              double click
#   licences   licences/: of rye and of all that is inside of the programs
#   checksums  SHA256SUMS
# A step whose tools are missing is named as not made. From the environment:
#   STEPS    which of the above, in this order (default: all)
#   LEVELS   of processors, as -march has them (default: "x86-64 x86-64-v3 x86-64-v4")
#   HEAD     an avatar file for the page (default: one that the program of the first level makes)
set -eu
[ $# -eq 2 ] || { echo "release.sh: expected two arguments, TAG OUT" >&2; exit 2; }
tag=$1 out=$2
here=$(cd "$(dirname "$0")/.." && pwd)
steps=${STEPS:-source programs windows aarch64 packages container site page licences checksums}
levels=${LEVELS:-x86-64 x86-64-v3 x86-64-v4}
commit=$(git -C "$here" rev-parse --verify --quiet "$tag^{commit}") ||
    { echo "release.sh: no tag or commit '$tag'" >&2; exit 2; }
[ ! -e "$out" ] || { echo "release.sh: $out is there already" >&2; exit 2; }
mkdir -p "$out.work"
rm -rf "$out.work"/*
work=$(cd "$out.work" && pwd)
git -C "$here" archive --prefix=source/ "$commit" | tar -x -C "$work"
source=$work/source
version=$(sed -n 's/#define RYE_VERSION_[A-Z]* \([0-9]*\)/\1/p' "$source/include/rye/core/config.hpp" | paste -sd .)
case $tag in
    v[0-9]*) [ "$tag" = "v$version" ] ||
        { echo "release.sh: the tag $tag has the version $version" >&2; exit 2; } ;;
esac
mkdir -p "$out"
out=$(cd "$out" && pwd)
not_made() { echo "not made: $1: $2"; }
wanted() { case " $steps " in *" $1 "*) true ;; *) false ;; esac; }
# One date for all files, the commit's, and one order, so that the same commit gives the same bytes.
date=$(git -C "$here" show -s --format=%ct "$commit")
pack() { # FOLDER NAME: of the folder $work
    tar -C "$work" --sort=name --mtime="@$date" --owner=0 --group=0 --numeric-owner -cf - "$1" |
        gzip -9n > "$out/$2.tar.gz"
}
build() { # FOLDER LEVEL OPTIONS...: configures the folder of $work
    folder=$1 level=$2
    shift 2
    cmake -S "$source" -B "$work/$folder" -DCMAKE_BUILD_TYPE=Release -DRYE_NATIVE=OFF \
        -DRYE_MERGE_UNITS=ON -DRYE_BUILD_TESTS=OFF \
        -DRYE_BUILD_EXAMPLES=OFF -DRYE_BUILD_BENCHMARKS=OFF -DCMAKE_CXX_FLAGS="-march=$level" "$@" > "$work/$folder.txt"
}
static_program() { # LEVEL: $work/LEVEL/rye, once
    [ ! -x "$work/$1/rye" ] || return 0
    echo 'set(CMAKE_FIND_LIBRARY_SUFFIXES .a)' > "$work/static.cmake"
    # HDF5 of Debian has no static library that stands alone: `rye import xgaze` says so.
    build "$1" "$1" -DRYE_BUILD_C=OFF -DRYE_HDF5_LIBRARY= -DRYE_HDF5_INCLUDE= -DRYE_LICENCES="$work/licences" \
        -DCMAKE_PROJECT_rye_INCLUDE="$work/static.cmake" -DCMAKE_EXE_LINKER_FLAGS=-static
    cmake --build "$work/$1" --parallel "$(nproc)" --target rye_program >> "$work/$1.txt"
    ! ldd "$work/$1/rye" > "$work/ldd.txt" 2>&1 || { cat "$work/ldd.txt"; echo "release.sh: not static" >&2; exit 1; }
}
# The copyright files of what is inside of the programs for x86-64.
mkdir "$work/licences"
cp "$source/LICENSE" "$work/licences/rye"
for package in libeigen3-dev libxsimd-dev libcli11-dev nlohmann-json3-dev libasio-dev libjpeg62-turbo-dev libpng-dev \
    zlib1g-dev libzstd-dev libc6-dev libgcc-12-dev libgcc-14-dev; do
    [ -f "/usr/share/doc/$package/copyright" ] || continue
    cp "/usr/share/doc/$package/copyright" "$work/licences/$package"
done

if wanted source; then
    mv "$source" "$work/rye-$version"
    pack "rye-$version" "rye-$version"
    mv "$work/rye-$version" "$source"
fi
if wanted programs; then
    programs=$work/rye-$version-linux-x86_64
    mkdir "$programs"
    for level in $levels; do
        static_program "$level"
        strip -o "$programs/rye-$level" "$work/$level/rye"
    done
    install -m 755 "$source/packaging/launcher.sh" "$programs/rye"
    cp -R "$work/licences" "$work/${levels%% *}/video_tracker" "$programs/"
    "$programs/rye" --version
    pack "rye-$version-linux-x86_64" "rye-$version-linux-x86_64"
fi
if wanted windows; then
    status=0
    WORK="$work/windows" SOURCE_DATE_EPOCH=$date sh "$source/packaging/windows.sh" "$out" > "$work/windows.txt" || status=$?
    case $status in
        0) ;;
        77) not_made windows "$(tail -n 1 "$work/windows.txt")" ;;
        *) exit $status ;;
    esac
fi
if wanted aarch64; then
    programs=$work/rye-$version-linux-aarch64
    if sh "$source/packaging/aarch64.sh" "$source" "$work/aarch64" "$programs" > "$work/aarch64.txt"; then
        cp "$source/LICENSE" "$programs/licences/rye"
        cp -R "$work/aarch64/build/video_tracker" "$programs/"
        pack "rye-$version-linux-aarch64" "rye-$version-linux-aarch64"
    elif [ $? = 77 ]; then
        not_made aarch64 "$(tail -n 1 "$work/aarch64.txt")"
    else
        exit 1
    fi
fi
if wanted packages; then
    if command -v dpkg-shlibdeps > /dev/null; then
        static_program x86-64
        build packages x86-64 -DRYE_BUILD_PROGRAMS=OFF -DRYE_BUILD_C=ON
        cmake --build "$work/packages" --parallel "$(nproc)" >> "$work/packages.txt"
        for folder in x86-64 packages; do
            (cd "$work/$folder" && SOURCE_DATE_EPOCH=$date cpack -G DEB >> "$work/packages.txt")
            cp "$work/$folder"/*.deb "$out/"
        done
    else
        not_made packages "no dpkg-shlibdeps (Debian package dpkg-dev)"
    fi
fi
if wanted container; then
    cp "$source/packaging/Containerfile" "$out/"
fi
if wanted site; then
    if command -v doxygen > /dev/null; then
        sh "$source/docs/site/site.sh" "$source" "$work/rye-$version-site"
        pack "rye-$version-site" "rye-$version-site"
    else
        not_made site "no doxygen (Debian package doxygen)"
    fi
fi
if wanted page; then
    head=${HEAD:-}
    if [ -z "$head" ] && ! wanted programs; then
        not_made page "HEAD names no avatar file, and there is no program that makes one"
    elif ! command -v em++ > /dev/null; then
        not_made page "no em++ (Debian package emscripten)"
    else
        if [ -z "$head" ]; then
            rye=$work/${levels%% *}/rye
            "$rye" capture --out "$work/capture" --quiet
            "$rye" train --capture "$work/capture" --preset tiny --out "$work/run" --quiet
            "$rye" export --run "$work/run" --out "$work/head.avatar"
            head=$work/head.avatar
        fi
        sh "$source/examples/gaze_page/build.sh" "$head" "$work/rye-$version-page"
        rm -rf "$work/rye-$version-page/objects"
        pack "rye-$version-page" "rye-$version-page"
        cp "$head" "$out/head.avatar"
    fi
fi
if wanted licences; then
    # Of each kind of program; a file that is another one under the same name gets the kind's name too.
    cp -R "$work/licences" "$out/"
    for folder in "$work"/rye-*/licences; do
        [ -d "$folder" ] || continue
        kind=$(basename "$(dirname "$folder")" | sed 's/.*-//')
        for file in "$folder"/*; do
            name=$(basename "$file")
            [ -e "$out/licences/$name" ] || cp "$file" "$out/licences/$name"
            cmp -s "$file" "$out/licences/$name" || cp "$file" "$out/licences/$name-$kind"
        done
    done
fi
if wanted checksums; then
    (cd "$out" && find . -type f | sed 's|^\./||' | sort | xargs sha256sum) > "$work/SHA256SUMS"
    mv "$work/SHA256SUMS" "$out/"
fi
echo "rye $version of $commit:"
(cd "$out" && find . -maxdepth 1 -type f | sort | xargs -r wc -c)
