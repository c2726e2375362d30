// SPDX-License-Identifier: Apache-2.0
// Lesson 5: an eyeball as geometry. Each eye rotates rigidly about its own centre and moves with
// the head, so the input gaze can be recovered from the transformed points.
#include <algorithm>
#include <array>
#include <cstdio>
#include <numbers>

#include <rye/rig/eye_transform.hpp>
#include <rye/rig/eyeball.hpp>

using namespace rye;

int main() {
    constexpr double degree = std::numbers::pi / 180;
    const EyeballTemplate<double> eyeball = eyeball_template<double>(EyeballShape{});
    const auto iris = std::count(eyeball.labels.begin(), eyeball.labels.end(), EyeLabel::iris);
    std::printf("an eyeball of %td points, %td of them on the iris\n", eyeball.points.cols(), iris);

    // The head is rotated by 20 degrees and moved; the eyes look in different directions.
    HeadPlacement<double> head;
    head.world_from_head.rotation = so3_exp<double>({0, 20 * degree, 0});
    head.world_from_head.translation = {0.1, 0.3, 0};
    const std::array<Vec3<double>, 2> centres{Vec3<double>(0.3, 0.3, 0.8),  // left eye: x > 0
                                              Vec3<double>(-0.3, 0.3, 0.8)};
    const std::array<Vec2<double>, 2> gazes{Vec2<double>(10, 15), Vec2<double>(-5, -25)};

    double worst = 0;
    for (std::size_t eye = 0; eye < 2; ++eye) {
        const double pitch = gazes[eye][0] * degree, yaw = gazes[eye][1] * degree;
        const Vec3<double> optical = gaze_vector(pitch, yaw);
        const EyeTransform<double> turn =
            eye_transform(EyeDrive<double>{.centre = centres[eye], .gaze = optical}, head);
        const Columns<double> world = eye_points(turn, eyeball.points);

        // Gaze recovered from points: from the centre to the mean of the rim of the iris.
        Vec3<double> rim = Vec3<double>::Zero(), centre = Vec3<double>::Zero();
        for (const Index i : eyeball.iris8) rim += world.col(i) / 8;
        for (const Index i : eyeball.equator)
            centre += world.col(i) / static_cast<double>(eyeball.equator.size());
        const Vec3<double> seen =
            gaze_in_head<double>(head.world_from_head.rotation, rim - centre);
        const Vec2<double> angles = pitch_yaw(seen) / degree;
        std::printf("%s eye: given pitch %6.2f yaw %6.2f, recovered pitch %6.2f yaw %6.2f\n",
                    eye == 0 ? "left " : "right", gazes[eye][0], gazes[eye][1], angles[0],
                    angles[1]);
        worst = std::max(worst, angular_error(seen, optical));

        // The line of sight differs from the optical axis by kappa, a constant per person.
        const KappaAngles<double> kappa{.pitch = 0, .yaw = (eye == 0 ? 5 : -5) * degree};
        const Vec2<double> sight = pitch_yaw(gaze_from_kappa(optical, kappa)) / degree;
        std::printf("           line of sight with kappa: pitch %6.2f yaw %6.2f\n", sight[0],
                    sight[1]);
    }
    std::printf("largest error %.1e rad\n", worst);
    return worst < 1e-9 ? 0 : 1;
}
