// SPDX-License-Identifier: Apache-2.0
// geometry/mesh.hpp, geometry/marching_tets.hpp, nn/elementwise.hpp, loss/mesh_terms.hpp.
#include <rye/backend/scalar.hpp>
#include <rye/geometry/marching_tets.hpp>
#include <rye/loss/mesh_terms.hpp>

#include "../support/operator_laws.hpp"

using namespace rye;
using namespace rye::laws;

namespace {

const std::vector<Face> fan{{0, 1, 2}, {0, 2, 3}, {0, 3, 4}, {1, 2, 4}};

/// A loss of one array, as an operator on its entries.
template <class Loss>
void scalar_loss(const char* name, Index rows, Index cols, const Loss& loss) {
    every_law(
        name, rows * cols, 1,
        [&](const auto& x) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            return Columns<S>::Constant(1, 1, loss(Columns<S>(x.reshaped(rows, cols))).value)
                .eval();
        },
        [&](const auto& x, const auto& g) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            return Columns<S>(loss(Columns<S>(x.reshaped(rows, cols))).gradient.reshaped() *
                              g(0, 0));
        });
}

void all() {
    every_law(
        "uniform_laplacian", 15, 15,
        [](const auto& x) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            return Columns<S>(uniform_laplacian<S>(Columns<S>(x.reshaped(3, 5)), fan).reshaped());
        },
        [](const auto& x, const auto& g) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            return Columns<S>(laplacian_vjp<S>(fan, Columns<S>(g.reshaped(3, 5))).reshaped());
        });
    // Three edges: their corners and distances of opposite sign. The second and third are cut so
    // close to a corner that the fraction is clamped, and the distances have no derivative.
    SurfaceTopology edges;
    edges.edges = {{0, 1}, {2, 3}, {4, 5}};
    const auto distances = [](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        using std::sin;
        const double size[6] = {1, -1, 1e-8, -1, 1, -1e-8};
        Columns<S> s(1, 6);
        for (Index k = 0; k < 6; ++k) s(0, k) = S(size[k]) * (S(1) + S(0.5F) * sin(x(18 + k, 0)));
        return s;
    };
    every_law(
        "surface_positions", 24, 9,
        [&](const auto& x) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            const Columns<S> v = Columns<S>(x.topRows(18)).reshaped(3, 6);
            return Columns<S>(surface_positions<S>(edges, v, distances(x)).reshaped());
        },
        [&](const auto& x, const auto& g) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            using std::cos;
            const Columns<S> v = Columns<S>(x.topRows(18)).reshaped(3, 6), s = distances(x);
            const double size[6] = {1, -1, 1e-8, -1, 1, -1e-8};
            Surface<S> surface{surface_positions<S>(edges, v, s),
                               detail::crossing_fractions<S>(edges, s), edges};
            const auto r = surface_vjp<S>(surface, {v, s, Columns<S>(0, 6)},
                                          {Columns<S>(g.reshaped(3, 3)), Columns<S>(0, 3)});
            auto out = x;
            out.topRows(18) = r.vertices.reshaped();
            for (Index k = 0; k < 6; ++k)
                out(18 + k, 0) = S(0.5F * size[k]) * cos(x(18 + k, 0)) * r.sdf(0, k);
            return out;
        });
    scalar_loss("laplacian_term", 3, 5, [](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        return detail::laplacian_term<S>(x, fan);
    });
    scalar_loss("silhouette_term", 1, 6, [](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        // Masks that are neither 0 nor 1: otherwise a missing factor of visible or mask would be 1.
        Columns<S> mask(1, 6), visible(1, 6), soft = x;
        for (Index i = 0; i < 6; ++i) {
            mask(0, i) = S(0.25F * static_cast<float>(i % 5));
            visible(0, i) = S(1.0F - 0.125F * static_cast<float>(i));
            soft(0, i) = S(0.5F) + S(0.1F) * x(0, i);
        }
        auto r = detail::silhouette_term<S>(ScalarBackend<>{}, soft, mask, visible);
        r.gradient = Columns<S>(S(0.1F) * r.gradient);
        return r;
    });
    // No law of derivatives determines the number that keeps the quotient finite, but faint masks
    // must still have a gradient.
    const Columns<double> faint = Columns<double>::Constant(1, 6, 1e-12),
                          all_of_it = Columns<double>::Ones(1, 6);
    demand("silhouette_term", "faint masks", "double",
           detail::silhouette_term<double>(ScalarBackend<>{}, faint, faint, all_of_it)
               .gradient.maxCoeff(),
           0);
}

} // namespace

int main(int argc, char** argv) { return run(argc, argv, all); }
