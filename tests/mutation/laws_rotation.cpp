// SPDX-License-Identifier: Apache-2.0
// math/linalg.hpp and math/rotation.hpp.
#include <rye/math/rotation.hpp>

#include "../support/operator_laws.hpp"

using namespace rye;
using namespace rye::laws;

namespace {

template <class S>
Mat3<S> matrix(const Columns<S>& g) {
    Mat3<S> m;
    for (int i = 0; i < 9; ++i) m.data()[i] = g(i, 0);
    return m;
}

void all() {
    every_law(
        "normalized", 3, 3, [](const auto& x) { return column(normalized(part<3>(x))); },
        [](const auto& x, const auto& g) {
            return column(normalized_vjp(part<3>(x), part<3>(g)));
        });
    every_law(
        "quat_normalized", 4, 4, [](const auto& x) { return column(quat_normalized(part<4>(x))); },
        [](const auto& x, const auto& g) {
            return column(quat_normalized_vjp(part<4>(x), part<4>(g)));
        });
    every_law(
        "quat_product", 8, 4,
        [](const auto& x) { return column(quat_product(part<4>(x), part<4>(x, 4))); },
        [](const auto& x, const auto& g) {
            auto r = x;
            r.topRows(4) = column(quat_product_vjp_left(part<4>(x, 4), part<4>(g)));
            r.bottomRows(4) = column(quat_product_vjp_right(part<4>(x), part<4>(g)));
            return r;
        });
    every_law(
        "quat_matrix", 4, 9, [](const auto& x) { return column(quat_matrix(part<4>(x))); },
        [](const auto& x, const auto& g) {
            return column(quat_matrix_vjp(part<4>(x), matrix(g)));
        });
    for (const double size : {1e-3, 0.3, 1.0})
        every_law(
            "so3_exp", 3, 9, [](const auto& x) { return column(so3_exp(part<3>(x))); },
            [](const auto& x, const auto& g) { return column(so3_exp_vjp(part<3>(x), matrix(g))); },
            size);
}

} // namespace

int main(int argc, char** argv) { return run(argc, argv, all); }
