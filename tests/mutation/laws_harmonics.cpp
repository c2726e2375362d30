// SPDX-License-Identifier: Apache-2.0
// math/harmonics.hpp, math/scalar.hpp (sigmoid), nn/encoding.hpp, rig/influence.hpp.
#include <rye/math/harmonics.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/rig/influence.hpp>

#include "laws.hpp"

using namespace rye;
using namespace rye::laws;

namespace {

template <class M>
void ramp(const char* name) {
    // Squared distances beside the kinks, where the slope is documented to be 0.
    const auto at = [](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        using std::sin;
        const S inside = S(0.2) + S(0.04) * sin(x(0, 0));
        return std::is_same_v<M, SquaredDistance> ? inside : S(inside * inside);
    };
    const auto lift = [](const auto& x, const auto& g) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        using std::cos, std::sin;
        const S inside = S(0.2) + S(0.04) * sin(x(0, 0)), by = S(0.04) * cos(x(0, 0));
        const Ramp<S> r(S(0.15), S(0.25));
        const bool squared = std::is_same_v<M, SquaredDistance>;
        const S d2 = squared ? inside : S(inside * inside);
        const S slope = influence_slope(M(), r, d2) * (squared ? by : S(S(2) * inside * by));
        return std::decay_t<decltype(x)>::Constant(1, 1, slope * g(0, 0)).eval();
    };
    every_law(
        name, 1, 1,
        [&](const auto& x) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            return Columns<S>::Constant(1, 1, influence(M(), Ramp<S>(S(0.15), S(0.25)), S(at(x))))
                .eval();
        },
        [&](const auto& x, const auto& g) { return lift(x, g); });
}

void all() {
    every_law(
        "sh_basis, degree 4", 3, 25,
        [](const auto& x) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            return column(sh_basis<S>(4, part<3>(x)));
        },
        [](const auto& x, const auto& g) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            return column(sh_basis_vjp<S>(4, part<3>(x), VecX<S>(g.col(0))));
        });
    every_law(
        "positional_encoding", 3, 27, [](const auto& x) { return positional_encoding(x); },
        [](const auto& x, const auto& g) {
            return positional_encoding_vjp(positional_encoding(x), g);
        });
    ramp<SquaredDistance>("influence, squared");
    ramp<EuclideanDistance>("influence, plain");
}

} // namespace

int main(int argc, char** argv) { return run(argc, argv, all); }
