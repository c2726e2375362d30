// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/head_model.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <rye/math/linalg.hpp>

#include "data/degrees.hpp"
#include "synthetic_capture/noise.hpp"

namespace rye::trainer {
namespace {

/// Rotation of the eye at which the lid coefficients reach 1 [deg].
constexpr double full_pitch_deg = 30, full_yaw_deg = 35;

} // namespace

double Eyeball::iris_plane() const {
    return std::sqrt(radius * radius - limbus_radius * limbus_radius);
}

double Eyeball::surface(double angle) const {
    if (angle >= std::asin(limbus_radius / radius)) return radius;
    const double sagitta = std::sqrt(cornea_radius * cornea_radius - limbus_radius * limbus_radius);
    const double ahead = iris_plane() - sagitta; // of the cornea's centre
    const double side = ahead * std::sin(angle);
    return ahead * std::cos(angle) + std::sqrt(cornea_radius * cornea_radius - side * side);
}

EyeballMesh eyeball_mesh(const Eyeball& eye) {
    constexpr int around = 48;
    // Rings by their angle from the axis: fine over cornea and visible sclera, coarse behind.
    std::vector<double> rings;
    const double limbus = std::asin(eye.limbus_radius / eye.radius);
    for (int i = 1; i <= 7; ++i) rings.push_back(limbus * i / 7);
    for (double a = limbus + 3.5 * degree; a < 100 * degree; a += 3.5 * degree) rings.push_back(a);
    for (double a = rings.back() + 12 * degree; a < 175 * degree; a += 12 * degree)
        rings.push_back(a);

    const Index n = static_cast<Index>(rings.size());
    EyeballMesh mesh;
    mesh.vertices.resize(3, n * around + 2);
    mesh.vertices.col(0) << 0, 0, eye.surface(0);
    mesh.vertices.col(1) << 0, 0, -eye.radius;
    const auto at = [&](Index ring, Index turn) { return 2 + ring * around + turn % around; };
    for (Index r = 0; r < n; ++r)
        for (Index t = 0; t < around; ++t) {
            const double a = rings[static_cast<std::size_t>(r)];
            const double b = 2 * std::numbers::pi * static_cast<double>(t) / around;
            mesh.vertices.col(at(r, t)) =
                eye.surface(a) *
                Vec3<double>(std::sin(a) * std::cos(b), std::sin(a) * std::sin(b), std::cos(a));
        }
    for (Index t = 0; t < around; ++t) {
        mesh.faces.push_back({0, at(0, t), at(0, t + 1)});
        mesh.faces.push_back({1, at(n - 1, t + 1), at(n - 1, t)});
        for (Index r = 0; r + 1 < n; ++r) {
            mesh.faces.push_back({at(r, t), at(r + 1, t), at(r + 1, t + 1)});
            mesh.faces.push_back({at(r, t), at(r + 1, t + 1), at(r, t + 1)});
        }
    }
    return mesh;
}

VecX<double> lid_coefficients(const std::array<Vec2<double>, 2>& optical_deg) {
    VecX<double> lids(8);
    for (int eye = 0; eye < 2; ++eye) {
        const Vec2<double>& d = optical_deg[static_cast<std::size_t>(eye)];
        const double out = (eye == 0 ? 1 : -1) * d.x() / full_yaw_deg, up = d.y() / full_pitch_deg;
        lids[eye] = std::clamp(up, 0.0, 1.0);
        lids[2 + eye] = std::clamp(-up, 0.0, 1.0);
        lids[4 + eye] = std::clamp(-out, 0.0, 1.0);
        lids[6 + eye] = std::clamp(out, 0.0, 1.0);
    }
    return lids;
}

void clear_eyeballs(Points& vertices, const std::array<Eyeball, 2>& eyes,
                    const std::array<Vec3<double>, 2>& gaze, double gap) {
    for (std::size_t e = 0; e < 2; ++e)
        for (Index i = 0; i < vertices.cols(); ++i) {
            const Vec3<double> arm = vertices.col(i) - eyes[e].centre;
            const double length = arm.norm();
            if (length > 1.5 * eyes[e].radius || length == 0) continue;
            const double along = arm.dot(gaze[e]);
            if (along < 0) continue;
            const double angle = std::atan2(norm(cross(arm, gaze[e])), along);
            const double least = eyes[e].surface(angle) + gap;
            if (length < least) vertices.col(i) = eyes[e].centre + arm * (least / length);
        }
}

void displace_eye(Points& vertices, Eyeball& eye, const Vec3<double>& by) {
    if (by.isZero(0)) return;
    for (Index i = 0; i < vertices.cols(); ++i) {
        const double distance = (vertices.col(i) - eye.centre).norm() / eye.radius;
        vertices.col(i) += smooth_step(2.4, 1.4, distance) * by;
    }
    eye.centre += by;
}

} // namespace rye::trainer
