// SPDX-License-Identifier: Apache-2.0
#include "commands/info_json.hpp"

#include <algorithm>

#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "data/validate.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;

Json ids_of(const Capture& c, const std::vector<int>& frames) {
    Json ids = Json::array();
    for (const int f : frames) ids.push_back(c.frames[static_cast<std::size_t>(f)].id);
    return ids;
}

/// Returns the smallest and the largest (pitch, yaw) of an eye's optical axis [deg].
Json gaze_range(const Capture& c, std::size_t eye) {
    Vec2<double> low = Vec2<double>::Constant(1e9), high = -low;
    for (const CaptureFrame& f : c.frames) {
        const Vec2<double> angles = degrees * pitch_yaw(f.eyes[eye].optical);
        low = low.cwiseMin(angles);
        high = high.cwiseMax(angles);
    }
    return {{"pitch", {low[0], high[0]}}, {"yaw", {low[1], high[1]}}};
}

/// Returns the number of frames that a camera has.
int frames_seen(const Capture& c, int camera) {
    int n = 0;
    for (int f = 0; f < c.frame_count(); ++f) n += c.view(f, camera).present ? 1 : 0;
    return n;
}

} // namespace

Json info_json(const Capture& c, const std::vector<Problem>& problems) {
    Json errors = Json::array(), warnings = Json::array();
    for (const Problem& p : problems)
        (p.severity == Problem::Severity::error ? errors : warnings).push_back(p.message);
    std::vector<std::string> lacks;
    if (errors.empty()) lacks = training_faults(c);
    Json json = {{"capture", c.folder.string()},
                 {"verdict", !errors.empty() ? "not usable"
                             : lacks.empty() ? "usable"
                                             : "not trainable"},
                 {"errors", errors},
                 {"warnings", warnings},
                 {"lacks", lacks},
                 {"subject", c.subject},
                 {"frames", c.frame_count()},
                 {"train", ids_of(c, c.train)},
                 {"test", ids_of(c, c.test)},
                 {"novel_gaze", ids_of(c, c.novel_gaze)},
                 {"independent_gaze", ids_of(c, c.independent_gaze)},
                 {"image_size", {c.width, c.height}},
                 {"images_over_black", c.images_over_black},
                 {"expression", c.expression_width()},
                 {"eye_masks", c.has_eye_masks},
                 {"eye_centres", !c.frames.empty() && c.has_centres()}};
    Json cameras = Json::array();
    for (int k = 0; k < c.camera_count() && c.frame_count() > 0; ++k)
        cameras.push_back(
            {{"id", c.camera_ids[static_cast<std::size_t>(k)]}, {"frames", frames_seen(c, k)}});
    json["cameras"] = cameras;
    json["gaze"] = nullptr;
    if (!c.frames.empty() && c.has_gaze())
        json["gaze"] = {{"left", gaze_range(c, 0)}, {"right", gaze_range(c, 1)}};
    json["landmarks"] = nullptr;
    if (c.frames.empty()) return json;
    const LandmarkFit fit = fit_landmarks(c);
    json["landmarks"] = {{"count", c.frames.front().landmarks.cols()},
                         {"vertices", c.frames.front().vertices.cols()},
                         {"span", landmark_span(c)},
                         {"views", fit.views},
                         {"inside_mask", fit.inside_mask}};
    return json;
}

} // namespace rye::trainer
