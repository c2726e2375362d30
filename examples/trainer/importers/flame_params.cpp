// SPDX-License-Identifier: Apache-2.0
#include "importers/flame_params.hpp"

#include <string>

#include <rye/io/npz.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "data/memory_limit.hpp"
#include "importers/import_folder.hpp"

namespace rye::trainer {
namespace {

/// Returns the finite numbers of an array, `count` of them, or any number if count is 0.
std::vector<double> array_of(const NpzArrays& arrays, const char* name, std::size_t count,
                             const std::string& file) {
    const std::string who = file + ": " + name;
    const auto found = arrays.find(name);
    require(found != arrays.end(), who, "is missing, expected FLAME parameters of VHAP");
    std::vector<double> values = found->second.values<double>(who);
    require(
        count == 0 || values.size() == count, who, "got shape ",
        [&] { return shape_text(found->second.shape); }, ", expected ", count,
        " numbers of one frame");
    require_finite_numbers(values, who);
    return values;
}

Mat3<double> rotation_of(const std::vector<double>& v, std::size_t at = 0) {
    return so3_exp(Vec3<double>(v[at], v[at + 1], v[at + 2]));
}

} // namespace

FlameParams parse_flame_params(ByteSpan bytes, const std::string& who) {
    const NpzArrays arrays = parse_npz(bytes, who, memory_limit());
    FlameParams p;
    p.expression = array_of(arrays, "expr", 0, who);
    const std::vector<double> jaw = array_of(arrays, "jaw_pose", 3, who);
    p.expression.insert(p.expression.end(), jaw.begin(), jaw.end());
    p.rotation = rotation_of(array_of(arrays, "rotation", 3, who)) *
                 rotation_of(array_of(arrays, "neck_pose", 3, who));
    array_of(arrays, "translation", 3, who);
    // The eyes are attached to the neck's joint, so eyes_pose is in the head frame.
    const std::vector<double> eyes = array_of(arrays, "eyes_pose", 6, who);
    for (std::size_t e = 0; e < 2; ++e) {
        p.gaze[e] = rotation_of(eyes, 3 * e) * Vec3<double>(0, 0, 1);
        require(
            !beyond_gaze_range(p.gaze[e]), who + ": eyes_pose", "turns the ",
            e == 0 ? "left" : "right", " eye by ",
            [&] { return factor_text(degrees * angular_error(p.gaze[e], Vec3<double>(0, 0, 1))); },
            " degrees, expected at most ", [&] { return factor_text(degrees * gaze_range); },
            " (axis-angle in radians)");
    }
    return p;
}

FlameParams read_flame_params(const std::filesystem::path& path) {
    return parse_flame_params(read_file(path), path.string());
}

} // namespace rye::trainer
