// SPDX-License-Identifier: Apache-2.0
/// tests/evaluate/drawn_eye.hpp: images of one eye with a known gaze, pixel by pixel: a sphere with
/// an iris and a pupil behind a clear cap, seen through an opening between lids.
/// World units about 1 dm, as in a capture; angles in degrees.
#pragma once

#include <cmath>
#include <cstdint>

#include <rye/core/random.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "corrections/gaze_estimator.hpp"

namespace rye::test {

inline constexpr double degree = 3.14159265358979323846 / 180;

struct DrawnEye {
    double pitch = 0, yaw = 0;                ///< gaze in the head's frame [deg]
    double camera_pitch = 0, camera_yaw = 0;  ///< direction of the camera from the eye [deg]
    double head_yaw = 0;                      ///< of the head in the world [deg]
    double upper = 1, lower = 1;  ///< opening above and below the eyeball's centre [radii]
    double sclera = 0.8, iris = 0.3, pupil = 0.05;  ///< brightness; skin is 0.55
    double iris_green = 0;        ///< how much brighter the iris is in green
    double shade = 0;             ///< darkening from the lower to the upper rim of the eyeball
    double noise = 0;             ///< standard deviation, per pixel and channel
    double skin_red = 0;          ///< by how much more red, and less blue, skin has than 0.55
    double iris_plane = 0;        ///< distance of the iris from the centre; 0: where it meets the sphere
    bool has_iris = true;
    int size = 64;                ///< edge of the image [px], five radii wide
};

struct EyePicture {
    Image<float> image;
    Columns<float> eye;  ///< 1 x pixels, 1 where the eyeball is visible
    Pinhole<double> camera;
    trainer::EyeballGeometry ball;
    Vec3<double> gaze;   ///< unit, head frame
};

/// 4 x 4 rays a pixel; the mask is that of the ray through the pixel's centre.
inline EyePicture draw(const DrawnEye& e) {
    const double radius = 0.12, limbus_radius = 0.06, distance = 10;
    EyePicture p{Image<float>(e.size, e.size, 3), Columns<float>::Zero(1, e.size * e.size), {}, {},
                 gaze_vector(e.pitch * degree, e.yaw * degree)};
    p.ball = {Vec3<double>(0.3, 0.2, 0.7), radius, limbus_radius,
              so3_exp(Vec3<double>(0, e.head_yaw * degree, 0)), e.iris_plane};
    const Vec3<double> from =
        p.ball.centre + distance * gaze_vector(e.camera_pitch * degree, e.camera_yaw * degree);
    p.camera = look_at<double>(from, p.ball.centre, Vec3<double>(0, 1, 0),
                               2 * std::atan(2.5 * radius / distance), {e.size, e.size});
    // Head frame: between the lids, whose rims are horizontal.
    const auto seen = [&](const Vec2<double>& pixel, Vec3<double>& direction) {
        const Vec3<double> ray = p.camera.ray(pixel), to = p.ball.centre - from;
        const Vec3<double> miss = to.dot(ray) * ray - to;
        const double half2 = radius * radius - miss.squaredNorm();
        if (half2 < 0) return false;
        direction = p.ball.head_rotation.transpose() * (miss - std::sqrt(half2) * ray) / radius;
        return direction.y() < e.upper && direction.y() > -e.lower && direction.z() > 0;
    };
    const double plane = e.iris_plane > 0
                             ? e.iris_plane
                             : std::sqrt(radius * radius - limbus_radius * limbus_radius);
    // Distance from the middle of the iris, in its radii.
    const auto from_middle = [&](const Vec2<double>& pixel) {
        const Vec3<double> axis = p.ball.head_rotation * p.gaze, ray = p.camera.ray(pixel);
        const Vec3<double> middle = p.ball.centre + plane * axis;
        const Vec3<double> hit = from + ray * ((middle - from).dot(axis) / ray.dot(axis));
        return (hit - middle).norm() / limbus_radius;
    };
    const auto brightness = [&](const Vec2<double>& pixel, const Vec3<double>& d) {
        const double r = from_middle(pixel);
        double value = e.sclera;
        if (e.has_iris && r < 1) value = r < 0.35 ? e.pupil : e.iris;
        return value - e.shade * 0.5 * (d.y() + 1);
    };
    const auto green = [&](const Vec2<double>& pixel) {
        const double r = from_middle(pixel);
        return e.has_iris && r < 1 && r >= 0.35 ? e.iris_green : 0.0;
    };
    const Random random{3, 0};
    std::uint64_t draws = 0;
    for (int y = 0; y < e.size; ++y)
        for (int x = 0; x < e.size; ++x) {
            Vec3<double> direction;
            double sum = 0, skin = 0, greener = 0;
            for (int k = 0; k < 16; ++k) {
                const Vec2<double> at(x + (k % 4 + 0.5) / 4, y + (k / 4 + 0.5) / 4);
                const bool eye = seen(at, direction);
                sum += (eye ? brightness(at, direction) : 0.55) / 16;
                skin += eye ? 0 : 1.0 / 16;
                greener += eye ? green(at) / 16 : 0;
            }
            const bool centre = seen(Vec2<double>(x + 0.5, y + 0.5), direction);
            p.eye(0, y * e.size + x) = centre ? 1.0f : 0.0f;
            for (Index c = 0; c < 3; ++c)
                p.image.at(x, y)(c) =
                    static_cast<float>(sum + skin * e.skin_red * static_cast<double>(1 - c) +
                                       (c == 1 ? greener : 0) +
                                       e.noise * random.normal(draws++));
        }
    return p;
}

} // namespace rye::test
