// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/head_shading.hpp>

#include <cmath>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>

#include "../support/avatar_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Shaded = More<PaperEffects, HeadShading>;

TwoStream<double, Shaded> shaded_avatar() { return restricted<Shaded>(avatar_of_optics()); }
Drivers<double, Shaded> shaded_drivers() { return restricted<Shaded>(drivers_of_optics()); }

} // namespace

TEST_CASE("shading: log gains are differences of harmonics at turned and unturned normals") {
    const TwoStream<double, Shaded> avatar = shaded_avatar();
    const Drivers<double, Shaded> at = shaded_drivers();
    const auto with = driven(avatar, at);
    const auto without = driven(restricted<PaperEffects>(avatar), restricted<PaperEffects>(at));
    const Mat3<double> r = so3_exp(Vec3<double>(at.pose.head<3>()));
    const Index n = with.face_count;
    double most = 0;
    for (Index i = 0; i < with.gaussians.count(); ++i) {
        const Index eye = i < n + avatar.eyes.points_of(0) ? 0 : 1;
        const Vec3<double> normal =
            i < n ? avatar.shading.normal.col(i) : avatar.shading.eye_normal.col(eye);
        const auto here = sh_basis<double, 2>(normal), turned = sh_basis<double, 2>(r * normal);
        for (Index c = 0; c < 3; ++c) {
            double log_gain = 0;
            for (std::size_t k = 1; k < 9; ++k)
                log_gain += avatar.shading.light(Index(k) - 1, c) * (turned[k] - here[k]);
            const double expected = without.gaussians.feature(c, i) * std::exp(log_gain);
            most = std::max(most, std::abs(with.gaussians.feature(c, i) - expected));
        }
    }
    CHECK(most <= 1e-14);
    const Index rest = with.gaussians.feature.rows() - 3;
    CHECK(with.gaussians.feature.bottomRows(rest) == without.gaussians.feature.bottomRows(rest));
    CHECK(with.gaussians.mean == without.gaussians.mean);
    CHECK(with.gaussians.feature != without.gaussians.feature);
}

TEST_CASE("shading: nothing at rotation 0, wherever the head is, to the bit") {
    const TwoStream<double, Shaded> avatar = shaded_avatar();
    Drivers<double, Shaded> at = shaded_drivers();
    at.pose.head<3>().setZero();
    const auto colours = [&](const auto& a, const auto& d) {
        return driven(a, d).gaussians.feature;
    };
    CHECK(colours(avatar, at) ==
          colours(restricted<PaperEffects>(avatar), restricted<PaperEffects>(at)));
    at.pose[1] = 0.1;
    CHECK(colours(avatar, at) !=
          colours(restricted<PaperEffects>(avatar), restricted<PaperEffects>(at)));
}

TEST_CASE("shading: the vjp is the transpose of the duals") {
    CHECK(law_error<More<AllEffects, HeadShading>>(1) <= 1e-12);
    CHECK(law_error<OpticsEffects>(2) <= 1e-11);
}

TEST_CASE("shading: the gradient is that of central differences") {
    CHECK(difference_error(shaded_avatar(), shaded_drivers(), 5) <= 1e-6);
}

TEST_CASE("shading: an avatar without its parameters is not shaded, and has no tensor of it") {
    TwoStream<double, Shaded> avatar = shaded_avatar();
    const auto tensors = [&] {
        std::string names;
        TwoStream<double, Shaded>::fields(
            [&](const std::string& name, const auto&) { names += name + " "; }, avatar);
        return names;
    };
    CHECK(tensors().find("shading.light shading.normal shading.eye_normal") != std::string::npos);
    avatar.shading = {};
    CHECK(tensors().find("shading") == std::string::npos);
    const Drivers<double, Shaded> at = shaded_drivers();
    CHECK(driven(avatar, at).gaussians.feature ==
          driven(restricted<PaperEffects>(avatar), restricted<PaperEffects>(at)).gaussians.feature);
    CHECK(law_error<Shaded>(avatar, at, 6) <= 1e-12);
}

TEST_CASE("shading: a light that a head turned under is found again from its colours") {
    // Normals and colours at rest are known; the light follows from colours at a few rotations.
    const Index n = 40;
    Draw draw{{9, 1}};
    Shading<double> truth = initial_shading<double>(draw.columns(3, n));
    truth.normal.colwise().normalize();
    truth.light = draw.columns(8, 3, 0.6);
    Shading<double> found = truth;
    found.light.setZero();
    const Columns<double> rest = draw.columns(3, n + 2).array() + 1.5;
    const std::vector<Vec3<double>> turns{{0.3, 0, 0}, {0, 0.4, 0}, {0, 0, 0.3}, {-0.2, 0.3, 0.1}};
    double first = 0, last = 0;
    for (int step = 0; step < 400; ++step) {
        Shading<double> gradient = zeros_like(found);
        double loss = 0;
        for (const Vec3<double>& turn : turns) {
            ShadingTrace<double> trace, seen;
            Columns<double> wanted = rest, got = rest;
            shade(ScalarBackend<>{}, truth, {turn, n, 1}, wanted, trace);
            shade(ScalarBackend<>{}, found, {turn, n, 1}, got, seen);
            Columns<double> g = got - wanted;
            loss += 0.5 * g.squaredNorm();
            shade_vjp(ScalarBackend<>{}, found, {{turn, n, 1}, got, seen}, g, gradient);
        }
        (step == 0 ? first : last) = loss;
        found.light -= 0.05 * gradient.light;
    }
    CHECK(first > 1);
    CHECK(last < 1e-3 * first);
}

static_assert(detail::is_absent<decltype(TwoStream<float>::shading)>);
static_assert(sizeof(TwoStream<float, Shaded>) ==
              sizeof(TwoStream<float>) + sizeof(Shading<float>));
