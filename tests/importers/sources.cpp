// SPDX-License-Identifier: Apache-2.0
#include "sources.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <set>
#include <tuple>

#include <nlohmann/json.hpp>

#include <rye/io/npz.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "comparison.hpp"
#include "data/flaws.hpp"
#include "data/json.hpp"
#include "data/validate.hpp"
#include "importers/face_geometry.hpp"
#include "importers/flame.hpp"
#include "importers/import_folder.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using V3 = Vec3<double>;

void write_text(const fs::path& path, const std::string& text) {
    fs::create_directories(path.parent_path());
    std::ofstream(path) << text;
}

template <class T>
NpyArray array(std::vector<Index> shape, const std::vector<double>& values) {
    const std::vector<T> list(values.begin(), values.end());
    return npy_array<T>(std::move(shape), std::span<const T>(list));
}
std::vector<double> list_of(const V3& v) { return {v.x(), v.y(), v.z()}; }

std::string number(const char* format, int i) {
    char digits[32];
    std::snprintf(digits, sizeof digits, format, i);
    return digits;
}

/// Camera to world in OpenGL axes, row by row.
Json opengl_pose(const Pinhole<double>& c) {
    const Mat3<double> r = c.camera_from_world.rotation.transpose();
    const V3 at = c.centre();
    Json rows = Json::array();
    for (int i = 0; i < 3; ++i) rows.push_back({r(i, 0), -r(i, 1), -r(i, 2), at[i]});
    rows.push_back({0, 0, 0, 1});
    return rows;
}

/// The photograph over white.
Image8 over_white(const Capture& c, int f, int k) {
    Image<float> image = c.image(f, k);
    const Image<float> mask = c.mask(f, k);
    image.pixels.array().rowwise() += 1.0f - mask.pixels.row(0).array();
    return to_8bit(image);
}

/// Vertices of the synthetic head in the slots of FLAME's topology.
struct FlameShape {
    std::vector<Index> vertex; ///< of the model, for each of the first 3931 slots
    std::vector<Face> faces;
};

/// Clusters vertices, finely around the eyes, until they fit into the slots.
FlameShape flame_shape(const HeadModel& model) {
    const Points rest =
        model.vertices(VecX<double>::Zero(static_cast<Index>(model.expression_names.size())),
                       VecX<double>::Zero(8));
    constexpr Index slots = 3931;
    const std::set<Index> marks(model.landmarks.begin(), model.landmarks.end());
    for (double scale = 0.25;; scale *= 1.1) {
        std::map<std::tuple<int, Index, Index, Index>, Index> cells;
        std::vector<Index> leader(static_cast<std::size_t>(rest.cols()));
        for (Index i = 0; i < rest.cols(); ++i) {
            const V3 p = rest.col(i);
            const double away =
                std::min((p - model.eyes[0].centre).norm(), (p - model.eyes[1].centre).norm());
            const int level = away < 0.24 ? 0 : away < 0.6 ? 1 : 2;
            const double cell =
                scale * std::array{0.02, 0.08, 0.2}[static_cast<std::size_t>(level)];
            const auto place = [&](double x) { return static_cast<Index>(std::floor(x / cell)); };
            auto key = std::make_tuple(level, place(p.x()), place(p.y()), place(p.z()));
            if (marks.contains(i)) key = {3, i, 0, 0};
            leader[static_cast<std::size_t>(i)] = cells.emplace(key, i).first->second;
        }
        if (static_cast<Index>(cells.size() + 68) > slots) continue;
        FlameShape shape;
        shape.vertex.assign(slots, -1);
        std::map<Index, Index> slot;
        for (std::size_t k = 0; k < 68; ++k) {
            const Index v = model.landmarks[k];
            shape.vertex[static_cast<std::size_t>(flame_landmarks[k])] = v;
            slot.emplace(v, flame_landmarks[k]);
        }
        Index next = 0;
        for (const auto& [key, v] : cells) {
            if (slot.contains(v)) continue;
            while (shape.vertex[static_cast<std::size_t>(next)] >= 0) ++next;
            shape.vertex[static_cast<std::size_t>(next)] = v;
            slot[v] = next;
        }
        for (Index& v : shape.vertex)
            if (v < 0) v = model.landmarks[30];
        for (const Face& f : model.faces) {
            Face g;
            for (std::size_t k = 0; k < 3; ++k)
                g[k] = slot.at(leader[static_cast<std::size_t>(f[k])]);
            if (g[0] != g[1] && g[1] != g[2] && g[2] != g[0]) shape.faces.push_back(g);
        }
        return shape;
    }
}

constexpr int rings = 17, sectors = 32; // with two poles the 546 vertices of an eyeball

void add_eyeball(const Eyeball& eye, Index first, Points& vertices, std::vector<Face>& faces) {
    const auto at = [&](double angle, double turn) {
        const double r = eye.surface(angle);
        return V3(r * std::sin(angle) * std::cos(turn), r * std::sin(angle) * std::sin(turn),
                  r * std::cos(angle));
    };
    constexpr double pi = 3.14159265358979323846;
    vertices.col(first) = at(0, 0);
    vertices.col(first + 545) = at(pi, 0);
    for (int r = 0; r < rings; ++r)
        for (int s = 0; s < sectors; ++s) {
            const Index here = first + 1 + r * sectors + s;
            const Index next = first + 1 + r * sectors + (s + 1) % sectors;
            vertices.col(here) = at(pi * (r + 1) / (rings + 1), 2 * pi * s / sectors);
            if (r == 0) faces.push_back({first, here, next});
            if (r + 1 < rings) {
                faces.push_back({here, here + sectors, next + sectors});
                faces.push_back({here, next + sectors, next});
            } else {
                faces.push_back({here, first + 545, next});
            }
        }
}

std::string obj_text(const Points& vertices, const std::vector<Face>& faces) {
    std::string text = "# Generated with multi-view-head-tracker\n";
    char line[120];
    for (Index i = 0; i < vertices.cols(); ++i) {
        std::snprintf(line, sizeof line, "v %.9g %.9g %.9g\n", vertices(0, i), vertices(1, i),
                      vertices(2, i));
        text += line;
    }
    for (const Face& f : faces)
        text += "f " + std::to_string(f[0] + 1) + " " + std::to_string(f[1] + 1) + " " +
                std::to_string(f[2] + 1) + "\n";
    return text;
}

Rigid<double> pose_of(const CaptureFrame& f) {
    return {so3_exp(V3(f.pose.head<3>())), f.pose.tail<3>()};
}

/// The model's vertices by the labels of a frame, world.
Points head_vertices(const TrueScene& truth, const Capture& labels, int f) {
    const CaptureFrame& frame = labels.frames[static_cast<std::size_t>(f)];
    const CaptureFrame& right = truth.capture.frames[static_cast<std::size_t>(f)];
    const fs::path params = labels.folder / "params" / frame.id / "params.npz";
    const std::vector<double> lids = read_npz(params).at("lid_coeff").values<double>("lid_coeff");
    VecX<double> weights(static_cast<Index>(frame.expression.size()));
    for (std::size_t i = 0; i < frame.expression.size(); ++i)
        weights[static_cast<Index>(i)] = static_cast<double>(frame.expression[i]);
    Points head = truth.model.vertices(
        weights, Eigen::Map<const VecX<double>>(lids.data(), static_cast<Index>(lids.size())));
    clear_eyeballs(head, truth.model.eyes, {right.eyes[0].optical, right.eyes[1].optical}, 0.010);
    const Rigid<double> pose = pose_of(frame);
    return (pose.rotation * head).colwise() + pose.translation;
}

/// The tracker's errors of the landmarks and of the dense vertices, by the model's vertices, world.
Points landmark_errors(const TrueScene& truth, int f) {
    const CaptureFrame &a = truth.capture.frames[static_cast<std::size_t>(f)],
                       &b = truth.tracked.frames[static_cast<std::size_t>(f)];
    Points off = Points::Zero(
        3,
        truth.model
            .vertices(VecX<double>::Zero(static_cast<Index>(truth.model.expression_names.size())),
                      VecX<double>::Zero(static_cast<Index>(lid_names.size())))
            .cols());
    for (std::size_t i = 0; i < truth.model.dense.size(); ++i)
        off.col(truth.model.dense[i]) = (b.vertices - a.vertices).col(static_cast<Index>(i));
    const Columns<double> marks =
        true_landmarks(truth.tracked, b.id) - true_landmarks(truth.capture, a.id);
    for (std::size_t i = 0; i < 68; ++i)
        off.col(truth.model.landmarks[i]) = marks.col(static_cast<Index>(i));
    return off;
}

/// Centres of the eyeballs in the head, as the tracker has them.
std::array<V3, 2> eye_centres(const TrueScene& truth, int f) {
    const CaptureFrame &a = truth.capture.frames[static_cast<std::size_t>(f)],
                       &b = truth.tracked.frames[static_cast<std::size_t>(f)];
    std::array<V3, 2> all;
    for (std::size_t e = 0; e < 2; ++e) all[e] = pose_of(a).inverse().apply(*b.eyes[e].centre);
    return all;
}

} // namespace

Columns<double> true_landmarks(const Capture& c, const std::string& frame) {
    const NpyArray points = read_npy(c.folder / "params" / frame / "lmk_3d.npy");
    const std::vector<double> v = points.values<double>("lmk_3d");
    return Eigen::Map<const Columns<double>>(v.data(), 3, 68);
}

BrownConrady<double> source_lens() {
    BrownConrady<double> lens;
    lens.k1 = -4;
    lens.k2 = 3;
    lens.p1 = 0.02;
    lens.p2 = -0.015;
    return lens;
}

TrueScene true_scene(const fs::path& folder, const CaptureSettings& settings) {
    const HeadModel model = procedural_head(settings.seed, albedo_width_for(settings.size));
    write_capture(model, capture_scene(model, settings), folder, [](int, int) {});
    return captured_scene(folder, {});
}

TrueScene captured_scene(const fs::path& folder, const fs::path& model) {
    const Json about = read_json<Json>(folder / "capture.json");
    require(about.contains("seed") && about.at("seed").is_number_unsigned(),
            (folder / "capture.json").string() + ": seed",
            "is missing, expected a capture of `rye capture`");
    const auto seed = about.at("seed").get<std::uint64_t>();
    TrueScene t{model.empty() ? procedural_head(seed, 0) : ict_head(model, seed),
                read_valid_capture(folder), read_valid_capture(folder)};
    const CaptureFrame& first = t.capture.frames.front();
    const double off = (head_vertices(t, t.capture, 0)(Eigen::all, t.model.landmarks) -
                        true_landmarks(t.capture, first.id))
                           .cwiseAbs()
                           .maxCoeff();
    require(
        off < 1e-3, folder.string(), "its landmarks are ", [&] { return std::to_string(off); },
        " from those of ", model.empty() ? "rye's own head" : model.string(),
        ", expected below 0.001: give the --model of the capture");
    return t;
}

FlawSizes tracker_errors(bool stills) {
    FlawSizes sizes;
    if (stills) {
        sizes[Flaw::camera_rotation] = 0.5;
        sizes[Flaw::focal] = 1;
        return sizes;
    }
    sizes[Flaw::gaze_common] = 4;
    sizes[Flaw::gaze_single] = 2;
    sizes[Flaw::centres] = 1.2;
    sizes[Flaw::expression] = 0.06;
    sizes[Flaw::pose_rotation] = 0.6;
    sizes[Flaw::pose_position] = 1;
    sizes[Flaw::landmarks] = 1.5;
    return sizes;
}

void track(TrueScene& truth, const fs::path& folder, const FlawSizes& errors, std::uint64_t seed) {
    FlawOptions o;
    o.capture = truth.capture.folder;
    o.out = folder;
    o.seed = seed;
    o.sizes = errors;
    o.expression_share = 0.5;
    write_flawed(o);
    truth.tracked = read_valid_capture(folder);
}

namespace {

/// The true eye masks of a view as a camera in the same place sees them.
Image8 seen_eyes(const Capture& truth, int f, int k, const Pinhole<double>& camera,
                 const Similarity& same) {
    const Image8 eyes = read_image8(truth.view(f, k).eye_mask, 1);
    const Pinhole<double>& from = truth.camera(f, k);
    Image8 out = plain_image(camera.width, camera.height, 0);
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
            const V3 ray = same.motion.rotation * camera.ray(Vec2<double>(x + 0.5, y + 0.5));
            const V3 p = from.project_point(V3(from.centre() + ray));
            const auto u = static_cast<int>(std::floor(p.x())),
                       v = static_cast<int>(std::floor(p.y()));
            if (p.z() <= 0 || u < 0 || v < 0 || u >= eyes.width || v >= eyes.height) continue;
            out.values[static_cast<std::size_t>(y * out.width + x)] =
                eyes.values[static_cast<std::size_t>(v * eyes.width + u)];
        }
    return out;
}

/// The gaze.npz of a frame of an import with true eyeballs.
NpzArrays seen_gaze(const CaptureFrame& truth, const CaptureFrame& import, const Similarity& same,
                    TestGazes gazes) {
    NpzArrays gaze;
    const Mat3<double> back = same.motion.rotation.transpose();
    const Mat3<double> head = pose_of(import).rotation;
    std::array<std::vector<double>, 3> sizes;
    for (std::size_t e = 0; e < 2; ++e) {
        const std::string side = e == 0 ? "left" : "right";
        const CaptureEye& eye = truth.eyes[e];
        const V3 world = gazes == TestGazes::imported
                             ? V3(head * import.eyes[e].optical)
                             : V3(back * (pose_of(truth).rotation * eye.optical));
        gaze["gaze_" + side] = array<double>({3}, list_of(head.transpose() * world));
        gaze["gaze_" + side + "_world"] = array<double>({3}, list_of(world));
        const V3 centre = back * (*eye.centre - same.motion.translation) / same.size;
        gaze["eye_center_" + side] = array<double>({3}, list_of(centre));
        sizes[0].push_back(*eye.radius / same.size);
        sizes[1].push_back(*eye.limbus_radius / same.size);
        sizes[2].push_back(*eye.iris_plane / same.size);
    }
    gaze["eye_radius"] = array<double>({2}, sizes[0]);
    gaze["limbus_radius"] = array<double>({2}, sizes[1]);
    gaze["iris_plane"] = array<double>({2}, sizes[2]);
    return gaze;
}

} // namespace

void write_test_labels(const Capture& truth, const Capture& import, TestGazes gazes,
                       const fs::path& out) {
    require(import.test == truth.test && import.frame_count() == truth.frame_count(),
            import.folder.string(), "its test frames are not those of ", truth.folder.string());
    require(!fs::exists(out), out.string(), "exists already");
    fs::path to = out;
    to += ".tmp";
    fs::remove_all(to);
    fs::copy(import.folder, to, fs::copy_options::recursive);
    Json about = read_json<Json>(to / "capture.json");
    about.erase("checksum");
    about.erase("checksums");
    write_text(to / "capture.json", about.dump(1));
    for (const int f : truth.test) {
        const CaptureFrame &a = truth.frames[static_cast<std::size_t>(f)],
                           &b = import.frames[static_cast<std::size_t>(f)];
        const Similarity same = to_truth(truth, import, f);
        write_npz(to / "params" / b.id / "gaze.npz", seen_gaze(a, b, same, gazes));
        for (int k = 0; k < std::min(import.camera_count(), truth.camera_count()); ++k)
            if (import.view(f, k).present && truth.view(f, k).present)
                write_png(
                    to / "images" / b.id /
                        ("eye_mask_" + import.camera_ids[static_cast<std::size_t>(k)] + ".png"),
                    seen_eyes(truth, f, k, import.camera(f, k), same));
    }
    fs::rename(to, out);
}

void write_vhap_source(const TrueScene& truth, const fs::path& out) {
    constexpr double metre = 0.1;
    const Capture& c = truth.tracked;
    const FlameShape shape = flame_shape(truth.model);
    const Mat3<double> neck = so3_exp(V3(0.06, -0.04, 0.02));
    // VHAP moves the mean translation of all frames to the origin.
    const V3 origin(0.2, -0.1, 0.3);
    Json frames = Json::array(), train = Json::array(), test = Json::array();
    for (int f = 0; f < c.frame_count(); ++f) {
        const CaptureFrame& frame = c.frames[static_cast<std::size_t>(f)];
        const std::string id = number("%05d", f);
        const Points head = head_vertices(truth, c, f) + landmark_errors(truth, f);
        Points all(3, 5143);
        for (Index i = 0; i < 3931; ++i)
            all.col(i) = head.col(shape.vertex[static_cast<std::size_t>(i)]);
        std::vector<Face> faces = shape.faces;
        const Rigid<double> pose = pose_of(frame);
        const std::array<V3, 2> centres = eye_centres(truth, f);
        for (std::size_t e = 0; e < 2; ++e) {
            const Index first = flame_eyeballs[2 * e];
            add_eyeball(truth.model.eyes[e], first, all, faces);
            const Mat3<double> turn =
                pose.rotation * quat_matrix(shortest_arc(V3(0, 0, 1), frame.eyes[e].optical));
            const Points ball =
                (turn * all.middleCols(first, 546)).colwise() + pose.apply(centres[e]);
            all.middleCols(first, 546) = ball;
        }
        for (Index i = flame_vertices; i < 5143; ++i)
            all.col(i) = pose.apply(V3(0, -0.3, 0.6)); // teeth
        all = (all * metre).colwise() - origin;
        write_text(out / "meshes" / (id + ".obj"), obj_text(all, faces));

        std::vector<double> expr(100, 0), eyes;
        for (std::size_t i = 0; i < std::min<std::size_t>(100, frame.expression.size()); ++i)
            expr[i] = static_cast<double>(frame.expression[i]);
        for (std::size_t e = 0; e < 2; ++e) {
            const V3 turn = so3_log(quat_matrix(shortest_arc(V3(0, 0, 1), frame.eyes[e].optical)));
            for (int d = 0; d < 3; ++d) eyes.push_back(turn[d]);
        }
        fs::create_directories(out / "flame_param");
        write_npz(
            out / "flame_param" / (id + ".npz"),
            {{"expr", array<float>({1, 100}, expr)},
             {"rotation",
              array<float>({1, 3}, list_of(so3_log<double>(pose.rotation * neck.transpose())))},
             {"neck_pose", array<float>({1, 3}, list_of(so3_log(neck)))},
             {"jaw_pose", array<float>({1, 3}, {0.1, 0, 0})},
             {"eyes_pose", array<float>({1, 6}, eyes)},
             {"translation", array<float>({1, 3}, list_of(V3(metre * pose.translation - origin)))},
             {"shape", array<float>({300}, std::vector<double>(300, 0.1))},
             {"static_offset", array<float>({1, 5143, 3}, std::vector<double>(5143 * 3, 0))}});
        for (int k = 0; k < c.camera_count(); ++k) {
            const std::string name = id + "_" + number("%02d", k) + ".png";
            Pinhole<double> camera = c.camera(f, k);
            const V3 centre = metre * camera.centre() - origin;
            camera.camera_from_world.translation = -(camera.camera_from_world.rotation * centre);
            fs::create_directories(out / "images");
            fs::create_directories(out / "fg_masks");
            write_png(out / "images" / name, over_white(c, f, k));
            write_png(out / "fg_masks" / name, to_8bit(c.mask(f, k)));
            Json view = {{"timestep_index", f},
                         {"timestep_index_original", f},
                         {"timestep_id", number("%06d", f)},
                         {"camera_index", k},
                         {"camera_id", c.camera_ids[static_cast<std::size_t>(k)]},
                         {"cx", camera.cx},
                         {"cy", camera.cy},
                         {"fl_x", camera.fx},
                         {"fl_y", camera.fy},
                         {"h", camera.height},
                         {"w", camera.width},
                         {"camera_angle_x", 2 * std::atan(camera.width / (2 * camera.fx))},
                         {"camera_angle_y", 2 * std::atan(camera.height / (2 * camera.fy))},
                         {"transform_matrix", opengl_pose(camera)},
                         {"file_path", "images/" + name},
                         {"fg_mask_path", "fg_masks/" + name},
                         {"flame_param_path", "flame_param/" + id + ".npz"}};
            const bool held_out = std::find(c.test.begin(), c.test.end(), f) != c.test.end();
            (held_out ? test : train).push_back(view);
            frames.push_back(std::move(view));
        }
    }
    const auto write = [&](const char* file, const Json& list) {
        write_text(out / file, Json{{"frames", list}}.dump(4));
    };
    write("transforms.json", frames);
    write("transforms_train.json", train);
    write("transforms_test.json", test);
}

void write_gazes(const TrueScene& truth, const fs::path& file) {
    std::string text = "frame,left_pitch,left_yaw,right_pitch,right_yaw\n";
    for (const CaptureFrame& f : truth.tracked.frames) {
        text += f.id;
        for (const CaptureEye& eye : f.eyes) {
            const Vec2<double> a = 57.29577951308232 * pitch_yaw(eye.optical);
            text += "," + std::to_string(a[0]) + "," + std::to_string(a[1]);
        }
        text += "\n";
    }
    write_text(file, text);
}

void write_gha_source(const TrueScene& truth, const fs::path& out, double unit) {
    const Capture& c = truth.tracked;
    for (int f = 0; f < c.frame_count(); ++f) {
        const CaptureFrame& frame = c.frames[static_cast<std::size_t>(f)];
        const fs::path from = c.folder / "params" / frame.id, params = out / "params" / frame.id;
        const fs::path images = out / "images" / frame.id, cameras = out / "cameras" / frame.id;
        for (const fs::path& folder : {params, images, cameras}) fs::create_directories(folder);
        NpzArrays arrays = read_npz(from / "params.npz");
        std::vector<double> pose(frame.pose.data(), frame.pose.data() + 6);
        for (std::size_t i = 3; i < 6; ++i) pose[i] *= unit;
        arrays["pose"] = array<float>({1, 6}, pose);
        arrays["scale"] = array<float>({1, 1}, {unit});
        arrays["id_coeff"] = array<float>({1, 100}, std::vector<double>(100, 0.5));
        arrays.erase("lid_coeff");
        write_npz(params / "params.npz", arrays);
        for (const char* file : {"lmk_3d.npy", "vertices.npy"}) {
            const NpyArray points = read_npy(from / file);
            std::vector<double> v = points.values<double>(file);
            for (double& x : v) x *= unit;
            write_npy(params / file, array<float>(points.shape, v));
        }
        for (int k = 0; k < c.camera_count(); ++k) {
            const std::string id = c.camera_ids[static_cast<std::size_t>(k)];
            const Image8 picture = to_8bit(c.image(f, k)), mask = to_8bit(c.mask(f, k));
            const Image8 visible{c.width, c.height, 1,
                                 std::vector<std::uint8_t>(mask.values.size(), 255)};
            for (const char* size : {"", "lowres_"}) {
                write_jpeg(images / (std::string("image_") + size + id + ".jpg"), picture, 95);
                write_jpeg(images / (std::string("mask_") + size + id + ".jpg"), mask, 95);
                write_jpeg(images / (std::string("visible_") + size + id + ".jpg"), visible, 95);
            }
            Pinhole<double> camera = c.camera(f, k);
            camera.camera_from_world.translation *= unit;
            Eigen::Matrix<double, 3, 4, Eigen::RowMajor> e;
            e << camera.camera_from_world.rotation, camera.camera_from_world.translation;
            write_npz(cameras / ("camera_" + id + ".npz"),
                      {{"intrinsic", array<double>({3, 3}, {camera.fx, 0, camera.cx, 0, camera.fy,
                                                            camera.cy, 0, 0, 1})},
                       {"extrinsic", array<double>({3, 4}, {e.data(), e.data() + 12})}});
        }
    }
}

namespace {

/// The picture of a camera with the lens: each pixel is taken from where the pinhole has its ray.
Image8 through_lens(const Image8& picture, const Pinhole<double>& camera,
                    const BrownConrady<double>& lens) {
    Image8 out = picture;
    const auto clamped = [](double x, int size) {
        return std::clamp(static_cast<int>(std::floor(x)), 0, size - 1);
    };
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
            const Undistorted<double> s = undistort(
                lens,
                Vec2<double>((x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy));
            const int u = clamped(camera.fx * s.slope[0] + camera.cx, out.width);
            const int v = clamped(camera.fy * s.slope[1] + camera.cy, out.height);
            for (std::size_t ch = 0; ch < 3; ++ch) {
                const auto at = [&](int px, int py) {
                    return 3 * (static_cast<std::size_t>(py) * static_cast<std::size_t>(out.width) +
                                static_cast<std::size_t>(px)) +
                           ch;
                };
                out.values[at(x, y)] = picture.values[at(u, v)];
            }
        }
    return out;
}

std::string still_name(int k) { return number("photo_%02d.png", k); }

void write_still(const Capture& c, int k, const fs::path& path, bool lens) {
    fs::create_directories(path.parent_path());
    const Image8 picture = over_white(c, 0, k);
    write_png(path, lens ? through_lens(picture, c.camera(0, k), source_lens()) : picture);
}

} // namespace

void write_transforms_source(const TrueScene& truth, const fs::path& out, bool lens) {
    const Capture& c = truth.tracked;
    const Pinhole<double>& first = c.camera(0, 0);
    Json json = {{"camera_model", "OPENCV"}, {"w", first.width}, {"h", first.height}};
    if (lens) {
        const BrownConrady<double> l = source_lens();
        json.update({{"k1", l.k1}, {"k2", l.k2}, {"p1", l.p1}, {"p2", l.p2}});
    }
    json["frames"] = Json::array();
    for (int k = 0; k < c.camera_count(); ++k) {
        const Pinhole<double>& camera = c.camera(0, k);
        write_still(c, k, out / "images" / still_name(k), lens);
        json["frames"].push_back({{"file_path", "images/" + still_name(k)},
                                  {"fl_x", camera.fx},
                                  {"fl_y", camera.fy},
                                  {"cx", camera.cx},
                                  {"cy", camera.cy},
                                  {"transform_matrix", opengl_pose(camera)}});
        if (!lens) {
            fs::create_directories(out / "masks");
            write_png(out / "masks" / still_name(k), to_8bit(c.mask(0, k)));
            json["frames"].back()["mask_path"] = "masks/" + still_name(k);
        }
    }
    write_text(out / "transforms.json", json.dump(2));
}

void write_blender_source(const TrueScene& truth, const fs::path& out) {
    const Capture& c = truth.tracked;
    const std::array<std::string, 3> parts{"train", "val", "test"};
    for (int k = 0; k < 3; ++k) {
        const std::string& part = parts[static_cast<std::size_t>(k)];
        const Pinhole<double>& camera = c.camera(0, k);
        const Image8 color = over_white(c, 0, k), mask = to_8bit(c.mask(0, k));
        Image8 picture{color.width, color.height, 4, {}};
        for (std::size_t i = 0; i < mask.values.size(); ++i) {
            for (std::size_t j = 0; j < 3; ++j) picture.values.push_back(color.values[3 * i + j]);
            picture.values.push_back(mask.values[i]);
        }
        fs::create_directories(out / part);
        write_png(out / part / "r_0.png", picture);
        const Json json = {{"camera_angle_x", 2 * std::atan(0.5 * camera.width / camera.fx)},
                           {"frames",
                            {{{"file_path", "./" + part + "/r_0"},
                              {"rotation", 0.012566370614359171},
                              {"transform_matrix", opengl_pose(camera)}}}}};
        write_text(out / ("transforms_" + part + ".json"), json.dump(4));
    }
}

void write_colmap_source(const TrueScene& truth, const fs::path& out, ColmapFiles files,
                         bool lens) {
    const Capture& c = truth.tracked;
    const fs::path model = out / "sparse" / "0";
    const auto count = static_cast<std::uint64_t>(c.camera_count());
    Bytes cameras, images;
    append(cameras, count);
    append(images, count);
    std::string camera_text = "# Camera list with one line of data per camera:\n";
    std::string image_text = "# Image list with two lines of data per image:\n";
    for (int k = 0; k < c.camera_count(); ++k) {
        const Pinhole<double>& camera = c.camera(0, k);
        const BrownConrady<double> l = source_lens();
        std::vector<double> p{camera.fx, camera.fy, camera.cx, camera.cy};
        if (lens) p.insert(p.end(), {l.k1, l.k2, l.p1, l.p2});
        const auto id = static_cast<std::uint32_t>(k + 1);
        append(cameras, id);
        append(cameras, std::int32_t(lens ? 4 : 1));
        append(cameras, static_cast<std::uint64_t>(camera.width));
        append(cameras, static_cast<std::uint64_t>(camera.height));
        camera_text += std::to_string(id) + (lens ? " OPENCV " : " PINHOLE ") +
                       std::to_string(camera.width) + " " + std::to_string(camera.height);
        char digits[40];
        for (const double x : p) {
            append(cameras, x);
            std::snprintf(digits, sizeof digits, " %.17g", x);
            camera_text += digits;
        }
        camera_text += "\n";
        const Quat<double> q = matrix_quat(camera.camera_from_world.rotation);
        append(images, id + 100);
        image_text += std::to_string(id + 100);
        std::vector<double> pose{q[0], q[1], q[2], q[3]};
        for (int d = 0; d < 3; ++d) pose.push_back(camera.camera_from_world.translation[d]);
        for (const double x : pose) {
            append(images, x);
            std::snprintf(digits, sizeof digits, " %.17g", x);
            image_text += digits;
        }
        append(images, id);
        append(images, as_bytes(still_name(k)));
        append(images, '\0');
        append(images, std::uint64_t(1)); // one point of the picture
        append(images, 1.5);
        append(images, 2.5);
        append(images, std::uint64_t(7));
        image_text +=
            " " + std::to_string(id) + " " + still_name(k) + (k == 0 ? "\n\n" : "\n1.5 2.5 7\n");
        write_still(c, k, out / "images" / still_name(k), lens);
    }
    fs::create_directories(model);
    if (files == ColmapFiles::text) {
        write_text(model / "cameras.txt", camera_text);
        write_text(model / "images.txt", image_text);
        return;
    }
    write_atomic(model / "cameras.bin", cameras, Durability::atomic_only);
    write_atomic(model / "images.bin", images, Durability::atomic_only);
}

} // namespace rye::trainer
