// SPDX-License-Identifier: Apache-2.0
// video_views TRUTH MODEL CAPTURE OUT: the test frames of CAPTURE, which `rye import video` made of
// a video, as five cameras see the head of TRUTH, which `rye capture --video --model MODEL` wrote
// beside the video: 00 is the video's own, the others stand 30 and 45 degrees to both sides of it.
// OUT is a capture by which `rye evaluate` measures an avatar of CAPTURE from views that the video
// never had. Expressions are CAPTURE's, gazes and eyeballs the true ones. Heads are where the truth
// has them: the frame of CAPTURE's heads is placed in that of the true one by one similarity, by
// which the tracked landmarks of all frames fall on the same pixels.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <exception>

#include <Eigen/Cholesky>

#include <rye/core/error.hpp>
#include <rye/rig/gaze.hpp>

#include "data/capture.hpp"
#include "data/json.hpp"
#include "importers/face_geometry.hpp"
#include "importers/face_mesh.hpp"
#include "importers/import_folder.hpp"
#include "importers/video_pictures.hpp"
#include "synthetic_capture/head_render.hpp"
#include "synthetic_capture/scene.hpp"
#include "comparison.hpp"
#include "video_pairs.hpp"

namespace {

using namespace rye;
using namespace rye::trainer;

Vec2<double> seen(const Pinhole<double>& camera, const Vec3<double>& world) {
    const Vec3<double> x = camera.camera_from_world.apply(world);
    return {x.x() / x.z(), x.y() / x.z()};
}

/// Every tenth landmark of every frame, in its head, and where the video shows it.
struct Seen {
    int truth;
    Vec3<double> head;
    Vec2<double> at;
};

VecX<double> residuals(const Capture& truth, const std::vector<Seen>& all, const Similarity& map) {
    VecX<double> r(2 * static_cast<Index>(all.size()));
    for (std::size_t i = 0; i < all.size(); ++i) {
        const Seen& s = all[i];
        const Vec3<double> world = world_from_head(truth, s.truth).apply(map(s.head));
        r.segment<2>(2 * static_cast<Index>(i)) = seen(truth.camera(s.truth, 0), world) - s.at;
    }
    return r;
}

Similarity moved(const Similarity& map, const Vec<double, 7>& by) {
    Similarity m = map;
    m.motion.rotation = so3_exp(Vec3<double>(by.head<3>())) * m.motion.rotation;
    m.motion.translation += by.segment<3>(3);
    m.size *= std::exp(by[6]);
    return m;
}

/// Gauss-Newton's method, with differences for derivatives.
Similarity head_map(const Capture& truth, const Capture& got, const std::vector<VideoPair>& pairs) {
    std::vector<Seen> all;
    for (const VideoPair& p : pairs) {
        const CaptureFrame& frame = got.frames[static_cast<std::size_t>(p.got)];
        for (Index i = 0; i < frame.vertices.cols(); i += 10) {
            const Vec3<double> world = frame.vertices.col(i);
            all.push_back({p.truth, world_from_head(got, p.got).inverse().apply(world),
                           seen(got.camera(p.got, 0), world)});
        }
    }
    Similarity map;
    const auto eyes_of = [](const Capture& c, int f) {
        const CaptureFrame& frame = c.frames[static_cast<std::size_t>(f)];
        const Rigid<double> to_head = world_from_head(c, f).inverse();
        return std::array{to_head.apply(*frame.eyes[0].centre),
                          to_head.apply(*frame.eyes[1].centre)};
    };
    const auto a = eyes_of(got, pairs[0].got), b = eyes_of(truth, pairs[0].truth);
    map.size = (b[0] - b[1]).norm() / (a[0] - a[1]).norm();
    map.motion.translation = 0.5 * (b[0] + b[1] - map.size * (a[0] + a[1]));
    constexpr double step = 1e-6;
    constexpr int steps = 30;
    for (int i = 0; i < steps; ++i) {
        const VecX<double> r = residuals(truth, all, map);
        Eigen::MatrixXd jacobian(r.size(), 7);
        for (Index k = 0; k < 7; ++k)
            jacobian.col(k) =
                (residuals(truth, all, moved(map, step * Vec<double, 7>::Unit(k))) - r) / step;
        const Eigen::MatrixXd normal = jacobian.transpose() * jacobian;
        const Vec<double, 7> by = normal.ldlt().solve(VecX<double>(-jacobian.transpose() * r));
        map = moved(map, by);
        if (by.norm() < 1e-9) break;
    }
    const VecX<double> r = residuals(truth, all, map);
    const double px =
        truth.camera(0, 0).fx * std::sqrt(2 * r.squaredNorm() / static_cast<double>(r.size()));
    std::printf("head frame     scale %.3f; landmarks %.1f px off, rms, in the video\n", map.size,
                px);
    return map;
}

/// The camera of the video, cut to the square of the capture's pictures, or turned around the head.
Pinhole<double> camera_at(const Pinhole<double>& video, const std::array<double, 3>& square,
                          int size, double yaw_deg) {
    const double zoom = size / square[2];
    Pinhole<double> c = video;
    c.fx *= zoom;
    c.fy *= zoom;
    c.width = c.height = size;
    if (yaw_deg == 0) {
        c.cx = (c.cx - square[0]) * zoom;
        c.cy = (c.cy - square[1]) * zoom;
        return c;
    }
    const Vec3<double> from = so3_exp(Vec3<double>(0, std::acos(-1.0) / 180 * yaw_deg, 0)) *
                              (video.centre() - head_centre);
    c.camera_from_world =
        look_at<double>(head_centre + from, head_centre, {0, 1, 0}, 1.0, {size, size})
            .camera_from_world;
    c.cx = c.cy = 0.5 * size;
    return c;
}

ImportView view_of(const PosedHead& head, const Pinhole<double>& camera, const BelowNeck& below,
                   const std::string& name, int samples) {
    const HeadPicture picture = head.picture(camera, samples);
    ImportView view;
    view.camera = name;
    view.pinhole = camera;
    view.picture = to_8bit(picture.image);
    view.mask = to_8bit(picture.mask);
    view.visible = plain_image(camera.width, camera.height, 255);
    view.eyes = plain_image(camera.width, camera.height, 0);
    for (std::size_t i = 0; i < view.mask.values.size(); ++i) {
        if (picture.eye[i] > 0) view.eyes.values[i] = eye_mask_value(picture.eye[i] - 1);
        const auto width = static_cast<std::size_t>(camera.width);
        if (!below(static_cast<double>(i % width) + 0.5, static_cast<double>(i / width) + 0.5))
            continue;
        view.mask.values[i] = view.visible.values[i] = view.eyes.values[i] = 0;
        for (std::size_t c = 0; c < 3; ++c) view.picture.values[3 * i + c] = 0;
    }
    return view;
}

/// Lengths of the true world become those of CAPTURE's head.
Rigid<double> shrunk(Rigid<double> m, double scale) {
    m.translation /= scale;
    return m;
}

ImportHead head_of(const Capture& truth, const Capture& got, const VideoPair& p,
                   const Similarity& map) {
    const CaptureFrame& frame = got.frames[static_cast<std::size_t>(p.got)];
    const CaptureFrame& right = truth.frames[static_cast<std::size_t>(p.truth)];
    const Rigid<double> head =
        shrunk(compose(world_from_head(truth, p.truth), map.motion), map.size);
    const Rigid<double> from_world = compose(head, world_from_head(got, p.got).inverse());
    ImportHead h;
    h.expression.assign(frame.expression.begin(), frame.expression.end());
    h.pose << so3_log(head.rotation), head.translation;
    h.landmarks = (from_world.rotation * frame.landmarks).colwise() + from_world.translation;
    h.vertices = (from_world.rotation * frame.vertices).colwise() + from_world.translation;
    h.has_gaze = true;
    h.eyes = frame.eyes;
    for (std::size_t e = 0; e < 2; ++e) {
        h.eyes[e].optical = map.motion.turn_back(right.eyes[e].optical);
        h.eyes[e].optical_world.reset();
        h.eyes[e].visual.reset();
        h.eyes[e].centre = *right.eyes[e].centre / map.size;
        h.eyes[e].radius = *right.eyes[e].radius / map.size;
        h.eyes[e].limbus_radius = *right.eyes[e].limbus_radius / map.size;
        h.eyes[e].iris_plane = *right.eyes[e].iris_plane / map.size;
    }
    return h;
}

int run(const char* truth_folder, const char* model_file, const char* got_folder, const char* out) {
    Capture truth = read_capture(truth_folder), got = read_capture(got_folder);
    const auto video = read_json(got.folder / "capture.json");
    const auto made = read_json(truth.folder / "capture.json");
    require(video.contains("video"), got_folder, "is no capture of `rye import video`");
    const auto square = video.at("video").at("square").get<std::array<double, 3>>();
    const HeadModel model = ict_head(model_file, made.at("seed").get<std::uint64_t>());
    const std::vector<VideoPair> pairs = pairs_of(truth, got);
    const Similarity map = head_map(truth, got, pairs);
    constexpr std::array<double, 5> yaws{0, -45, -30, 30, 45};
    using Json = nlohmann::ordered_json;
    Json cameras = Json::array(), tests = Json::array(), train = Json::array();
    for (std::size_t k = 0; k < yaws.size(); ++k)
        cameras.push_back({{"id", "0" + std::to_string(k)}, {"yaw_deg", yaws[k]}});
    ImportFolder folder(out, {{"kind", "video_views"}, {"source", got.folder.string()}});
    ImportSummary summary;
    summary.cameras = static_cast<int>(yaws.size());
    for (const VideoPair& p : pairs) {
        // A capture has a frame for training, too.
        const bool test = std::find(got.test.begin(), got.test.end(), p.got) != got.test.end();
        if (!test && !train.empty()) continue;
        const CaptureFrame& right = truth.frames[static_cast<std::size_t>(p.truth)];
        const std::string& id = got.frames[static_cast<std::size_t>(p.got)].id;
        HeadState state;
        state.expression = VecX<double>(static_cast<Index>(right.expression.size()));
        for (std::size_t i = 0; i < right.expression.size(); ++i)
            state.expression[static_cast<Index>(i)] = static_cast<double>(right.expression[i]);
        std::array<Vec2<double>, 2> yaw_pitch_deg;
        for (std::size_t e = 0; e < 2; ++e) {
            state.optical[e] = right.eyes[e].optical;
            const Vec2<double> angles = pitch_yaw(state.optical[e]) * (180 / std::acos(-1.0));
            yaw_pitch_deg[e] = {angles[1], angles[0]};
        }
        state.lids = lid_coefficients(yaw_pitch_deg);
        state.world_from_head = world_from_head(truth, p.truth);
        ImportFrame frame{id, head_of(truth, got, p, map), {}};
        const Vec3<double> chin = frame.head->landmarks.col(static_cast<Index>(ibug_chin));
        const Rigid<double> world_from_imported{so3_exp(Vec3<double>(frame.head->pose.head<3>())),
                                                frame.head->pose.tail<3>()};
        const PosedHead head(model, state);
        for (std::size_t k = 0; k < yaws.size(); ++k) {
            const Pinhole<double> camera =
                camera_at(truth.camera(p.truth, 0), square, got.width, yaws[k]);
            Pinhole<double> small = camera;
            small.camera_from_world = shrunk(camera.camera_from_world, map.size);
            const BelowNeck below(world_from_imported, chin, small);
            frame.views.push_back(view_of(head, camera, below, "0" + std::to_string(k),
                                          made.at("samples_per_pixel").get<int>()));
            frame.views.back().pinhole = small;
        }
        if (!folder.has(id)) folder.write(frame, Json::object());
        (test ? tests : train).push_back(id);
        ++summary.frames;
    }
    const Bytes shapes = read_file(got.folder / "expression_shapes.npz");
    folder.write_file("expression_shapes.npz", std::string(as_text(shapes)));
    folder.finish({{"subject", video.at("subject")},
                   {"image_size", {got.width, got.width}},
                   {"cameras", cameras},
                   {"train_frames", train},
                   {"test_frames", tests},
                   {"exp_names", video.at("exp_names")},
                   {"unit_mm", 100},
                   {"conventions", {{"image", "8-bit sRGB over black (premultiplied)"}}}},
                  summary);
    std::printf("written        %s, %zu test frames by %d cameras\n", out, tests.size(),
                summary.cameras);
    return 0;
}

} // namespace

int main(int count, char** words) {
    if (count != 5) {
        std::fprintf(stderr, "usage: video_views TRUTH MODEL CAPTURE OUT\n");
        return 2;
    }
    try {
        return run(words[1], words[2], words[3], words[4]);
    } catch (const std::exception& e) {
        std::fprintf(stderr, "video_views: %s\n", e.what());
        return 1;
    }
}
