// SPDX-License-Identifier: Apache-2.0
// Gazes at a point, against the eyeballs that are then drawn.
#include <rye/avatar/gaze_at.hpp>

#include <doctest/doctest.h>

#include <Eigen/LU>

#include <rye/avatar/hold.hpp>
#include <rye/avatar/trained.hpp>
#include <rye/backend/scalar.hpp>

#include "../support/tiny_avatar.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// The place of an eyeball's drawn Gaussians: its centre, and its own z axis as a unit vector,
/// world.
struct DrawnEye {
    Vec3<double> centre, axis;
};
/// Found by least squares from the template's points and the drawn ones, whatever moved them.
DrawnEye drawn_eye(const Columns<double>& at_rest, const Columns<double>& drawn) {
    Columns<double> x(at_rest.cols(), 4);
    x << at_rest.transpose(), Columns<double>::Ones(at_rest.cols(), 1);
    const Eigen::Matrix4d square = x.transpose() * x;
    const Eigen::Matrix<double, 4, 3> affine =
        square.inverse() * (x.transpose() * drawn.transpose());
    return {affine.row(3).transpose(), affine.row(2).transpose().normalized()};
}

} // namespace

TEST_CASE("gaze at: the eyes that are drawn look at the point, with offset, pose and kappa") {
    const AvatarConfig config = tiny_config();
    const LandmarkRoles roles = tiny_roles();
    Draw draw;
    TwoStream<double, TrainedEffects> avatar =
        restricted<TrainedEffects>(tiny_avatar(config, draw));
    const ScalarBackend<> backend;
    double worst = 0;
    for (const bool has_kappa : {false, true}) {
        avatar.eyes.kappa = Columns<double>(0, 0);
        if (has_kappa) {
            avatar.eyes.kappa.resize(2, 2);
            avatar.eyes.kappa << -0.03, -0.02, 0.09, -0.08;
        }
        for (const double turn : {0.0, -0.5, 0.7})
            for (const double distance : {3.0, 6.0, 20.0}) {
                Drivers<double> drivers = tiny_drivers<double>();
                drivers.pose[1] += turn;
                const HeadPlacement<double> head = head_placement(drivers);
                const Vec3<double> in_head(0.3 * distance, -0.1 * distance, distance);
                const Vec3<double> world =
                    head.world_from_head.apply(Vec3<double>(head.scale * in_head));
                const auto eyes = gazes_at(backend, avatar.eyes, config, drivers,
                                           target_in_head(head, GazeTarget<double>{world}));
                const auto centre = driven_eye_centres(backend, avatar.eyes, config, drivers);
                for (std::size_t e = 0; e < 2; ++e) {
                    CHECK(eyes[e].missed == 0);
                    drivers.gaze[e] = eyes[e].visual;
                }
                const auto own = restricted<TrainedEffects>(drivers);
                TwoStreamTrace<double, TrainedEffects> trace;
                drive(backend, avatar, {config, roles, own}, trace);
                const Index faces = avatar.face.position.cols();
                for (std::size_t e = 0; e < 2; ++e) {
                    const Index eye = static_cast<Index>(e), n = avatar.eyes.points_of(eye),
                                first = avatar.eyes.first_point(eye);
                    const DrawnEye drawn =
                        drawn_eye(avatar.eyes.position.middleCols(first, n),
                                  trace.gaussians.mean.middleCols(faces + first, n));
                    const Vec3<double> placed =
                        head.world_from_head.apply(Vec3<double>(head.scale * centre[e]));
                    CHECK((drawn.centre - placed).norm() < 1e-12);
                    const Vec3<double> axis =
                        gaze_in_head(head.world_from_head.rotation, drawn.axis);
                    const double k0 = has_kappa ? avatar.eyes.kappa(0, eye) : 0,
                                 k1 = has_kappa ? avatar.eyes.kappa(1, eye) : 0;
                    const double pitch = std::asin(axis.y()) - k0,
                                 yaw = std::atan2(axis.x(), axis.z()) - k1;
                    const Vec3<double> along =
                        gaze_in_world(head.world_from_head.rotation,
                                      Vec3<double>(std::cos(pitch) * std::sin(yaw), std::sin(pitch),
                                                   std::cos(pitch) * std::cos(yaw)));
                    const Vec3<double> d = world - drawn.centre;
                    worst = std::max(worst, 100 * (d - along * along.dot(d)).norm());
                }
            }
    }
    MESSAGE("a drawn eye's visual axis passes the point at ", worst, " mm");
    CHECK(worst < 1e-8);
}
