// SPDX-License-Identifier: Apache-2.0
// Lesson 13: labels found by forward mode. A picture shows an eye; which gaze was it? Duals say
// how each Gaussian moves with pitch and yaw, jvp() how the picture does: two columns of a
// Jacobian. Gauss-Newton steps do the rest. `rye refine` does this with heads.
#include <array>
#include <cstdio>
#include <numbers>

#include <rye/math/levenberg.hpp>
#include <rye/rig/eye_transform.hpp>
#include <rye/rig/eyeball.hpp>
#include <rye/splat/jvp.hpp>

using namespace rye;

namespace {

const EyeballTemplate<double> eyeball = eyeball_template<double>(EyeballShape{});

/// The eyeball's points at a gaze, for numbers and for duals.
template <class T>
Columns<T> points_at(const T& pitch, const T& yaw) {
    const EyeDrive<T> drive{.centre = Vec3<T>(T(0), T(0), T(0)), .gaze = gaze_vector(pitch, yaw)};
    const EyeTransform<T> turn = eye_transform(drive, HeadPlacement<T>{});
    return eye_points(turn, Columns<T>(eyeball.points.cast<T>()));
}

Gaussians<double> gaussians_at(const VecX<double>& gaze) {
    Gaussians<double> g(eyeball.points.cols(), 1);
    g.mean = points_at(gaze[0], gaze[1]);
    g.rotation.colwise() = Vec<double, 4>(1, 0, 0, 0);
    g.opacity.setConstant(0.9);
    for (Index i = 0; i < g.mean.cols(); ++i) {
        g.scale.col(i).setConstant(0.6 * eyeball.spacing(0, i));
        const bool iris = eyeball.labels[static_cast<std::size_t>(i)] == EyeLabel::iris;
        g.feature(0, i) = iris ? 0.1 : 0.9;
    }
    return g;
}

/// How the Gaussians move with pitch (k = 0) or yaw (k = 1).
Gaussians<double> motion_at(const VecX<double>& gaze, std::size_t k) {
    using D = Dual<double, 2>;
    const Columns<D> moving = points_at(D::variable(gaze[0], 0), D::variable(gaze[1], 1));
    Gaussians<double> t = zeros_like(gaussians_at(gaze));
    for (Index i = 0; i < moving.size(); ++i) t.mean(i) = moving(i).d[k];
    return t;
}

} // namespace

int main() {
    constexpr double degree = std::numbers::pi / 180;
    const auto camera = look_at<double>({0, 0, 2}, {0, 0, 0}, {0, 1, 0}, 0.2, {48, 48});
    const VecX<double> skin = VecX<double>::Constant(1, 0.6);
    const ScalarBackend backend;
    const Rasterizer rasterizer;
    const auto picture = [&](const VecX<double>& gaze) {
        return rasterizer.forward(backend, gaussians_at(gaze), camera, skin).feature.pixels;
    };
    const VecX<double> truth = Vec2<double>(8 * degree, -12 * degree);
    const Columns<double> photograph = picture(truth);

    const auto cost = [&](const VecX<double>& gaze) {
        return (picture(gaze) - photograph).squaredNorm();
    };
    const auto linearized = [&](const VecX<double>& gaze) { // J^T J and J^T r, by two jvps
        const Gaussians<double> g = gaussians_at(gaze);
        Columns<double> jacobian(photograph.size(), 2);
        Columns<double> residual;
        for (std::size_t k = 0; k < 2; ++k) {
            const Gaussians<double> motion = motion_at(gaze, k);
            const auto moved = rasterizer.jvp(backend, g, {.gaussians = &motion}, camera, skin);
            jacobian.col(static_cast<Index>(k)) = moved.feature.reshaped();
            residual = moved.value.feature.pixels - photograph;
        }
        return NormalEquations<double>{.cost = residual.squaredNorm(),
                                       .matrix = jacobian.transpose() * jacobian,
                                       .gradient = jacobian.transpose() * residual.reshaped()};
    };
    const VecX<double> label = Vec2<double>(0, 0); // 14 degrees beside it
    const auto found = levenberg<double>(label, {.tolerance = 1e-9}, linearized, cost);
    std::printf("found in %d steps: pitch %.4f yaw %.4f; true: pitch %.2f yaw %.2f\n", found.steps,
                found.x[0] / degree, found.x[1] / degree, truth[0] / degree, truth[1] / degree);
    return (found.x - truth).norm() < 0.01 * degree ? 0 : 1;
}
