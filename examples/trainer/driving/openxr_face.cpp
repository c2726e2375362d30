// SPDX-License-Identifier: Apache-2.0
#include "driving/openxr_face.hpp"

#include <cmath>
#include <span>

#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/json_fields.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::json;

constexpr double mm_per_m = 1000;

/// Expressions of XR_FB_face_tracking2 that a coefficient of ARKit is the mean of.
struct Shape {
    const char* name;
    std::array<int, 4> weights; ///< of XrFaceExpression2FB; -1: none
};
constexpr std::size_t weight_count = 70;
constexpr Shape shapes[]{{"browDownLeft", {0, -1, -1, -1}},
                         {"browDownRight", {1, -1, -1, -1}},
                         {"browInnerUp", {22, 23, -1, -1}},
                         {"browOuterUpLeft", {57, -1, -1, -1}},
                         {"browOuterUpRight", {58, -1, -1, -1}},
                         {"cheekPuff", {2, 3, -1, -1}},
                         {"cheekSquintLeft", {4, -1, -1, -1}},
                         {"cheekSquintRight", {5, -1, -1, -1}},
                         {"eyeBlinkLeft", {12, -1, -1, -1}},
                         {"eyeBlinkRight", {13, -1, -1, -1}},
                         {"eyeLookDownLeft", {14, -1, -1, -1}},
                         {"eyeLookDownRight", {15, -1, -1, -1}},
                         {"eyeLookOutLeft", {16, -1, -1, -1}},
                         {"eyeLookInRight", {17, -1, -1, -1}},
                         {"eyeLookInLeft", {18, -1, -1, -1}},
                         {"eyeLookOutRight", {19, -1, -1, -1}},
                         {"eyeLookUpLeft", {20, -1, -1, -1}},
                         {"eyeLookUpRight", {21, -1, -1, -1}},
                         {"eyeSquintLeft", {28, -1, -1, -1}},
                         {"eyeSquintRight", {29, -1, -1, -1}},
                         {"eyeWideLeft", {59, -1, -1, -1}},
                         {"eyeWideRight", {60, -1, -1, -1}},
                         {"jawForward", {27, -1, -1, -1}},
                         {"jawLeft", {25, -1, -1, -1}},
                         {"jawOpen", {24, -1, -1, -1}},
                         {"jawRight", {26, -1, -1, -1}},
                         {"mouthClose", {50, -1, -1, -1}},
                         {"mouthDimpleLeft", {10, -1, -1, -1}},
                         {"mouthDimpleRight", {11, -1, -1, -1}},
                         {"mouthFrownLeft", {30, -1, -1, -1}},
                         {"mouthFrownRight", {31, -1, -1, -1}},
                         {"mouthFunnel", {34, 35, 36, 37}},
                         {"mouthLeft", {53, -1, -1, -1}},
                         {"mouthLowerDownLeft", {51, -1, -1, -1}},
                         {"mouthLowerDownRight", {52, -1, -1, -1}},
                         {"mouthPressLeft", {38, -1, -1, -1}},
                         {"mouthPressRight", {39, -1, -1, -1}},
                         {"mouthPucker", {40, 41, -1, -1}},
                         {"mouthRight", {54, -1, -1, -1}},
                         {"mouthRollLower", {44, 46, -1, -1}},
                         {"mouthRollUpper", {45, 47, -1, -1}},
                         {"mouthShrugLower", {8, -1, -1, -1}},
                         {"mouthShrugUpper", {9, -1, -1, -1}},
                         {"mouthSmileLeft", {32, -1, -1, -1}},
                         {"mouthSmileRight", {33, -1, -1, -1}},
                         {"mouthStretchLeft", {42, -1, -1, -1}},
                         {"mouthStretchRight", {43, -1, -1, -1}},
                         {"mouthUpperUpLeft", {61, -1, -1, -1}},
                         {"mouthUpperUpRight", {62, -1, -1, -1}},
                         {"noseSneerLeft", {55, -1, -1, -1}},
                         {"noseSneerRight", {56, -1, -1, -1}},
                         {"tongueOut", {68, -1, -1, -1}}};

/// Returns the numbers of an object's fields with these names.
template <std::size_t n>
Vec<double, static_cast<int>(n)> numbers_of(const Json& object, const char* const (&names)[n],
                                            const std::string& who) {
    Vec<double, static_cast<int>(n)> v;
    for (std::size_t k = 0; k < n; ++k) {
        require(object.is_object() && object.contains(names[k]), who + ": " + names[k],
                "is missing, expected a number");
        v[static_cast<Index>(k)] = json_number(object.at(names[k]), who + ": " + names[k]);
    }
    return v;
}

struct Pose {
    Mat3<double> rotation;
    Vec3<double> position;
};

Pose pose_of(const Json& pose, const std::string& who) {
    require(pose.is_object() && pose.contains("orientation"), who + ": orientation",
            "is missing, expected x, y, z and w");
    const Vec4<double> q =
        numbers_of(pose.at("orientation"), {"x", "y", "z", "w"}, who + ": orientation");
    require(std::abs(q.norm() - 1) < 0.01, who + ": orientation", "has the length ", q.norm(),
            ", expected 1");
    Pose p;
    p.rotation = quat_matrix(quat_normalized<double>(Quat<double>(q[3], q[0], q[1], q[2])));
    p.position = Vec3<double>::Zero();
    if (pose.contains("position"))
        p.position = numbers_of(pose.at("position"), {"x", "y", "z"}, who + ": position");
    return p;
}

/// Returns a rotation in the axes of the head frame, whose x and z are turned round.
Mat3<double> in_head_axes(const Mat3<double>& r) {
    const Vec3<double> signs(-1, 1, -1);
    return signs.asDiagonal() * r * signs.asDiagonal();
}

} // namespace

std::vector<std::string> openxr_names() {
    std::vector<std::string> names;
    for (const Shape& s : shapes) names.emplace_back(s.name);
    return names;
}

bool read_openxr(const Json& picture, TrackedFace& face, const std::string& who) {
    bool seen = false;
    Mat3<double> head = Mat3<double>::Identity();
    if (picture.contains("head")) {
        const Pose p = pose_of(picture.at("head"), who + ": head");
        head = p.rotation;
        face.turn = in_head_axes(p.rotation);
        face.place = mm_per_m * Vec3<double>(-p.position.x(), p.position.y(), -p.position.z());
    }
    if (picture.contains("gaze")) {
        const Json& eyes = json_list(picture, "gaze", who, "two XrEyeGazeFB");
        require(eyes.size() == 2, who + ": gaze", "got ", eyes.size(), " eyes, expected 2");
        for (std::size_t e = 0; e < 2; ++e) {
            const std::string at = who + ": gaze: " + std::to_string(e);
            const Json& eye = eyes.at(e);
            require(eye.is_object() && eye.contains("gazePose"), at + ": gazePose",
                    "is missing, expected an XrPosef");
            if (eye.contains("isValid")) {
                const Json& valid = eye.at("isValid");
                require(
                    valid.is_boolean() || valid.is_number(), at + ": isValid", "got ",
                    [&] { return json_excerpt(valid); }, ", expected true or false");
                if (valid == false || valid == 0) continue;
            }
            const Pose p = pose_of(eye.at("gazePose"), at + ": gazePose");
            const Vec3<double> forward = head.transpose() * (p.rotation * Vec3<double>(0, 0, -1));
            face.gaze[e] = pitch_yaw(Vec3<double>(-forward.x(), forward.y(), -forward.z()));
            seen = true;
        }
    }
    if (!picture.contains("weights")) return seen;
    const Json& weights = json_list(picture, "weights", who, "70 numbers");
    require(weights.size() == weight_count, who + ": weights", "got ", weights.size(),
            " numbers, expected ", weight_count, " of XR_FB_face_tracking2");
    face.coefficients.resize(std::ssize(shapes));
    for (Index i = 0; i < face.coefficients.size(); ++i) {
        double sum = 0;
        int count = 0;
        for (const int w : shapes[i].weights) {
            if (w < 0) continue;
            const std::string at = who + ": weights: " + std::to_string(w);
            const double x = json_number(weights.at(static_cast<std::size_t>(w)), at);
            require(std::abs(x) <= 2, at, "got ", x, ", expected 0 to 1");
            sum += x;
            ++count;
        }
        face.coefficients[i] = sum / count;
    }
    return true;
}

} // namespace rye::trainer
