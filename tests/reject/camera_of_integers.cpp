// SPDX-License-Identifier: Apache-2.0
// A camera looks along unit vectors, so its scalar is not an integer.
// expect: constraint|Real|floating_point
#include <rye/geometry/camera.hpp>

#if REJECT
using T = int;
#else
using T = double;
#endif

rye::Pinhole<T> camera(const rye::Vec3<T>& eye, const rye::Vec3<T>& target) {
    return rye::look_at<T>(eye, target, eye, T(1), {64, 64});
}
