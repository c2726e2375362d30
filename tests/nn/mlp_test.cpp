// SPDX-License-Identifier: Apache-2.0
#include <rye/nn/mlp.hpp>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>

#include "../support/random.hpp"

using namespace rye;

namespace {

/// The textbook network: everything concatenated, one point at a time.
template <class T>
Columns<T> plain_mlp(const Mlp<T>& m, const Columns<T>& points, const VecX<T>& frame) {
    Columns<T> y(m.shape.outputs(), points.cols());
    for (Index j = 0; j < points.cols(); ++j) {
        VecX<T> x(m.shape.inputs());
        x << points.col(j), frame;
        VecX<T> h = x;
        for (int l = 0; l < m.shape.layers(); ++l) {
            const std::size_t i = static_cast<std::size_t>(l);
            VecX<T> in = h;
            if (l == m.shape.skip()) {
                in.resize(h.size() + x.size());
                in << h, x;
            }
            h = m.weight[i] * in + m.bias[i].col(0);
            if (l + 1 < m.shape.layers())
                for (Index k = 0; k < h.size(); ++k) h(k) = h(k) > 0 ? h(k) : T(0.01) * h(k);
        }
        y.col(j) = h;
    }
    return y;
}

const MlpShape small{{12, 16, 24, 16, 5}, 7};

} // namespace

TEST_CASE("mlp: parameter counts of the published networks") {
    const auto count = [](std::vector<int> dims) {
        return count_fields(Mlp<float>(MlpShape{dims}));
    };
    CHECK(count({27, 256, 256, 256, 256, 256, 132}) == 311172);
    CHECK(count({192, 256, 256, 32}) == 129568);
    CHECK(count({182, 128, 32}) == 33376);
    CHECK(count({91, 256, 256, 256, 256, 256, 3}) == 310787);
    CHECK(count({81, 256, 256, 3}) == 87798);
    CHECK(count({192, 256, 256, 256, 8}) == 232200);
    CHECK(count({182, 128, 128, 8}) == 42424);
    CHECK(count({45, 256, 256, 3}) == 78474);
    CHECK(count({146, 128, 32}) == 27616);
    CHECK(count({118, 128, 128, 6}) == 33226);
}

TEST_CASE("mlp: fields carry the published names, in order") {
    std::vector<std::string> names;
    const Mlp<float> m(MlpShape{{3, 4, 2}});
    Mlp<float>::fields([&](const std::string& n, const auto&) { names.push_back(n); }, m);
    CHECK(names ==
          std::vector<std::string>{"conv0.weight", "conv0.bias", "conv1.weight", "conv1.bias"});
}

TEST_CASE("mlp: equals the network written out, with and without frame inputs") {
    for (const MlpShape& s : {small, MlpShape{{12, 16, 24, 16, 5}, 0}, MlpShape{{6, 4}, 2},
                              MlpShape{{6, 8, 3}, 6}, MlpShape{{9, 300, 3}, 2}}) {
        const Mlp<double> m = Mlp<double>::init(s, Random{7, 0});
        const Columns<double> x = random_columns<double>(s.point_inputs(), 777, 1);
        const VecX<double> f = random_columns<double>(s.frame_inputs, 1, 2);
        const Columns<double> expected = plain_mlp(m, x, f);
        MlpTrace<double> trace;
        CHECK((mlp_forward(ScalarBackend<>{}, m, x, f, nullptr) - expected).cwiseAbs().maxCoeff() <
              1e-13);
        CHECK((mlp_forward(ScalarBackend<>{}, m, x, f, &trace) - expected).cwiseAbs().maxCoeff() <
              1e-13);
        CHECK((mlp_forward(XsimdBackend<>{}, m, x, f, &trace) - expected).cwiseAbs().maxCoeff() <
              1e-13);
    }
}

TEST_CASE("mlp: gradients add up, and null outputs are allowed") {
    const Mlp<double> m = Mlp<double>::init(small, Random{7, 0});
    const Columns<double> x = random_columns<double>(5, 90, 1),
                          w = random_columns<double>(5, 90, 2);
    const VecX<double> f = random_columns<double>(7, 1, 3);
    MlpTrace<double> trace;
    mlp_forward(ScalarBackend<>{}, m, x, f, &trace);
    Mlp<double> once(small), twice(small);
    mlp_vjp(ScalarBackend<>{}, m, {x, f, trace}, w, {once});
    for (int i = 0; i < 2; ++i)
        mlp_vjp(ScalarBackend<>{}, m, {x, f, trace}, w, {twice});
    CHECK(once.weight[1].norm() > 0);
    for (std::size_t l = 0; l < 4; ++l) {
        CHECK(twice.weight[l].isApprox(2 * once.weight[l], 1e-14));
        CHECK(twice.bias[l].isApprox(2 * once.bias[l], 1e-14));
    }
}

TEST_CASE("mlp: the same bits with any kind of threads, and none points") {
    const Mlp<float> m = Mlp<float>::init(small, Random{7, 0});
    const Columns<float> x = random_columns<float>(5, 9000, 1),
                         w = random_columns<float>(5, 9000, 2);
    const VecX<float> f = random_columns<float>(7, 1, 3);
    const auto run = [&]<class B>(B, Index n) {
        MlpTrace<float> trace;
        Mlp<float> g(small);
        Columns<float> gx;
        mlp_forward(B{}, m, x.leftCols(n), f, &trace);
        mlp_vjp(B{}, m, {x.leftCols(n), f, trace}, w.leftCols(n), {g, &gx});
        CHECK(gx.cols() == n);
        return g;
    };
    const Mlp<float> a = run(XsimdBackend<DefaultArch, Serial>{}, 9000);
    const Mlp<float> b = run(XsimdBackend<DefaultArch, DefaultThreads>{}, 9000);
    for (std::size_t l = 0; l < 4; ++l) CHECK(a.weight[l] == b.weight[l]);
    const Mlp<float> z = run(XsimdBackend<>{}, 0);
    for (std::size_t l = 0; l < 4; ++l) CHECK(z.weight[l].isZero(0));
}

TEST_CASE("mlp: a bad shape is refused") {
    CHECK_THROWS_AS(Mlp<float>(MlpShape{{3}}), Error);
    CHECK_THROWS_AS(Mlp<float>(MlpShape{{3, 4}, 5}), Error);
}
