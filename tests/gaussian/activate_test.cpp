// SPDX-License-Identifier: Apache-2.0
// Activation of stored numbers and its derivatives, by the dot-product test against duals.
#include <rye/gaussian/activate.hpp>

#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>
#include <rye/core/random.hpp>

using namespace rye;

namespace {

template <class P>
void fill(P& p, std::uint64_t seed) {
    std::uint64_t k = 0;
    P::fields(
        [&](const std::string&, auto& a) {
            for (Index i = 0; i < a.size(); ++i) a.data()[i] = Random{seed, 2}.normal(k++);
        },
        p);
}

} // namespace

TEST_CASE("activate: dot-product test at every degree") {
    using D = Dual<double, 1>;
    for (int degree = 0; degree <= 4; ++degree) {
        GaussianCloud<double> cloud(40, degree), v(40, degree);
        fill(cloud, 1);
        fill(v, 2);
        const Vec3<double> eye(0.1, -0.2, 0.4);
        cloud.mean.col(3) << eye[0], eye[1], eye[2];                // no direction
        v.mean.col(3).setZero();
        GaussianCloud<D> dual(40, degree);
        convert_fields(dual, cloud, [](double x) { return D(x); });
        GaussianCloud<D>::fields(
            [](const std::string&, Columns<D>& a, const Columns<double>& d) {
                for (Index i = 0; i < a.size(); ++i) a.data()[i].d[0] = d.data()[i];
            },
            dual, v);
        const Gaussians<double> drawn = activate(cloud, eye);
        const Gaussians<D> moved = activate(dual, Vec3<D>(eye.cast<D>()));
        Gaussians<double> w(40, 3);
        fill(w, 3);
        const GaussianCloud<double> g = activate_vjp(cloud, eye, drawn, w);
        double forward = 0, reverse = 0, scale = 0;
        Gaussians<D>::fields(
            [&](const std::string&, const Columns<D>& a, const Columns<double>& b) {
                for (Index i = 0; i < a.size(); ++i) forward += a.data()[i].d[0] * b.data()[i];
            },
            moved, w);
        GaussianCloud<double>::fields(
            [&](const std::string& name, const Columns<double>& a, const Columns<double>& b) {
                CHECK_MESSAGE(a.allFinite(), name);
                reverse += a.cwiseProduct(b).sum();
                scale += a.cwiseProduct(b).cwiseAbs().sum();
            },
            g, v);
        CHECK(std::abs(forward - reverse) <= 1e-14 * scale);
    }
}

TEST_CASE("activate: bands above the most are as if they were 0, and bands of 0 change no bit") {
    GaussianCloud<double> cloud(20, 3), low(20, 1);
    fill(cloud, 6);
    low.mean = cloud.mean, low.rotation = cloud.rotation, low.log_scale = cloud.log_scale;
    low.logit_opacity = cloud.logit_opacity, low.sh_constant = cloud.sh_constant;
    GaussianCloud<double> silent = cloud;
    silent.sh_rest.setZero();
    for (Index c = 0; c < 3; ++c) {  // a band of three of the fifteen coefficients of a channel
        low.sh_rest.middleRows(3 * c, 3) = cloud.sh_rest.middleRows(15 * c, 3);
        silent.sh_rest.middleRows(15 * c, 3) = cloud.sh_rest.middleRows(15 * c, 3);
    }
    const Vec3<double> eye(0.1, -0.2, 0.4);
    const Gaussians<double> drawn = activate<1>(cloud, eye);
    CHECK(drawn.feature == activate(low, eye).feature);
    CHECK(drawn.feature == activate(silent, eye).feature);
    CHECK(drawn.feature != activate(cloud, eye).feature);
    CHECK(activate<4>(low, eye).feature == activate(low, eye).feature);
    Gaussians<double> w(20, 3);
    fill(w, 7);
    const auto g = activate_vjp<1>(cloud, eye, drawn, w);
    const auto g_low = activate_vjp(low, eye, drawn, w);
    CHECK(g.mean == g_low.mean);
    CHECK(g.sh_constant == g_low.sh_constant);
    for (Index c = 0; c < 3; ++c) {
        CHECK(g.sh_rest.middleRows(15 * c, 3) == g_low.sh_rest.middleRows(3 * c, 3));
        CHECK(g.sh_rest.middleRows(15 * c + 3, 12).isZero(0));
    }
}

TEST_CASE("activate: the gate of a colour below zero is shut both ways") {
    GaussianCloud<double> cloud(1, 0);
    fill(cloud, 4);
    for (const double c :
         {-0.5 / detail::sh_factor(0) * (1 + 1e-12), -0.5 / detail::sh_factor(0) * (1 - 1e-12)}) {
        cloud.sh_constant.setConstant(c);
        const Gaussians<double> drawn = activate(cloud, Vec3<double>(1, 2, 3));
        Gaussians<double> w(1, 3);
        w.mean.setZero(), w.rotation.setZero(), w.scale.setZero(), w.opacity.setZero();
        w.feature.setOnes();
        const auto g = activate_vjp(cloud, Vec3<double>(1, 2, 3), drawn, w);
        CHECK((drawn.feature(0, 0) > 0) == (g.sh_constant(0, 0) > 0));
    }
}

TEST_CASE("activate: deactivate draws the same") {
    GaussianCloud<double> cloud(20, 0);
    fill(cloud, 5);
    cloud.sh_constant = cloud.sh_constant.cwiseAbs();
    const Vec3<double> eye(0, 0, 0);
    const Gaussians<double> once = activate(cloud, eye), twice = activate(deactivate(once), eye);
    CHECK((once.scale - twice.scale).cwiseAbs().maxCoeff() < 1e-14);
    CHECK((once.opacity - twice.opacity).cwiseAbs().maxCoeff() < 1e-14);
    CHECK((once.feature - twice.feature).cwiseAbs().maxCoeff() < 1e-14);
}
