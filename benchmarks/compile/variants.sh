#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# variants.sh PROJECT [FLAGS...]: what each avatar of variant_list.hpp (examples/trainer/training)
# costs to compile, as a table: seconds as a multiple of including Eigen/Core and xsimd alone, in
# the same run; machine code in KiB of an object file that holds this variant and nothing else, and
# what it adds to a program that has the paper's avatar already. CXX names the compiler.
set -eu
project=$1
shift
cxx=${CXX:-c++}
list=$project/examples/trainer/drawing/variant_list.hpp
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
flags="-std=c++20 -O2 -march=native -DNDEBUG -DEIGEN_DONT_PARALLELIZE -fopenmp -ffunction-sections
    -I$project/include -I$project/examples/trainer $(pkg-config --cflags eigen3) $*"

. "$(dirname "$0")/seconds.sh"

sections() { # NAME: name and bytes of every function, sorted
    LC_ALL=C nm -S --defined-only "$work/$1.o" | LC_ALL=C awk 'NF == 4 && $3 ~ /[tTwWuV]/ {
        print $4, $2 }' | LC_ALL=C sort
}
sum() { # of the bytes in a list of sections, in KiB
    python3 -c 'import sys; print(sum(int(l.split()[1], 16) for l in sys.stdin) / 1024)'
}

printf '#include <Eigen/Core>\n#include <xsimd/xsimd.hpp>\n' > "$work/base.cpp"
base=$(seconds base)
# The headers with nothing compiled of them, and each variant, in the order of the list's names.
printf '#include "drawing/variant_driver.hpp"\n#include "drawing/variant_list.hpp"\n' > "$work/headers.cpp"
echo '| variant | seconds / base | KiB of code | KiB beside the first |'
echo '|---|---|---|---|'
row() { printf '| %s | %.2f | %.0f | %.0f |\n' "$1" "$2" "$3" "$4"; }
ratio() { awk -v t="$1" -v b="$base" 'BEGIN { print t / b }'; }
row 'headers alone' "$(ratio "$(seconds headers)")" 0 0
: > "$work/shared"
for name in $(sed -n 's/.* name = "\(.*\)";/\1/p' "$list"); do
    cat > "$work/$name.cpp" << CPP
#include "drawing/variant_driver.hpp"
#include "drawing/variant_list.hpp"
using namespace rye::trainer;
template <class L>
struct Named;
template <class... V>
struct Named<Variants<V...>> {
    static FrameDriver of(const Avatar& a, const rye::AvatarConfig& c,
                          const rye::LandmarkRoles& r, const rye::Drivers<float>& d) {
        FrameDriver f;
        (
            [&] {
                if constexpr (V::name == "$name") f = driver_of<typename V::List>(a, c, r, d);
            }(),
            ...);
        return f;
    }
};
FrameDriver driver_of_variant(const Avatar& a, const rye::AvatarConfig& c,
                              const rye::LandmarkRoles& r, const rye::Drivers<float>& d) {
    return Named<AvatarVariants>::of(a, c, r, d);
}
CPP
    time=$(seconds "$name")
    sections "$name" > "$work/$name.sections"
    [ -s "$work/shared" ] || first=$name
    all=$(sum < "$work/$name.sections")
    if [ "$name" = "$first" ]; then
        cp "$work/$name.sections" "$work/shared"
        row "$name" "$(ratio "$time")" "$all" "$all"
    else
        added=$(LC_ALL=C join -v 1 "$work/$name.sections" "$work/shared" | sum)
        row "$name" "$(ratio "$time")" "$all" "$added"
    fi
done
