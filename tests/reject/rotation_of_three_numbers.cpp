// SPDX-License-Identifier: Apache-2.0
// A quaternion has four numbers: an axis-angle must be turned into one first.
// expect: no matching function
#include <rye/math/rotation.hpp>

rye::Vec3<double> turned(const rye::Vec3<double>& axis_angle, const rye::Vec3<double>& v) {
#if REJECT
    return rye::quat_rotate(axis_angle, v);
#else
    return rye::quat_rotate(rye::so3_exp_quat(axis_angle), v);
#endif
}
