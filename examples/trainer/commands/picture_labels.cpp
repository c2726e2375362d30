// SPDX-License-Identifier: Apache-2.0
#include "commands/picture_labels.hpp"

#include <cmath>
#include <optional>

#include <nlohmann/json.hpp>

#include <rye/core/error.hpp>

#include "data/degrees.hpp"
#include "data/out_format.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;

/// Returns a number with the digits that one of a float has.
double rounded(double x) { return std::round(x * 1e6) / 1e6 + 0.0; }

template <class V>
Json list(const V& v) {
    Json all = Json::array();
    for (Index i = 0; i < v.size(); ++i) all.push_back(rounded(static_cast<double>(v[i])));
    return all;
}
template <class M>
Json rows(const M& m) {
    Json all = Json::array();
    for (Index i = 0; i < m.rows(); ++i) all.push_back(list(m.row(i)));
    return all;
}
Json degrees(double pitch, double yaw) { return {rounded(pitch / degree), rounded(yaw / degree)}; }
Json degrees(const Vec3<double>& gaze) {
    const Vec2<double> a = pitch_yaw(gaze);
    return degrees(a[0], a[1]);
}

Json label_of_eye(const PlacedEyes& eyes, std::size_t e, const Vec3<double>& visual,
                  const Pinhole<double>& camera) {
    const Rigid<double>& head = eyes.head.world_from_head;
    const Vec3<double> centre = head.apply(Vec3<double>(eyes.head.scale * eyes.centre[e]));
    const Vec3<double> optical = apply_kappa(visual, eyes.kappa[e]);
    const auto in_camera = [&](const Vec3<double>& g) {
        return list(camera.camera_from_world.turn(head.turn(g)));
    };
    Json j;
    j["centre"] = list(centre);
    j["visual"] = degrees(visual);
    j["optical"] = degrees(optical);
    j["kappa"] = degrees(eyes.kappa[e].pitch, eyes.kappa[e].yaw);
    j["visual_in_camera"] = in_camera(visual);
    j["optical_in_camera"] = in_camera(optical);
    const Vec3<double> p = camera.camera_from_world.apply(centre);
    j["pixel"] = p.z() > 0 ? list(Vec2<double>(camera.project_point(centre).head<2>())) : Json();
    return j;
}

} // namespace

void check_labels_name(const std::string& path, const std::string& who) {
    require(extension_of(path) == ".jsonl", who, "got '", path, "', expected .jsonl");
}

std::string text_of_labels(const TrainState& state, const std::vector<DrawnFrame>& frames,
                           const std::vector<std::string>& pictures, const GazeAtOptions& at) {
    std::optional<GazePoint> point;
    if (at.given()) point = parsed_gaze_point(at.target, "--gaze-at");
    std::string text;
    for (std::size_t i = 0; i < frames.size(); ++i) {
        const DrawnFrame& f = frames[i];
        const PlacedEyes eyes = placed_eyes(state, f.drivers);
        const Pinhole<double> c = f.camera.cast<double>();
        Json j;
        j["picture"] = pictures.empty() ? Json(i) : Json(pictures[i]);
        for (std::size_t e = 0; e < 2; ++e) {
            Json& eye = j[e == 0 ? "left" : "right"];
            eye = label_of_eye(eyes, e, f.drivers.gaze[e].template cast<double>(), c);
            eye["pupil"] = rounded(static_cast<double>(f.pupil[e]));
        }
        j["target"] = nullptr;
        if (point) {
            const GazeTarget<double> t = gaze_target(*point, eyes.head, f.camera);
            j["target"] = list(eyes.head.world_from_head.apply(
                Vec3<double>(eyes.head.scale / t.weight * t.point)));
        }
        j["head"] = {{"rotation", rows(eyes.head.world_from_head.rotation)},
                     {"translation", list(eyes.head.world_from_head.translation)},
                     {"scale", rounded(eyes.head.scale)}};
        j["expression"] = list(f.drivers.expression);
        Mat3<double> intrinsic;
        intrinsic << c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1;
        Mat<double, 3, 4> extrinsic;
        extrinsic << c.camera_from_world.rotation, c.camera_from_world.translation;
        j["camera"] = {{"size", {c.width, c.height}},
                       {"intrinsic", rows(intrinsic)},
                       {"extrinsic", rows(extrinsic)}};
        text += j.dump() + "\n";
    }
    return text;
}

} // namespace rye::trainer
