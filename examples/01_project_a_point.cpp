// SPDX-License-Identifier: Apache-2.0
// Lesson 1: a formula is a template over its scalar. On doubles it returns a value, on duals the
// value and its derivatives; a check of the derivatives needs the formula alone.
#include <algorithm>
#include <cmath>
#include <cstdio>

#include <rye/autodiff/dual.hpp>
#include <rye/geometry/camera.hpp>

using namespace rye;

int main() {
    // A camera ten units in front of a face, looking at it; y is up.
    const Pinhole<double> camera = look_at<double>(Vec3<double>(0, 0, 10), Vec3<double>(0, 0, 0),
                                                   Vec3<double>(0, 1, 0), 0.3, {256, 256});
    const Vec3<double> x(0.6, 0.3, 0.8);                            // [world units]
    const Vec3<double> u = camera.project_point(x);                 // [px], [px], [world units]
    std::printf("the point (%.1f, %.1f, %.1f) projects to (%.3f, %.3f), depth %.3f\n", x[0], x[1],
                x[2], u[0], u[1], u[2]);

    // The same formula on duals with three directions, one per coordinate of the point.
    using D = Dual<double, 3>;
    Vec3<D> dual_x;
    for (int i = 0; i < 3; ++i) dual_x[i] = D::variable(x[i], i);
    const Vec3<D> dual_u = camera.cast<D>().project_point(dual_x);

    double worst = 0;
    for (int j = 0; j < 3; ++j) {
        const Vec3<double> step = 1e-5 * Vec3<double>::Unit(j);
        const Vec3<double> difference =
            (camera.project_point(x + step) - camera.project_point(x - step)) / 2e-5;
        for (int i = 0; i < 3; ++i)
            worst = std::max(worst, std::abs(difference[i] - dual_u[i].d[std::size_t(j)]));
    }
    std::printf("du/dx = (%.3f, %.3f, %.3f)\n", dual_u[0].d[0], dual_u[0].d[1], dual_u[0].d[2]);
    std::printf("dv/dx = (%.3f, %.3f, %.3f)\n", dual_u[1].d[0], dual_u[1].d[1], dual_u[1].d[2]);
    std::printf("largest deviation from central differences %.1e\n", worst);

    for (int i = 0; i < 3; ++i)
        if (dual_u[i].value != u[i]) return 1;
    return worst < 1e-6 ? 0 : 1;
}
