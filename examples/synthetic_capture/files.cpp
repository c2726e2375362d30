// SPDX-License-Identifier: Apache-2.0
/// Writes a synthetic capture in the format of Gaussian Head Avatar, with gaze and eye masks.
#include <cmath>
#include <cstdio>
#include <numbers>

#include <nlohmann/json.hpp>

#include <rye/io/npz.hpp>
#include <rye/core/parallel.hpp>

#include "data/checksums.hpp"
#include "data/picture.hpp"
#include "data/threads.hpp"
#include "synthetic_capture/corneal_ray.hpp"
#include "synthetic_capture/scene.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

/// Above 90, colour is stored in full resolution.
constexpr int jpeg_quality = 95;
/// Values of the left and the right eyeball in the eye masks.
constexpr std::array<std::uint8_t, 3> eye_values{0, 85, 170};

/// Means of 2 x 2 pixels.
Image<float> halved(const Image<float>& image) {
    Image<float> out(image.width / 2, image.height / 2, image.channels());
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x)
            out.at(x, y) = 0.25f * (image.at(2 * x, 2 * y) + image.at(2 * x + 1, 2 * y) +
                                    image.at(2 * x, 2 * y + 1) + image.at(2 * x + 1, 2 * y + 1));
    return out;
}

/// Converted to T.
template <class T, class V>
NpyArray numbers(std::vector<Index> shape, const V& values) {
    std::vector<T> list;
    for (const auto x : values) list.push_back(static_cast<T>(x));
    return npy_array<T>(std::move(shape), std::span<const T>(list));
}

void write_arrays(const fs::path& path, const NpzArrays& arrays) {
    write_atomic(path, npz_bytes(arrays), Durability::atomic_only);
}

void write_camera(const fs::path& path, const Pinhole<double>& c) {
    const std::array<double, 9> k{c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1};
    Eigen::Matrix<double, 3, 4, Eigen::RowMajor> e;
    e << c.camera_from_world.rotation, c.camera_from_world.translation;
    write_arrays(path,
                 {{"intrinsic", npy_array<double>({3, 3}, std::span<const double>(k))},
                  {"extrinsic", npy_array<double>({3, 4}, std::span<const double>(e.data(), 12))}});
}

/// Columns `which` of the points, as float32 (N, 3).
template <class List>
NpyArray picked(const Points& points, const List& which) {
    Columns<float> out(3, static_cast<Index>(which.size()));
    Index k = 0;
    for (const Index i : which) {
        for (int d = 0; d < 3; ++d) out(d, k) = static_cast<float>(points(d, i));
        ++k;
    }
    return npy_array(out);
}

void write_params(const fs::path& folder, const HeadModel& model, const CaptureScene& scene,
                  const SceneFrame& f, const PosedHead& head) {
    const auto width = [](const auto& v) {
        return std::vector<Index>{1, static_cast<Index>(v.size())};
    };
    const VecX<double> scale = VecX<double>::Ones(1);
    write_arrays(folder / "params.npz",
                 {{"id_coeff", numbers<float>(width(model.identity), model.identity)},
                  {"exp_coeff", numbers<float>(width(f.state.expression), f.state.expression)},
                  {"lid_coeff", numbers<float>(width(f.state.lids), f.state.lids)},
                  {"pose", numbers<float>({1, 6}, f.pose)},
                  {"scale", numbers<float>({1, 1}, scale)}});
    write_atomic(folder / "lmk_3d.npy", npy_bytes(picked(head.vertices(), model.landmarks)),
                 Durability::atomic_only);
    write_atomic(folder / "vertices.npy", npy_bytes(picked(head.vertices(), model.dense)),
                 Durability::atomic_only);

    NpzArrays gaze;
    static constexpr std::array sides{"left", "right"};
    const Vec3<double> nowhere = Vec3<double>::Constant(std::nan(""));
    for (std::size_t e = 0; e < 2; ++e) {
        const std::string side = sides[e];
        const Vec3<double> world = f.state.world_from_head.turn(f.state.optical[e]);
        gaze["gaze_" + side] = numbers<double>({3}, f.state.optical[e]);
        gaze["gaze_" + side + "_world"] = numbers<double>({3}, world);
        gaze["visual_" + side] = numbers<double>({3}, f.visual[e]);
        gaze["eye_center_" + side] = numbers<double>({3}, head.eye_centres()[e]);
        gaze["kappa_" + side] = numbers<double>({2}, scene.kappa_deg[e]);
    }
    gaze["target"] = numbers<double>({3}, f.target.value_or(nowhere));
    const std::array<bool, 1> has_target{f.target.has_value()};
    gaze["has_target"] = npy_array<bool>({}, std::span<const bool>(has_target));
    const auto of_both = [&](const auto& length) {
        return numbers<double>({2}, std::array{length(model.eyes[0]), length(model.eyes[1])});
    };
    gaze["eye_radius"] = of_both([](const Eyeball& e) { return e.radius; });
    gaze["limbus_radius"] = of_both([](const Eyeball& e) { return e.limbus_radius; });
    gaze["iris_plane"] = of_both([](const Eyeball& e) { return e.iris_plane(); });
    write_arrays(folder / "gaze.npz", gaze);
}

/// Writes one view, its images as PNG or JPEG; returns the pixels of left and right eye.
std::array<int, 2> write_view(const fs::path& folder, const std::string& camera,
                              const HeadPicture& picture, bool png) {
    const auto file = [&](const char* stem, const char* suffix) {
        return folder / (stem + camera + suffix);
    };
    const auto write_image = [&](const char* stem, const Image8& image) {
        if (png) write_png(file(stem, ".png"), image);
        else write_jpeg(file(stem, ".jpg"), image, jpeg_quality);
    };
    write_image("image_", to_8bit(picture.image));
    write_image("image_lowres_", to_8bit(halved(picture.image)));
    write_png(file("mask_", ".png"), picture.mask);
    write_png(file("mask_lowres_", ".png"), halved(picture.mask));
    Image8 eyes{picture.mask.width, picture.mask.height, 1, {}};
    std::array<int, 3> count{};
    for (const std::uint8_t label : picture.eye) {
        eyes.values.push_back(eye_values[label]);
        ++count[label];
    }
    write_png(file("eye_mask_", ".png"), eyes);
    return {count[1], count[2]};
}

double rounded(double x, int decimals) {
    const double unit = std::pow(10.0, decimals);
    return std::round(x * unit) / unit;
}
Json pair(const Vec2<double>& v) { return {rounded(v.x(), 2), rounded(v.y(), 2)}; }

Json conventions(int size, bool refraction) {
    const std::string edge = std::to_string(size);
    const std::string seen = refraction
                                 ? "; that is where it is, and it is seen through the cornea "
                                   "of `refraction`, elsewhere and larger"
                                 : ", seen without refraction";
    return {
        {"world",
         "right-handed; with identity pose x = subject left, y up, z out of the face "
         "(toward the cameras)"},
        {"pose",
         "X_world = scale * R(pose[:3]) X_head + pose[3:]; pose[:3] is axis-angle in radians "
         "(Gaussian Head Avatar convention); scale is 1 here"},
        {"camera",
         "x_cam = extrinsic[:,:3] X_world + extrinsic[:,3]; OpenCV axes (x right, y down, "
         "z forward); u = fx x/z + cx, v = fy y/z + cy"},
        {"pixels", "u,v are CONTINUOUS image coordinates: the image spans [0," + edge +
                       "]; the centre of pixel column i, row j is (i+0.5, j+0.5). Principal points "
                       "are off centre on purpose. No lens distortion. For the half-size images "
                       "divide the intrinsics by 2."},
        {"image",
         "8-bit sRGB over black (premultiplied in sRGB): to put it on a background bg use "
         "image + (1-mask)*bg"},
        {"mask", "share of each pixel that the head covers, 0..255"},
        {"eye_mask",
         "values 0 none, 85 subject left eye, 170 subject right eye; visible eyeball "
         "(sclera+iris+cornea) at pixel centres, hidden by skin and lids. "
         "Nearest-sample, no antialiasing."},
        {"gaze",
         "gaze_left/right: unit OPTICAL axes in head coordinates (pose removed); *_world = R "
         "@ head. yaw = atan2(x,z) (+ toward subject left), pitch = asin(y) (+ up). "
         "visual_left/right: unit visual axes in head coordinates, eye centre -> target. "
         "optical(yaw,pitch) = visual(yaw,pitch) + kappa (deg, per eye, head coordinates). "
         "target is world; nan with has_target False for independent-gaze frames."},
        {"eyeball",
         "rigid: rotated about eye_center by the minimal (torsion-free) rotation taking +z "
         "to the optical axis; the iris is the disc of limbus_radius[eye] about eye_center "
         "+ iris_plane[eye]*gaze" +
             seen +
             "; eye_radius = scleral sphere; "
             "index 0 left, 1 right (world units)"},
        {"exp_coeff",
         "weights in 0..1 (exp_names), WITHOUT the 8 gaze-following lid shapes, which "
         "are in lid_coeff (lid_names) so that exp_coeff does not leak the gaze"},
        {"vertices",
         "vertices vertex_index.npy of the model (narrow face area), world; includes lid "
         "push-out over the cornea so it is not exactly linear in the coefficients"}};
}

Json frame_json(const HeadModel& model, const SceneFrame& f, const std::array<int, 2>& eye_pixels) {
    static constexpr std::array kinds{"train", "novel", "independent"};
    Json expression = Json::object();
    for (std::size_t i = 0; i < model.expression_names.size(); ++i)
        if (const double w = f.state.expression[static_cast<Index>(i)]; w != 0)
            expression[model.expression_names[i]] = rounded(w, 3);
    Json frame{{"frame", f.id},
            {"kind", kinds[static_cast<std::size_t>(f.kind)]},
            {"fixation_yaw_pitch_deg", f.fixation_deg ? pair(*f.fixation_deg) : Json()},
            {"optical_left_deg", pair(f.optical_deg[0])},
            {"optical_right_deg", pair(f.optical_deg[1])},
            {"expression", expression},
            {"eye_pixels_max_over_cameras", eye_pixels}};
    if (f.state.eye_offset[0].isZero(0) && f.state.eye_offset[1].isZero(0)) return frame;
    for (std::size_t e = 0; e < 2; ++e) {
        Json mm = Json::array();
        for (int k = 0; k < 3; ++k) mm.push_back(rounded(f.state.eye_offset[e][k] / unit_per_mm, 3));
        frame[e == 0 ? "eye_offset_left_mm" : "eye_offset_right_mm"] = mm;
    }
    return frame;
}

/// The displacements of landmarks and vertices by each expression alone, (E, N, 3), lids at rest.
NpzArrays expression_shapes(const HeadModel& model) {
    const Index count = static_cast<Index>(model.expression_names.size());
    const VecX<double> lids = VecX<double>::Zero(static_cast<Index>(lid_names.size()));
    const Points rest = model.vertices(VecX<double>::Zero(count), lids);
    std::vector<float> landmarks, dense;
    for (Index e = 0; e < count; ++e) {
        const Points moved = model.vertices(VecX<double>::Unit(count, e), lids) - rest;
        for (const Index i : model.landmarks)
            for (Index d = 0; d < 3; ++d) landmarks.push_back(static_cast<float>(moved(d, i)));
        for (const Index i : model.dense)
            for (Index d = 0; d < 3; ++d) dense.push_back(static_cast<float>(moved(d, i)));
    }
    const auto array = [&](const std::vector<float>& values, std::size_t points) {
        return npy_array<float>({count, static_cast<Index>(points), 3},
                                std::span<const float>(values));
    };
    return {{"landmarks", array(landmarks, model.landmarks.size())},
            {"vertices", array(dense, model.dense.size())}};
}

Json description(const HeadModel& model, const CaptureScene& scene, const Json& frames) {
    const CaptureSettings& s = scene.settings;
    Json ids = Json::array(), cameras = Json::array(), held_out = Json::array();
    for (const SceneCamera& c : scene.cameras) {
        ids.push_back(c.id);
        cameras.push_back({{"id", c.id},
                           {"yaw_deg", rounded(c.yaw_deg, 2)},
                           {"pitch_deg", rounded(c.pitch_deg, 2)},
                           {"distance", rounded(c.distance, 3)}});
    }
    for (const GazeCell& c : scene.held_out)
        held_out.push_back({{"yaw", pair(c.yaw_deg)}, {"pitch", pair(c.pitch_deg)}});
    const auto frames_of = [&](std::initializer_list<FrameKind> kinds) {
        Json list = Json::array();
        for (const SceneFrame& f : scene.frames)
            if (std::find(kinds.begin(), kinds.end(), f.kind) != kinds.end()) list.push_back(f.id);
        return list;
    };
    Json identity = Json::array();
    for (Index i = 0; i < model.identity.size(); ++i) identity.push_back(model.identity[i]);
    using enum FrameKind;
    Json all{
        {"subject", "seed " + std::to_string(s.seed)},
        {"image_size", {s.size, s.size}},
        {"lowres_size", {s.size / 2, s.size / 2}},
        {"camera_ids", ids},
        {"cameras", cameras},
        {"train_frames", frames_of({train})},
        {"test_frames", frames_of({novel, independent})},
        {"novel_gaze_test_frames", frames_of({novel})},
        {"independent_gaze_test_frames", frames_of({independent})},
        {"heldout_fixation_cells_deg", held_out},
        {"exp_names", model.expression_names},
        {"lid_names", lid_names},
        {"id_names", model.identity_names},
        {"conventions", conventions(s.size, s.refraction)},
        {"units", "1 unit is about 1 dm: nasion to chin about 1.1; camera distance about 10"},
        {"head_center", {head_centre.x(), head_centre.y(), head_centre.z()}},
        {"id_coeff", identity},
        {"kappa_deg", {{"left", pair(scene.kappa_deg[0])}, {"right", pair(scene.kappa_deg[1])}}},
        {"frames", frames},
        {"licence", model.origin},
        {"generator", "rye capture"},
        {"seed", s.seed},
        {"samples_per_pixel", s.samples}};
    if (s.softboxes) {
        Json boxes = Json::array();
        for (const Softbox& b : *s.softboxes)
            boxes.push_back({{"to", {b.to.x(), b.to.y(), b.to.z()}},
                             {"half_size", b.half_size},
                             {"radiance", {b.radiance.x(), b.radiance.y(), b.radiance.z()}}});
        all["softboxes"] = boxes;
    }
    if (s.refraction) {
        Json radius = Json::array(), ahead = Json::array();
        for (const Eyeball& eye : model.eyes) {
            radius.push_back(eye.cornea_radius);
            ahead.push_back(cornea_ahead(eye));
        }
        all["refraction"] = {{"refractive_index", s.corneal_index()},
                             {"cornea_radius", radius},
                             {"cornea_ahead", ahead}};
    }
    if (s.eye_translation_mm > 0) all["eye_translation_mm"] = s.eye_translation_mm;
    return all;
}

} // namespace

void write_capture(const HeadModel& model, const CaptureScene& scene, const fs::path& out,
                   const std::function<void(int, int)>& progress) {
    Json frames = Json::array();
    int done = 0;
    for (const SceneFrame& f : scene.frames) {
        const PosedHead head(model, f.state);
        const fs::path images = out / "images" / f.id, cameras = out / "cameras" / f.id;
        const fs::path params = out / "params" / f.id;
        for (const fs::path& folder : {images, cameras, params}) fs::create_directories(folder);
        std::vector<std::array<int, 2>> pixels(scene.cameras.size());
        const auto render = [&](Index i) {
            const SceneCamera& c = scene.cameras[static_cast<std::size_t>(i)];
            write_camera(cameras / ("camera_" + c.id + ".npz"), c.camera);
            pixels[static_cast<std::size_t>(i)] =
                write_view(images, c.id, head.picture(c.camera, scene.settings.samples),
                           scene.settings.png);
        };
        program_threads().run(static_cast<Index>(scene.cameras.size()), render);
        write_params(params, model, scene, f, head);
        std::array<int, 2> most{};
        for (const auto& p : pixels)
            for (std::size_t e = 0; e < 2; ++e) most[e] = std::max(most[e], p[e]);
        frames.push_back(frame_json(model, f, most));
        progress(++done, static_cast<int>(scene.frames.size()));
    }
    std::vector<std::int32_t> dense;
    for (const Index i : model.dense) dense.push_back(static_cast<std::int32_t>(i));
    const NpyArray index = npy_array<std::int32_t>({static_cast<Index>(dense.size())},
                                                   std::span<const std::int32_t>(dense));
    write_atomic(out / "vertex_index.npy", npy_bytes(index), Durability::atomic_only);
    write_arrays(out / "expression_shapes.npz", expression_shapes(model));
    Json about = description(model, scene, frames);
    about["checksums"] = array_checksums(out);
    const std::string text = checked_text(std::move(about), 1);
    write_atomic(out / "capture.json", as_bytes(text), Durability::atomic_only);
}

} // namespace rye::trainer
