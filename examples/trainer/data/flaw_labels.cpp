// SPDX-License-Identifier: Apache-2.0
#include "data/flaw_labels.hpp"

#include <cmath>
#include <span>
#include <string>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"

namespace rye::trainer {
namespace {

constexpr std::array sides{"left", "right"};

std::vector<double> values_of(const NpzArrays& arrays, const std::string& name,
                              const std::string& who) {
    const auto found = arrays.find(name);
    require(found != arrays.end(), who + ": " + name, "is missing from the file");
    return found->second.values<double>(who + ": " + name);
}

/// Replaces the numbers of an array; integers become float64.
void put(NpyArray& array, const std::vector<double>& values) {
    if (array.type() == "f4") {
        std::vector<float> narrow;
        for (const double x : values) narrow.push_back(static_cast<float>(x));
        array = npy_array<float>(array.shape, narrow);
    } else {
        array = npy_array<double>(array.shape, values);
    }
}

void put(NpyArray& array, const Vec3<double>& v) {
    put(array, std::vector<double>{v[0], v[1], v[2]});
}

Vec3<double> drawn_vector(const Random& random, double size, FlawSum& sum) {
    Vec3<double> v = Vec3<double>::Zero();
    if (size > 0)
        for (const int k : {0, 1, 2})
            v[k] = drawn(random, static_cast<std::uint64_t>(k), size, sum);
    return v;
}

} // namespace

void flaw_params(NpzArrays& arrays, const LabelFlaws& flaws, const std::string& who,
                 FlawSums& sums) {
    const double off = flaws.sizes[Flaw::expression];
    if (off > 0) {
        const Random random = flaws.draws.of(Flaw::expression, flaws.frame);
        const Random chosen{random.seed, 2};
        std::vector<double> weights = values_of(arrays, "exp_coeff", who);
        for (std::size_t i = 0; i < weights.size(); ++i)
            if (chosen.uniform(i) < flaws.expression_share)
                weights[i] += drawn(random, i, off, sums[Flaw::expression]);
        put(arrays.at("exp_coeff"), weights);
    }
    if (!flaws.has_pose()) return;
    std::vector<double> pose = values_of(arrays, "pose", who);
    require(pose.size() == 6, who + ": pose",
            "got " + std::to_string(pose.size()) + " numbers, expected 6");
    const Vec3<double> turn =
        degree * drawn_vector(flaws.draws.of(Flaw::pose_rotation, flaws.frame),
                              flaws.sizes[Flaw::pose_rotation], sums[Flaw::pose_rotation]);
    const Vec3<double> move =
        drawn_vector(flaws.draws.of(Flaw::pose_position, flaws.frame),
                     flaws.sizes[Flaw::pose_position], sums[Flaw::pose_position]) /
        flaws.unit_mm;
    if (flaws.has(Flaw::pose_rotation)) {
        const Vec3<double> now(pose[0], pose[1], pose[2]);
        const Vec3<double> then = so3_log(Mat3<double>(so3_exp(turn) * so3_exp(now)));
        for (const std::size_t k : {0U, 1U, 2U}) pose[k] = then[static_cast<Index>(k)];
    }
    for (const std::size_t k : {0U, 1U, 2U}) pose[3 + k] += move[static_cast<Index>(k)];
    put(arrays.at("pose"), pose);
}

void flaw_gaze(NpzArrays& arrays, const Vec3<double>& rotation, const LabelFlaws& flaws,
               const std::string& who, FlawSums& sums) {
    const Mat3<double> world_from_head = so3_exp(rotation);
    Vec2<double> common = Vec2<double>::Zero(); // yaw, pitch [deg]
    if (flaws.has(Flaw::gaze_common)) {
        const Random random = flaws.draws.of(Flaw::gaze_common, flaws.frame);
        for (const int k : {0, 1})
            common[k] = drawn(random, static_cast<std::uint64_t>(k), flaws.sizes[Flaw::gaze_common],
                              sums[Flaw::gaze_common]);
    }
    for (std::size_t e = 0; e < 2; ++e) {
        const std::string side = sides[e];
        Vec2<double> off = common;
        if (flaws.has(Flaw::gaze_single)) {
            const Random random = flaws.draws.of(Flaw::gaze_single, flaws.frame, e);
            for (const int k : {0, 1})
                off[k] += drawn(random, static_cast<std::uint64_t>(k),
                                flaws.sizes[Flaw::gaze_single], sums[Flaw::gaze_single]);
        }
        const std::string optical = "gaze_" + side;
        if (flaws.has_gaze())
            for (const std::string& name : {optical, "visual_" + side}) {
                if (!arrays.contains(name)) continue;
                const std::vector<double> v = values_of(arrays, name, who);
                require(v.size() == 3, who + ": " + name,
                        "got " + std::to_string(v.size()) + " numbers, expected 3");
                const Vec2<double> angles = pitch_yaw(Vec3<double>(v.data()));
                put(arrays.at(name),
                    gaze_vector(angles[0] + degree * off[1], angles[1] + degree * off[0]));
            }
        if (arrays.contains(optical + "_world") && (flaws.has_gaze() || flaws.has_pose())) {
            const std::vector<double> v = values_of(arrays, optical, who);
            put(arrays.at(optical + "_world"),
                Vec3<double>(world_from_head * Vec3<double>(v.data())));
        }
        if (!flaws.has(Flaw::centres)) continue;
        const std::string centre = "eye_center_" + side;
        const std::vector<double> c = values_of(arrays, centre, who);
        const Vec3<double> move = drawn_vector(flaws.draws.of(Flaw::centres, flaws.frame, e),
                                               flaws.sizes[Flaw::centres], sums[Flaw::centres]);
        put(arrays.at(centre), Vec3<double>(Vec3<double>(c.data()) + move / flaws.unit_mm));
    }
}

void flaw_points(NpyArray& points, std::size_t list, const LabelFlaws& flaws,
                 const std::string& who, FlawSums& sums) {
    const Random random = flaws.draws.of(Flaw::landmarks, flaws.frame, list);
    std::vector<double> values = points.values<double>(who);
    for (std::size_t i = 0; i < values.size(); ++i)
        values[i] +=
            drawn(random, i, flaws.sizes[Flaw::landmarks], sums[Flaw::landmarks]) / flaws.unit_mm;
    put(points, values);
}

CalibrationFlaws calibration_flaws(const FlawDraws& draws, const FlawSizes& sizes, double unit_mm,
                                   std::size_t camera, FlawSums& sums) {
    const auto vector = [&](Flaw flaw) {
        return drawn_vector(draws.of(flaw, camera), sizes[flaw], sums[flaw]);
    };
    CalibrationFlaws flaws;
    flaws.rotation = degree * vector(Flaw::camera_rotation);
    flaws.position = vector(Flaw::camera_position) / unit_mm;
    if (sizes[Flaw::focal] > 0)
        flaws.focal = std::exp(
            drawn(draws.of(Flaw::focal, camera), 0, sizes[Flaw::focal], sums[Flaw::focal]) / 100);
    return flaws;
}

void flaw_camera(NpzArrays& arrays, const CalibrationFlaws& flaws, const std::string& who) {
    if (flaws.focal != 1) {
        std::vector<double> k = values_of(arrays, "intrinsic", who);
        require(k.size() == 9, who + ": intrinsic",
                "got " + std::to_string(k.size()) + " numbers, expected 9");
        k[0] *= flaws.focal;
        k[4] *= flaws.focal;
        put(arrays.at("intrinsic"), k);
    }
    if (flaws.rotation.isZero(0) && flaws.position.isZero(0)) return;
    std::vector<double> m = values_of(arrays, "extrinsic", who);
    require(m.size() == 12 || m.size() == 16, who + ": extrinsic",
            "got " + std::to_string(m.size()) + " numbers, expected 12 or 16");
    Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> extrinsic(m.data());
    const Mat3<double> r = extrinsic.leftCols<3>();
    const Vec3<double> centre = flaws.position - r.transpose() * extrinsic.col(3);
    const Mat3<double> turned = so3_exp(flaws.rotation) * r;
    extrinsic.leftCols<3>() = turned;
    extrinsic.col(3) = -(turned * centre);
    put(arrays.at("extrinsic"), m);
}

} // namespace rye::trainer
