#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# portability.sh [TARGET...]: compiles and runs rye for other processors, other numbers of lanes,
# other compilers' libraries and other versions of Eigen and xsimd; all of those below, or those
# that are named. Each runs README's program, whose first number must be 0.888, and, but for
# cxx23, tests/portability/numbers.cpp, which compares vectors, plain loops and double precision.
#   lanes4    x86-64, vectors of 4 floats
#   lanes8    x86-64 with AVX2, vectors of 8
#   lanes16   x86-64 with AVX-512, vectors of 16; it compiles without optimisation too
#   libcxx    clang and its library libc++, with the tests of readers of files
#   sanitized clang's undefined-behaviour sanitizer over every kernel
#   cxx23     C++23, every header with its warnings
#   debian13  the Eigen and xsimd of Debian 13; where a bare system can be made (tests/bare.sh),
#             everything is built there by its own compiler, with warnings as errors
#   compilers the program and the library for C by g++ 12, 13 and 14 and by clang 14 and 19, each on
#             a bare Debian, with warnings as errors
#   newest    the Eigen and xsimd of Debian's unstable suite
#   bits32    x86 with 32-bit pointers, with the tests of core; by qemu-user if the kernel runs none
#   wasm32    WebAssembly by emscripten, run by node
#   windows   rye.exe by mingw-w64, run by wine: tests/packaging/windows.sh
#   aarch64   Arm with 64 bits, run by qemu-user: with test_math, test_rig, test_nn and test_splat,
#             and a few steps of `rye train`; plain loops must have the bits that they have on x86
# Installs what it needs where it is root and there is apt, and otherwise names it. A table ends the
# output, then the list of what could not run here, and why. Fails if what could run failed.
# Results lie in build/portability, logs beside them. JOBS says how many processes run at once.
set -eu
cd "$(dirname "$0")/.."
. cmake/steps.sh
. tests/portability/unpack.sh

all="lanes4 lanes8 lanes16 libcxx sanitized cxx23 debian13 newest bits32 wasm32 compilers windows aarch64"
root=$PWD
work=$root/${BUILD:-build/portability}
cxx=${CXX:-g++}
gxx_major=$(g++ -dumpversion 2> /dev/null | cut -d. -f1)
gxx_major=${gxx_major:-12}
eigen=/usr/include/eigen3
warnings="-Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Werror"
cross=aarch64-linux-gnu
# g++-multilib, which would put the kernel's headers in view, does not go with cross compilers.
m32="g++ -m32 -msse2 -mfpmath=sse -idirafter /usr/include/x86_64-linux-gnu"
emulator="qemu-aarch64 -L /usr/$cross"
ccache=
if command -v ccache > /dev/null 2>&1; then ccache=ccache; fi

# ---- what is missing ----------------------------------------------------------------------------
has() { command -v "$1" > /dev/null 2>&1; }
compiles() { # COMPILER...: a program that includes the standard library
    printf '#include <string>\nint main() { return 0; }\n' > "$work/probe.cpp"
    "$@" "$work/probe.cpp" -o "$work/probe" > /dev/null 2>&1
}
# What runs programs with 32-bit pointers: nothing, or qemu-user where the kernel does not.
runner32() {
    printf 'int main() { return 0; }\n' > "$work/probe32.cpp"
    # shellcheck disable=SC2086 # several words
    if $m32 "$work/probe32.cpp" -o "$work/probe32" > /dev/null 2>&1; then
        "$work/probe32" > /dev/null 2>&1 || echo qemu-i386
    fi
}
clang() {
    for name in ${CLANG:-clang++ clang++-14}; do has "$name" && echo "$name" && return; done
}
missing() { # TARGET: the Debian packages it needs that are not there
    case $1 in
    libcxx)
        [ -n "$(clang)" ] && compiles "$(clang)" -stdlib=libc++ ||
            echo clang libc++-dev libc++abi-dev ;;
    sanitized) [ -n "$(clang)" ] || echo clang ;;
    bits32)
        compiles $m32 || echo "g++-$gxx_major-multilib"
        [ -z "$(runner32)" ] || has qemu-i386 || echo qemu-user ;;
    wasm32)
        has em++ || echo emscripten
        has node || echo nodejs ;;
    windows)
        has x86_64-w64-mingw32-g++-posix || echo g++-mingw-w64-x86-64-posix
        [ -e /usr/x86_64-w64-mingw32/lib/libz.a ] || echo libz-mingw-w64-dev
        has wine || echo wine wine64
        has dpkg-source || echo dpkg-dev
        for tool in nasm zip unzip; do has $tool || echo $tool; done ;;
    aarch64)
        has "$cross-g++-$gxx_major" || echo "g++-$gxx_major-$cross"
        has qemu-aarch64 || echo qemu-user
        has ninja || echo ninja-build ;;
    esac
}
install_missing() { # TARGET...
    packages=$(for target; do missing "$target"; done | tr '\n' ' ')
    [ -n "$packages" ] || return 0
    if ! has apt-get || [ "$(id -u)" != 0 ]; then
        echo "portability: missing, by the names of their Debian packages: $packages"
        return 0
    fi
    echo "portability: installing $packages"
    # shellcheck disable=SC2086 # a list of packages
    { apt-get update && DEBIAN_FRONTEND=noninteractive \
        apt-get install -y --no-install-recommends $packages; } > "$work/install.log" 2>&1 ||
        { tail -n 5 "$work/install.log"; echo "portability: not everything could be installed"; }
}

# ---- what is run --------------------------------------------------------------------------------
# note TARGET NAME RESULT SECONDS WORDS: a line of the table.
note() { printf '%s|%s|%s|%s|%s\n' "$1" "$2" "$3" "$4" "$5" >> "$work/$1/results"; }
skip() { note "$1" "$2" "not run" "" "$3"; }
# facts: what a log says of the libraries, the lanes and the number of test cases.
facts() {
    sed -n 's/^indices of/&/p; s/lanes of/&/p; s/.*cases: *\([0-9]*\).*/\1 test cases/p' |
        tr '\n' ';' | sed 's/;$//; s/;/; /g'
}
# run TARGET NAME COMMAND...: a line of the table, "passed" or "FAILED".
run() {
    run_target=$1 run_name=$2
    shift 2
    run_begin=$(date +%s)
    run_log=$work/$run_target/$(echo "$run_name" | tr -c 'a-zA-Z0-9_\n' _).log
    set +e                               # a condition would leave it off within the command too
    ( set -e; "$@" ) > "$run_log" 2>&1
    run_status=$?
    set -e
    if [ "$run_status" = 77 ]; then
        skip "$run_target" "$run_name" "$(tail -n 1 "$run_log")"
    elif [ "$run_status" = 0 ]; then
        note "$run_target" "$run_name" passed "$(seconds_since "$run_begin")" \
            "$(facts < "$run_log")"
    else
        note "$run_target" "$run_name" FAILED "$(seconds_since "$run_begin")" "see $run_log"
        tail -n 15 "$run_log" | sed "s/^/$run_target: /"
    fi
}
# README's program prints the number that is right.
readme() { # RUNNER COMPILER...
    runner=$1
    shift
    "$@" "$work/readme.cpp" -o "$here/readme$suffix"
    $runner "$here/readme$suffix" | tee "$here/readme.txt"
    grep -q 'red in the middle 0.888$' "$here/readme.txt" &&
        grep -q 'd loss / d opacity 106.682, d loss / d red 76.202$' "$here/readme.txt"
}
numbers() { # RUNNER COMPILER...
    runner=$1
    shift
    "$@" "$root/tests/portability/numbers.cpp" -o "$here/numbers$suffix"
    $runner "$here/numbers$suffix" | tee "$here/numbers.txt"
    [ "${lanes:-any}" = any ] || grep -q "^$lanes lanes of float" "$here/numbers.txt"
}
# The plain loops have the bits that they have on x86: where no product is fused and Eigen, which
# fuses on Arm by itself, is plain too.
same_bits() { # RUNNER COMPILER...
    runner=$1
    shift
    plain="-O1 -ffp-contract=off -DEIGEN_DONT_VECTORIZE -DPLAIN_LOOPS_ONLY"
    # shellcheck disable=SC2086 # several words
    {
        $ccache g++ -std=c++20 -march=x86-64 $plain -I"$root/include" -isystem $eigen \
            "$root/tests/portability/numbers.cpp" -o "$here/bits_x86"
        "$@" $plain "$root/tests/portability/numbers.cpp" -o "$here/bits"
    }
    "$here/bits_x86" | tee "$here/bits_x86.txt"
    $runner "$here/bits" | tee "$here/bits.txt"
    cmp "$here/bits_x86.txt" "$here/bits.txt"
}
unit_tests() { # RUNNER FOLDERS COMPILER...
    runner=$1 folders=$2
    shift 2
    files=
    for folder in $folders; do files="$files $(echo tests/"$folder"/*_test.cpp)"; done
    # shellcheck disable=SC2086 # lists
    "$@" tests/support/main.cpp $files -o "$here/unit_tests"
    $runner "$here/unit_tests"
}

x86() { # TARGET ARCH LANES
    lanes=$3
    run "$1" "README" readme "" $ccache $cxx -std=c++20 -O2 "-march=$2" -I"$root/include" \
        -isystem $eigen
    run "$1" "numbers" numbers "" $ccache $cxx -std=c++20 -O1 "-march=$2" -I"$root/include" \
        -isystem $eigen
}
processor_has() { # INSTRUCTIONS...
    for name; do grep -qw "$name" /proc/cpuinfo 2> /dev/null || return 1; done
}
target_lanes4() { x86 lanes4 x86-64 4; }
target_lanes8() {
    if processor_has avx2 fma; then x86 lanes8 x86-64-v3 8
    else skip lanes8 "README, numbers" "this processor has no AVX2"; fi
}
target_lanes16() {
    if processor_has avx512f avx512bw avx512dq avx512vl; then
        x86 lanes16 x86-64-v4 16
        run lanes16 "README, -O0" readme "" $ccache $cxx -std=c++20 -O0 -march=x86-64-v4 \
            -I"$root/include" -isystem $eigen
        run lanes16 "numbers, -O0" syntax $cxx -std=c++20 -O0 -march=x86-64-v4
    else
        skip lanes16 "README, numbers" "this processor has no AVX-512"
    fi
}
syntax() { # COMPILER...: numbers.cpp, compiled only
    "$@" -I"$root/include" -isystem $eigen -fsyntax-only "$root/tests/portability/numbers.cpp"
}
target_libcxx() {
    compiler="$ccache $(clang) -stdlib=libc++ -std=c++20 -march=x86-64-v3 -I$root/include"
    compiler="$compiler -isystem $eigen"
    # shellcheck disable=SC2086 # several words
    {
        run libcxx "README" readme "" $compiler -O2
        run libcxx "numbers" numbers "" $compiler -O1
        run libcxx "every header" every_header "$(clang) -stdlib=libc++" -std=c++20
        run libcxx "test_core, test_io" unit_tests "" "core io" $compiler -O0
    }
}
target_sanitized() { run sanitized "numbers" sanitized_numbers; }
every_header() { # COMPILER FLAGS...
    compiler=$1
    shift
    ( cd include && find rye -name '*.hpp' | sort | sed 's/.*/#include <&>/' ) > "$here/all.cpp"
    # shellcheck disable=SC2086 # several words
    $compiler "$@" -I"$root/include" -isystem $eigen -fsyntax-only $warnings "$here/all.cpp"
}
sanitized_numbers() {
    checks="-fsanitize=undefined -fno-sanitize-recover=all"
    # shellcheck disable=SC2086 # several words
    compiles "$(clang)" $checks || { echo "clang's sanitizers (libclang-rt-dev)"; return 77; }
    # shellcheck disable=SC2086 # several words
    numbers "" $ccache "$(clang)" -std=c++20 -march=x86-64-v3 -O1 $checks -I"$root/include" \
        -isystem $eigen
}
target_cxx23() {
    run cxx23 "README" readme "" $ccache "$cxx" -std=c++23 -O2 -I"$root/include" -isystem $eigen
    run cxx23 "every header" every_header "$cxx" -std=c++23
    if [ -n "$(clang)" ]; then run cxx23 "every header, clang" every_header "$(clang)" -std=c++2b
    else skip cxx23 "every header, clang" "no clang++ here"; fi
}
other_versions() { # TARGET SUITE
    if ! unpack "$2" "$(dpkg --print-architecture 2> /dev/null || echo amd64)" "$here/$2" \
        libxsimd-dev libeigen3-dev; then
        skip "$1" "README, numbers" "no Debian mirror that has the suite $2 could be read"
        return 0
    fi
    compiler="$ccache $cxx -std=c++20 -march=x86-64-v3 -I$root/include"
    compiler="$compiler -isystem $here/$2/usr/include -isystem $here/$2/usr/include/eigen3"
    # shellcheck disable=SC2086 # several words
    {
        run "$1" "README" readme "" $compiler -O2
        run "$1" "numbers" numbers "" $compiler -O1
    }
}
target_debian13() {
    other_versions debian13 trixie
    run debian13 "every unit" in_bare trixie "" g++ all -DRYE_MERGE_UNITS=ON -DRYE_TESTS=release \
        -DRYE_BENCHMARK_OPTIMISATION=-O0
}
target_compilers() {
    for compiler in g++-12 g++-13 g++-14 clang++-19; do
        package=$(echo "$compiler" | sed 's/clang++/clang/')
        run compilers "$compiler" in_bare trixie "$package" "$compiler" "rye_program rye_c"
    done
    run compilers "clang++-14" in_bare bookworm clang-14 clang++-14 "rye_program rye_c"
}
# Builds targets on a bare Debian. Units find their own headers: none is precompiled.
in_bare() { # SUITE PACKAGE COMPILER TARGETS CMAKE_OPTIONS...
    bare_suite=$1 bare_package=$2 bare_compiler=$3 bare_targets=$4
    shift 4
    # shellcheck disable=SC2016 # for the shell in there
    PACKAGES="$bare_package" BUILD="${BUILD:-build/portability}/bare" JOBS=$jobs \
        sh tests/bare.sh "$bare_suite" sh -c '
        CXX=g++ sh cmake/install_dependencies.sh && . cmake/steps.sh && compiler=$1 targets=$2 &&
        shift 2 && configure build -DRYE_WARNINGS=ON -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON \
            "-DCMAKE_CXX_COMPILER=$compiler" "$@" &&
        cmake --build build --parallel "$jobs" --target $targets' \
        sh "$bare_compiler" "$bare_targets" "$@"
}
target_newest() { other_versions newest sid; }
target_bits32() {
    compiler="$ccache $m32 -std=c++20 -I$root/include -isystem $eigen"
    by=$(runner32)
    # shellcheck disable=SC2086 # several words
    {
        run bits32 "README" readme "$by" $compiler -O2
        run bits32 "numbers" numbers "$by" $compiler -O1
        run bits32 "every header" every_header "$m32" -std=c++20
        run bits32 "test_core" unit_tests "$by" core $compiler -O0
    }
}
target_wasm32() {
    suffix=.js
    compiler="em++ -std=c++20 -fexceptions -sSINGLE_FILE=1 -sALLOW_MEMORY_GROWTH=1 -I$root/include"
    # Debian's xsimd 8.1 knows no vectors of WebAssembly: plain loops with it, vectors with a newer.
    mkdir -p "$here/headers"
    ln -sfn /usr/include/xsimd "$here/headers/xsimd"
    # shellcheck disable=SC2086 # several words
    run wasm32 "README" readme node $compiler -O1 -isystem "$here/headers" -isystem $eigen
    if unpack sid amd64 "$here/sid" libxsimd-dev; then
        lanes=4
        # shellcheck disable=SC2086 # several words
        run wasm32 "numbers" numbers node $compiler -O1 -msimd128 \
            -isystem "$here/sid/usr/include" -isystem $eigen
    else
        skip wasm32 "numbers" "no Debian mirror that has a newer xsimd could be read"
    fi
}
target_windows() {
    run windows "rye.exe under wine" sh tests/packaging/windows.sh "$root" "$here/work"
}
target_aarch64() {
    sysroot=$here/sysroot
    if ! unpack "$(. /etc/os-release && echo "${VERSION_CODENAME:-stable}")" arm64 "$sysroot" \
        libxsimd-dev libeigen3-dev libcli11-dev nlohmann-json3-dev libasio-dev doctest-dev \
        libjpeg62-turbo-dev libjpeg62-turbo libpng-dev libpng16-16 zlib1g-dev zlib1g; then
        skip aarch64 "everything" "no Debian mirror that has arm64's packages could be read"
        return 0
    fi
    compiler="$ccache $cross-g++-$gxx_major -std=c++20 -I$root/include"
    compiler="$compiler -isystem $sysroot/usr/include -isystem $sysroot/usr/include/eigen3"
    lanes=4
    # shellcheck disable=SC2086 # several words
    {
        run aarch64 "README" readme "$emulator" $compiler -O2
        run aarch64 "numbers" numbers "$emulator" $compiler -O1
        run aarch64 "plain loops as on x86" same_bits "$emulator" $compiler
    }
    run aarch64 "configure" cross_configure "$sysroot"
    for folder in math rig nn splat; do
        run aarch64 "test_$folder" cross_test "$folder"
    done
    run aarch64 "rye train, a few steps" cross_train
}
cross_configure() { # SYSROOT
    configure "$here/build" "-DCMAKE_TOOLCHAIN_FILE=$root/tests/portability/aarch64.cmake" \
        "-DRYE_SYSROOT=$1" "-DRYE_CROSS_COMPILER=$cross-g++-$gxx_major" \
        -DCMAKE_BUILD_TYPE=None "-DCMAKE_CXX_FLAGS=-O1 -DNDEBUG" -DRYE_NATIVE=OFF \
        -DRYE_BUILD_EXAMPLES=OFF -DRYE_BUILD_BENCHMARKS=OFF -DRYE_INSTALL=OFF
}
cross_test() { # FOLDER
    cmake --build "$here/build" --parallel "$jobs" --target "test_$1"
    $emulator "$here/build/tests/test_$1"
}
# The program makes a capture and trains on it, both stages: with one thread and with two the same.
cross_train() {
    cmake --build "$here/build" --parallel "$jobs" --target rye_program
    rye="$emulator -E LD_LIBRARY_PATH=$here/sysroot/usr/lib/$cross:$here/sysroot/lib/$cross $here/build/rye"
    rm -rf "$here/train"
    mkdir -p "$here/train"
    cd "$here/train"
    $rye capture --out cap --size 32 --cameras 3 --frames 3 --test-frames 1 --apart-frames 0 \
        --samples 1 --quiet
    for threads in 1 2; do
        $rye train --capture cap --preset tiny --config "$root/tests/portability/small.json" --quiet --out "run$threads" \
            --threads "$threads"
    done
    cmp run1/checkpoint.safetensors run2/checkpoint.safetensors
    $rye export --run run1 --ply head.ply
    grep -aq '^element vertex [1-9]' head.ply
}

# ---- all of them --------------------------------------------------------------------------------
if [ "${1:-}" = --one ]; then
    here=$work/$2 suffix='' lanes=any
    not_there=$(missing "$2" | tr '\n' ' ')
    if [ -n "$not_there" ]; then skip "$2" "everything" "missing: $not_there"
    else "target_$2"; fi
    exit 0
fi
[ $# -gt 0 ] || eval "set -- $all"
for target; do
    case " $all " in
    *" $target "*) ;;
    *) echo "portability.sh: got $target, expected targets out of: $all" >&2; exit 2 ;;
    esac
done
mkdir -p "$work"
# The program that README.md shows.
awk '/^```cpp/ { inside = 1; next } /^```/ { if (inside) exit } inside' README.md \
    > "$work/readme.cpp"
[ -s "$work/readme.cpp" ] || { echo "README.md shows no C++ program"; exit 1; }
has "$cxx" && [ -e $eigen ] || sh cmake/install_dependencies.sh
install_missing "$@"
install_missing "$@" # what only an installed compiler shows
for target; do mkdir -p "$work/$target" && rm -f "$work/$target/results"; done
one() { printf '%s\n' "$@" | xargs -P "$jobs" -I '{}' sh tests/portability.sh --one '{}'; }
small=$(printf '%s\n' "$@" | grep -Ev '^(debian13|compilers|windows|aarch64)$' || true)
# shellcheck disable=SC2086 # a list
[ -z "$small" ] || one $small
for target in debian13 compilers windows aarch64; do  # each fills the machine by itself
    case " $* " in *" $target "*) one "$target" ;; esac
done

for target; do cat "$work/$target/results"; done > "$work/results"
awk -F'|' 'BEGIN { printf "\n%-9s %-24s %-8s %4s  %s\n", "target", "what", "result", "s", "with" }
    $3 != "not run" { printf "%-9s %-24s %-8s %4s  %s\n", $1, $2, $3, $4, $5 }' "$work/results"
awk -F'|' '$3 == "not run" { if (!n++) print "\nNot run here:"; print "  " $1 ", " $2 ": " $5 }
    END { if (!n) print "\nNothing was left out." }' "$work/results"
if grep -q '|FAILED|' "$work/results"; then
    printf '\nFAILED, in %s s.\n' "$(seconds_since "$begin")"
    exit 1
fi
printf '\nAll that can run here passed, in %s s.\n' "$(seconds_since "$begin")"
