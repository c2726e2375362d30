// SPDX-License-Identifier: Apache-2.0
// math/harmonics.hpp, math/scalar.hpp (sigmoid), nn/encoding.hpp, rig/influence.hpp.
#include <rye/math/harmonics.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/rig/influence.hpp>

#include "../support/operator_laws.hpp"

using namespace rye;
using namespace rye::laws;

namespace {

/// Three points: on the slope, nearer and farther; beside the kinks, where the slope is documented
/// to be 0.
template <class M>
void ramp(const char* name) {
    const auto distance = [](const auto& x, Index i) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        using std::sin;
        const double middle[3] = {0.2, 0.09, 0.31};
        return S(S(middle[i]) + S(0.04) * sin(x(i, 0)));
    };
    constexpr bool squared = std::is_same_v<M, SquaredDistance>;
    every_law(
        name, 3, 3,
        [&](const auto& x) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            Columns<S> y(3, 1);
            for (Index i = 0; i < 3; ++i) {
                const S d = distance(x, i);
                y(i, 0) = influence(M(), Ramp<S>{S(0.15), S(0.25)}, S(squared ? d : d * d));
            }
            return y;
        },
        [&](const auto& x, const auto& g) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            using std::cos;
            auto out = g;
            for (Index i = 0; i < 3; ++i) {
                const S d = distance(x, i), by = S(0.04) * cos(x(i, 0));
                const S slope =
                    detail::influence_slope(M(), Ramp<S>{S(0.15), S(0.25)}, S(squared ? d : d * d));
                out(i, 0) = g(i, 0) * slope * (squared ? by : S(S(2) * d * by));
            }
            return out;
        });
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
