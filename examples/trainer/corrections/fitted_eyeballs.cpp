// SPDX-License-Identifier: Apache-2.0
#include "corrections/fitted_eyeballs.hpp"

#include <cmath>

#include <Eigen/Eigenvalues>

#include <rye/math/rotation.hpp>

#include "data/degrees.hpp"
#include "data/median.hpp"

namespace rye::trainer {
namespace {

constexpr std::size_t fewest = 6; // frames with an iris

/// Iris of a frame in the head, and the gaze of its label.
struct PlacedIris {
    Vec3<double> at, gaze;
};

/// Returns the point that is nearest to the rays of these views to an iris, in the head's frame;
/// nothing if they are nearly parallel.
std::optional<Vec3<double>> met(const Capture& capture, int frame,
                                const std::vector<SeenIris>& views) {
    if (views.size() < 2) return std::nullopt;
    const CaptureFrame& f = capture.frame(frame);
    const Mat3<double> head = so3_exp(Vec3<double>(f.pose.head<3>())).transpose();
    std::vector<Vec3<double>> from;
    std::vector<Mat3<double>> beside; // projections beside the rays
    for (const SeenIris& v : views) {
        const Pinhole<double>& camera = capture.camera(frame, v.camera);
        const Vec3<double> in_camera((v.at.x() - camera.cx) / camera.fx,
                                     (v.at.y() - camera.cy) / camera.fy, 1);
        const Vec3<double> along = normalized(Vec3<double>(
            head * (camera.camera_from_world.rotation.transpose() * in_camera)));
        from.push_back(head * (camera.centre() - f.pose.tail<3>()) / f.scale);
        beside.push_back(Mat3<double>::Identity() - along * along.transpose());
    }
    constexpr int rounds = 6;
    constexpr double near = 0.005, least_angle = 8 * degree;
    std::vector<double> weight(views.size(), 1);
    Vec3<double> at = Vec3<double>::Zero();
    for (int round = 0; round < rounds; ++round) {
        Mat3<double> m = Mat3<double>::Zero();
        Vec3<double> rhs = Vec3<double>::Zero();
        double sum = 0;
        for (std::size_t i = 0; i < views.size(); ++i) {
            const double w = weight[i] * views[i].sharpness * views[i].sharpness;
            m += w * beside[i], rhs += w * (beside[i] * from[i]), sum += w;
        }
        const Eigen::SelfAdjointEigenSolver<Mat3<double>> axes(m);
        if (axes.eigenvalues()[0] < std::pow(std::sin(least_angle / 2), 2) * sum)
            return std::nullopt;
        at = axes.eigenvectors() *
             (axes.eigenvectors().transpose() * rhs).cwiseQuotient(axes.eigenvalues());
        for (std::size_t i = 0; i < views.size(); ++i)
            weight[i] = 1 / (1 + (beside[i] * (at - from[i])).squaredNorm() / (near * near));
    }
    return at;
}

/// Returns the centre from which the irises lie in the directions of their gazes.
Vec3<double> centre_behind(const std::vector<PlacedIris>& irises, const Vec3<double>& assumed) {
    constexpr int rounds = 20;
    constexpr double prior = 0.04, error = 5 * degree, far = 8 * degree;
    Vec3<double> centre = assumed;
    for (int round = 0; round < rounds; ++round) {
        Mat3<double> m = Mat3<double>::Identity() / (prior * prior);
        Vec3<double> rhs = (assumed - centre) / (prior * prior);
        for (const PlacedIris& iris : irises) {
            const Vec3<double> to = iris.at - centre;
            const Vec3<double> axis = normalized(to), off = iris.gaze - axis;
            const Mat3<double> by = -(Mat3<double>::Identity() - axis * axis.transpose()) /
                                    to.norm(); // derivative of axis by centre
            const double w = 1 / (error * error * (1 + off.squaredNorm() / (far * far)));
            m += w * by.transpose() * by;
            rhs += w * by.transpose() * off;
        }
        centre += m.ldlt().solve(rhs);
    }
    return centre;
}

/// Moves the centres of both eyes half of the way to where their displacements from the assumed
/// ones are mirror images: a head's eyes lie alike to about a millimetre, which is also how far
/// wrong gazes displace a centre, and a gaze error of both eyes displaces them to the same side.
void make_alike(std::array<Vec3<double>, 2>& centres, const std::array<EyeballInHead, 2>& assumed) {
    const Vec3<double> mirror(-1, 1, 1);
    const Vec3<double> left = centres[0] - assumed[0].centre,
                       right = mirror.cwiseProduct(centres[1] - assumed[1].centre);
    const Vec3<double> unlike = (left - right) / 4;
    centres[0] -= unlike;
    centres[1] += mirror.cwiseProduct(unlike);
}

} // namespace

std::optional<std::array<EyeballInHead, 2>>
fitted_eyeballs(const Capture& capture, const std::vector<int>& frames,
                const std::array<EyeballInHead, 2>& assumed, double area_error) {
    std::array<EyeballInHead, 2> balls = assumed;
    constexpr int rounds = 2; // where an iris is seen depends a little on the ball
    for (int round = 0; round < rounds; ++round) {
        const std::vector<std::array<std::vector<SeenIris>, 2>> seen =
            seen_irises(capture, frames, {frames.size(), balls}, area_error);
        std::array<std::vector<PlacedIris>, 2> both;
        std::array<Vec3<double>, 2> centres;
        for (std::size_t e = 0; e < 2; ++e) {
            std::vector<PlacedIris>& irises = both[e];
            for (std::size_t i = 0; i < frames.size(); ++i)
                if (const auto at = met(capture, frames[i], seen[i][e]))
                    irises.push_back({*at, capture.frame(frames[i]).eyes[e].optical});
            if (irises.size() < fewest || 2 * irises.size() < frames.size()) return std::nullopt;
            centres[e] = centre_behind(irises, assumed[e].centre);
        }
        make_alike(centres, assumed);
        for (std::size_t e = 0; e < 2; ++e) {
            std::vector<double> distances;
            for (const PlacedIris& iris : both[e])
                distances.push_back((iris.at - centres[e]).norm());
            const double distance = median(distances), ratio = distance / assumed[e].iris_plane;
            constexpr double most = 1.6; // of an average eye's
            if (!(ratio < most && ratio > 1 / most)) return std::nullopt;
            balls[e] = {centres[e], ratio * assumed[e].radius, assumed[e].limbus_radius, distance};
        }
    }
    return balls;
}

} // namespace rye::trainer
