#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# compile.sh INCLUDE [FLAGS...]: what it costs to compile rye's main instantiations, as a table:
# seconds as a multiple of including Eigen/Core and xsimd alone, lines after the preprocessor as
# such a multiple too, and the machine code in KiB. CXX names the compiler.
set -eu
include=$1
shift
cxx=${CXX:-c++}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
flags="-std=c++20 -O2 -march=native -I$include $(pkg-config --cflags eigen3) $*"

source_of() { # NAME: headers, then what is instantiated
    case $1 in
    base) echo '#include <Eigen/Core>
#include <xsimd/xsimd.hpp>' ;;
    include) echo '#include <rye/splat/lanes.hpp>' ;;
    scalar_forward | lanes_forward | scalar_both | lanes_both | lanes_double)
        echo '#include <rye/splat/lanes.hpp>
using namespace rye;'
        real=float
        backend='ScalarBackend<Serial>'
        case $1 in lanes*) backend='XsimdBackend<DefaultArch, Serial>' ;; esac
        case $1 in *double) real=double ;; esac
        vjp=''
        case $1 in *forward) ;; *) vjp='return r.vjp(g, c, b, y, y.feature.pixels);' ;; esac
        echo "auto f(const Gaussians<$real>& g, const Pinhole<$real>& c, const VecX<$real>& b) {
    const Rasterizer<$backend, Balanced> r;
    const Raster<$real> y = r.forward(g, c, b);
    ${vjp:-return y;}
}" ;;
    mlp) echo '#include <rye/nn/mlp.hpp>
using namespace rye;
using B = XsimdBackend<DefaultArch, Serial>;
void f(const Mlp<float>& m, const Columns<float>& x, const VecX<float>& v, Mlp<float>& g,
       Columns<float>& gx) {
    MlpTrace<float> t;
    const Columns<float> y = mlp_forward(B{}, m, x, v, &t);
    mlp_vjp(B{}, m, {x, v, t}, y, {g, &gx});
}' ;;
    avatar) echo '#include <rye/avatar/two_stream.hpp>
using namespace rye;
using B = XsimdBackend<DefaultArch, Serial>;
void f(const TwoStream<float>& a, const AvatarConfig& c, const LandmarkRoles& r,
       const Drivers<float>& d, TwoStreamTrace<float>& t) {
    drive(B{}, a, c, r, d, t);
}' ;;
    esac
}

. "$(dirname "$0")/seconds.sh"

echo '| instantiation | seconds / base | lines / base | KiB of code |'
echo '|---|---|---|---|'
for name in base include scalar_forward scalar_both lanes_forward lanes_both lanes_double mlp avatar
do
    source_of $name > "$work/$name.cpp"
    time=$(seconds $name)
    lines=$($cxx $flags -E -P "$work/$name.cpp" | wc -l)
    code=$(size "$work/$name.o" | awk 'NR == 2 { print $1 }')
    if [ $name = base ]; then base_time=$time base_lines=$lines; fi
    awk -v n=$name -v t="$time" -v bt="$base_time" -v l="$lines" -v bl="$base_lines" -v c="$code" \
        'BEGIN { gsub("_", ", ", n); printf "| %s | %.2f | %.2f | %.0f |\n", n, t / bt, l / bl, c / 1024 }'
done
