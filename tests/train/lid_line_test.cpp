// SPDX-License-Identifier: Apache-2.0
// Places on the lids' lines, before training and when the face gets other Gaussians.
#include <rye/train/lid_line.hpp>

#include <cmath>
#include <set>

#include <doctest/doctest.h>

#include <rye/avatar/hold.hpp>
#include <rye/train/density.hpp>

#include "../support/tiny_avatar.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using E = More<PaperEffects, LidShadow>;

/// The tiny avatar with two open eyes: six landmarks around each as in the capture, a grid of
/// Gaussians over both, and eyeballs behind them.
struct OpenEyes {
    TwoStream<double, E> avatar;
    LandmarkRoles roles = tiny_roles();

    OpenEyes() {
        Draw draw;
        avatar = restricted<E>(tiny_avatar(tiny_config(), draw));
        for (Index eye = 0; eye < 2; ++eye)
            for (Index k = 0; k < 6; ++k) {
                const double x[] = {-0.12, -0.05, 0.05, 0.12, 0.05, -0.05},
                             y[] = {0, 0.05, 0.055, 0.01, -0.04, -0.04};
                avatar.face.landmarks.col((eye == 0 ? 42 : 36) + k) << middle(eye) + x[k],
                    0.3 + y[k], 0.9;
            }
        const Index side = 40;
        Columns<double>& p = avatar.face.position;
        p.resize(3, 2 * side * side);
        for (Index eye = 0, i = 0; eye < 2; ++eye)
            for (Index a = 0; a < side; ++a)
                for (Index b = 0; b < side; ++b, ++i)
                    p.col(i) << middle(eye) + 0.3 * (double(a) / side - 0.5),
                        0.3 + 0.2 * (double(b) / side - 0.5), 0.9;
        avatar.eyes.centre << middle(0), middle(1), 0.3, 0.3, 0.8, 0.8;
    }
    static double middle(Index eye) { return eye == 0 ? 0.3 : -0.3; }
    /// Place k, and the Gaussian that carries it.
    Vec2<double> place(Index k) const { return avatar.eyes.lid_line.col(k).tail<2>(); }
    Vec2<double> carrier(Index k) const {
        return avatar.face.position.col(detail::lid_column(avatar.eyes.lid_line, k)).head<2>();
    }
};

} // namespace

TEST_CASE("lid line: places along the upper lid, each carried by the nearest Gaussian") {
    OpenEyes eyes;
    REQUIRE(begin_lid_shadow(eyes.avatar, eyes.roles));
    CHECK(eyes.avatar.eyes.lid_line.cols() == 2 * lid_line_points);
    CHECK(eyes.avatar.eyes.lid_shadow.cols() == 2);
    std::set<Index> chosen;
    for (Index k = 0; k < 2 * lid_line_points; ++k) {
        const Index eye = k / lid_line_points, i = k % lid_line_points;
        chosen.insert(detail::lid_column(eyes.avatar.eyes.lid_line, k));
        const double x = -0.12 + 0.24 * double(i) / double(lid_line_points - 1);
        const double y = x < -0.05  ? 0.05 * (x + 0.12) / 0.07
                         : x < 0.05 ? 0.05 + 0.005 * (x + 0.05) / 0.1
                                    : 0.055 - 0.045 * (x - 0.05) / 0.07;
        // Places are a little before their chord.
        CHECK(std::abs(eyes.place(k).x() - OpenEyes::middle(eye) - x) < 0.005);
        CHECK(std::abs(eyes.place(k).y() - 0.3 - y) < 0.005);
        CHECK((eyes.carrier(k) - eyes.place(k)).norm() < 0.005); // half a cell of the grid
    }
    CHECK(chosen.size() == std::size_t(2 * lid_line_points));
}

TEST_CASE("lid line: without landmarks of an upper lid there is no shadow") {
    const auto refused = [](const auto& spoil) {
        OpenEyes eyes;
        spoil(eyes);
        CHECK_FALSE(begin_lid_shadow(eyes.avatar, eyes.roles));
        return !eyes.avatar.eyes.has_lid_shadow();
    };
    CHECK(refused([](OpenEyes& e) { e.roles.eye[1].clear(); }));
    CHECK(refused([](OpenEyes& e) { e.avatar.face.landmarks.resize(3, 0); }));
    CHECK(refused([](OpenEyes& e) { e.avatar.face.landmarks.row(1).setConstant(0.3); }));
    CHECK(refused([](OpenEyes& e) { e.roles.eye[0].resize(1); }));
    CHECK(refused([](OpenEyes& e) {
        const Columns<double> few = e.avatar.face.position.leftCols(lid_line_points - 1);
        e.avatar.face.position = few;
    }));
}

TEST_CASE("lid line: follows Gaussians that split, and goes to the nearest where one is pruned") {
    Draw draw;
    TwoStream<double, E> avatar = restricted<E>(tiny_avatar(tiny_config(), draw));
    avatar.eyes.lid_shadow = Columns<double>::Zero(3, 2);
    avatar.eyes.lid_line.setOnes(3, 6);
    avatar.eyes.lid_line.row(0) << 2, 3, 40, 10, 58, 59;
    Adam<TwoStream<double, E>> adam(avatar);
    adam.v.face.position.setConstant(1);
    adam.v.face.position.col(3).setConstant(5); // splits
    avatar.face.opacity_logit.setConstant(1);
    for (const Index gone : {0, 5, 40}) avatar.face.opacity_logit(0, gone) = -20;
    const Columns<double> before = avatar.face.position;
    DensityConfig config;
    config.every = 1;
    config.grow = 1.5 / 60;
    config.prefer = 1;
    const DensityChange change = change_density(ScalarBackend<Serial>{}, avatar, adam, config);
    REQUIRE((change.grown == 1 && change.pruned == 3));
    Index nearest = -1;
    for (Index i = 0; i < 60; ++i)
        if (i != 0 && i != 5 && i != 40 &&
            (nearest < 0 || (before.col(i) - before.col(40)).norm() <
                                (before.col(nearest) - before.col(40)).norm()))
            nearest = i;
    const Index from[] = {2, 3, nearest, 10, 58, 59};
    for (Index k = 0; k < 6; ++k) {
        CAPTURE(k);
        const Index i = detail::lid_column(avatar.eyes.lid_line, k);
        CHECK(avatar.face.feature.cols() == 58);
        CHECK(avatar.eyes.lid_line.bottomRows(2).isOnes(0));
        if (from[k] == 3) {
            const Vec3<double> middle =
                0.5 * (avatar.face.position.col(i) + avatar.face.position.col(i + 1));
            CHECK((middle - before.col(3)).norm() < 1e-14);
        } else {
            CHECK(avatar.face.position.col(i) == before.col(from[k]));
        }
    }
}
