// SPDX-License-Identifier: Apache-2.0
#include "data/run_frames.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>

#include <rye/io/safetensors.hpp>

#include "data/cameras_file.hpp"
#include "data/checksums.hpp"
#include "data/json.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr const char* format_name = "rye-frames";
constexpr const char* format_version = "1";
constexpr Index landmark_count = 66;
constexpr double most_off_unit = 1e-3;     // as in the checks of a capture

/// Number of a camera's intrinsic and extrinsic numbers.
constexpr Index intrinsic_numbers = 4, extrinsic_numbers = 12;

/// Stored arrays of F frames, E coefficients, C cameras and K different poses of cameras.
struct Arrays {
    Index frames = 0, coefficients = 0, cameras = 0, poses = 0;
    std::vector<float> expression;
    std::vector<double> pose, scale, landmarks, gaze, visual, eye_centre, intrinsic, extrinsic;
    std::vector<std::int64_t> view;
    TensorMetadata words;

    std::vector<TensorEntry> entries() const {
        const std::span<const std::int64_t> views(view);
        std::vector<TensorEntry> all{
            tensor_entry<float>("expression", {frames, coefficients}, expression),
            tensor_entry<double>("pose", {frames, 6}, pose),
            tensor_entry<double>("scale", {frames}, scale),
            tensor_entry<double>("landmarks", {frames, landmark_count, 3}, landmarks),
            tensor_entry<double>("gaze", {frames, 2, 3}, gaze),
            tensor_entry<double>("camera.intrinsic", {poses, intrinsic_numbers}, intrinsic),
            tensor_entry<double>("camera.extrinsic", {poses, 3, 4}, extrinsic),
            tensor_entry<std::int64_t>("camera.of_view", {frames, cameras}, views)};
        if (!visual.empty()) all.push_back(tensor_entry<double>("visual", {frames, 2, 3}, visual));
        if (!eye_centre.empty())
            all.push_back(tensor_entry<double>("eye_centre", {frames, 2, 3}, eye_centre));
        return all;
    }
};

void append(std::vector<double>& to, const auto& matrix) {
    to.insert(to.end(), matrix.data(), matrix.data() + matrix.size());
}

/// fx, fy, cx, cy; then (R | t), row by row.
using CameraNumbers = std::array<double, intrinsic_numbers + extrinsic_numbers>;
CameraNumbers numbers_of(const Pinhole<double>& c) {
    CameraNumbers n{c.fx, c.fy, c.cx, c.cy};
    std::size_t at = intrinsic_numbers;
    for (Index i = 0; i < 3; ++i) {
        for (Index j = 0; j < 3; ++j) n[at++] = c.camera_from_world.rotation(i, j);
        n[at++] = c.camera_from_world.translation[i];
    }
    return n;
}

/// Appends the views; cameras that do not move are stored once.
void append_views(const Capture& c, Arrays& a) {
    std::map<CameraNumbers, std::int64_t> known;
    for (int f = 0; f < c.frame_count(); ++f)
        for (int k = 0; k < c.camera_count(); ++k) {
            if (!c.view(f, k).present) {
                a.view.push_back(-1);
                continue;
            }
            const CameraNumbers n = numbers_of(c.camera(f, k));
            const auto [at, added] = known.emplace(n, static_cast<std::int64_t>(known.size()));
            a.view.push_back(at->second);
            if (!added) continue;
            a.intrinsic.insert(a.intrinsic.end(), n.begin(), n.begin() + intrinsic_numbers);
            a.extrinsic.insert(a.extrinsic.end(), n.begin() + intrinsic_numbers, n.end());
        }
    a.poses = static_cast<Index>(known.size());
}

Arrays arrays_of(const Capture& c) {
    const std::string who = c.folder.string();
    require(c.frame_count() > 0 && c.camera_count() > 0 && c.has_gaze(), who,
            "got a capture without frames, cameras or gazes, expected all three");
    Arrays a;
    a.frames = c.frame_count();
    a.coefficients = c.expression_width();
    a.cameras = c.camera_count();
    const bool visual = std::all_of(c.frames.begin(), c.frames.end(), [](const CaptureFrame& f) {
        return f.eyes[0].visual && f.eyes[1].visual;
    });
    std::vector<std::string> names;
    for (const CaptureFrame& f : c.frames) {
        names.push_back(f.id);
        a.expression.insert(a.expression.end(), f.expression.begin(), f.expression.end());
        append(a.pose, f.pose);
        a.scale.push_back(f.scale);
        append(a.landmarks, f.landmarks);
        for (const CaptureEye& eye : f.eyes) {
            append(a.gaze, eye.optical);
            if (visual) append(a.visual, *eye.visual);
            if (c.has_centres()) append(a.eye_centre, *eye.centre);
        }
    }
    append_views(c, a);
    a.words = {{"format", format_name},
               {"version", format_version},
               {"subject", c.subject},
               {"width", std::to_string(c.width)},
               {"height", std::to_string(c.height)},
               {"frames", Json(names).dump()},
               {"cameras", Json(c.camera_ids).dump()},
               {"expression_names", Json(c.expression_names).dump()},
               {"train", Json(c.train).dump()},
               {"test", Json(c.test).dump()},
               {"novel_gaze", Json(c.novel_gaze).dump()},
               {"independent_gaze", Json(c.independent_gaze).dump()}};
    return a;
}

/// Returns the FNV-1a hash, 64 bits, of all words and tensors.
std::string mark_of(std::vector<TensorEntry> entries, const TensorMetadata& words) {
    std::uint64_t hash = 0xcbf29ce484222325U;
    const auto add = [&](ByteSpan bytes) {
        for (const std::byte b : bytes)
            hash = (hash ^ static_cast<std::uint64_t>(b)) * 0x100000001b3U;
    };
    const auto add_text = [&](const std::string& text) { add(as_bytes(text + '\n')); };
    for (const auto& [key, word] : words) add_text(key), add_text(word);
    std::sort(entries.begin(), entries.end(),
              [](const TensorEntry& a, const TensorEntry& b) { return a.name < b.name; });
    for (const TensorEntry& e : entries)
        add_text(e.name), add_text(shape_text(e.shape)), add(e.bytes);
    char digits[17] = "";
    const auto end = std::to_chars(digits, digits + 16, hash, 16).ptr;
    return {digits, end};
}

// ---- reading -----------------------------------------------------------------------------------

/// File that is read: its words and finite numbers.
struct Source {
    std::string who;
    Safetensors file;

    Error fault(const std::string& field, const std::string& message) const {
        return Error(who + ": " + field + ": " + message);
    }
    template <class T>
    std::vector<T> numbers(const std::string& name, const std::vector<Index>& shape) const {
        const std::vector<T> v = file.values<T>(name, shape);
        for (std::size_t i = 0; i < v.size(); ++i)
            if (!std::isfinite(static_cast<double>(v[i])))
                throw fault("tensor '" + name + "'", "value " + std::to_string(i) + " is " +
                                                         std::to_string(v[i]) +
                                                         ", expected a finite number");
        return v;
    }
    Json list(const std::string& key) const {
        const std::string field = who + ": metadata '" + key + "'";
        Json json = parse_json_text(file.word(key), field);
        require(json.is_array(), field, "expected a list");
        return json;
    }
    std::vector<std::string> names(const std::string& key) const {
        std::vector<std::string> all;
        for (const Json& item : list(key)) {
            if (!item.is_string())
                throw fault("metadata '" + key + "'", "got " + item.dump() + ", expected a name");
            all.push_back(item.get<std::string>());
        }
        return all;
    }
    /// Returns indices below `count`.
    std::vector<int> indices(const std::string& key, int count) const {
        std::vector<int> all;
        for (const Json& item : list(key)) {
            if (!item.is_number_integer() || item.get<std::int64_t>() < 0 ||
                item.get<std::int64_t>() >= count)
                throw fault(
                    "metadata '" + key + "'",
                    "got " + item.dump() + ", expected 0 to below " + std::to_string(count));
            all.push_back(item.get<int>());
        }
        return all;
    }
    int side(const std::string& key) const {
        const std::string& text = file.word(key);
        int value = 0;
        const auto [end, bad] = std::from_chars(text.data(), text.data() + text.size(), value);
        if (bad != std::errc() || end != text.data() + text.size() || value < 1 ||
            value > max_image_edge)
            throw fault("metadata '" + key + "'", "got '" + text + "', expected 1 to " +
                                                      std::to_string(max_image_edge) + " pixels");
        return value;
    }
};

/// Returns the unit vector at an index; throws an Error if its length is not 1.
Vec3<double> direction(const Source& from, const char* name, const std::vector<double>& all,
                       std::size_t at) {
    const Vec3<double> v(all.data() + 3 * at);
    if (std::abs(norm(v) - 1) > most_off_unit)
        throw from.fault(std::string("tensor '") + name + "'",
                         "vector " + std::to_string(at) + " has length " + std::to_string(norm(v)) +
                             ", expected a unit vector");
    return v;
}

void read_frames(const Source& from, Capture& c, Index frames) {
    const std::vector<Index>& shape = from.file.at("expression").shape;
    if (shape.size() != 2 || shape[0] != frames)
        throw from.fault("tensor 'expression'", "got shape " + shape_text(shape) + ", expected (" +
                                                    std::to_string(frames) + ", E)");
    const auto width = static_cast<std::size_t>(shape[1]);
    const std::vector<float> expression = from.numbers<float>("expression", shape);
    const std::vector<double> pose = from.numbers<double>("pose", {frames, 6});
    const std::vector<double> scale = from.numbers<double>("scale", {frames});
    const std::vector<double> landmarks =
        from.numbers<double>("landmarks", {frames, landmark_count, 3});
    const std::vector<double> gaze = from.numbers<double>("gaze", {frames, 2, 3});
    std::vector<double> visual, centre;
    if (from.file.has("visual")) visual = from.numbers<double>("visual", {frames, 2, 3});
    if (from.file.has("eye_centre")) centre = from.numbers<double>("eye_centre", {frames, 2, 3});
    for (std::size_t f = 0; f < static_cast<std::size_t>(frames); ++f) {
        CaptureFrame& frame = c.frames[f];
        const float* const first = expression.data() + f * width;
        frame.expression.assign(first, first + width);
        frame.pose = Vec<double, 6>(pose.data() + 6 * f);
        frame.scale = scale[f];
        if (!(frame.scale > 0))
            throw from.fault("tensor 'scale'", "value " + std::to_string(f) + " is " +
                                                   std::to_string(frame.scale) + ", expected > 0");
        frame.landmarks = Eigen::Map<const Columns<double>>(
            landmarks.data() + f * 3 * landmark_count, 3, landmark_count);
        frame.vertices.resize(3, 0);
        for (std::size_t e = 0; e < 2; ++e) {
            const std::size_t at = 2 * f + e;
            frame.eyes[e].optical = direction(from, "gaze", gaze, at);
            if (!visual.empty()) frame.eyes[e].visual = direction(from, "visual", visual, at);
            if (!centre.empty()) frame.eyes[e].centre = Vec3<double>(centre.data() + 3 * at);
        }
        frame.has_gaze = true;
        frame.has_centres = !centre.empty();
    }
}

Pinhole<double> camera_of(const Source& from, const double* intrinsic, const double* extrinsic,
                          Index number) {
    Pinhole<double> c;
    c.fx = intrinsic[0], c.fy = intrinsic[1], c.cx = intrinsic[2], c.cy = intrinsic[3];
    if (!(c.fx > 0 && c.fy > 0))
        throw from.fault("tensor 'camera.intrinsic'", "camera " + std::to_string(number) +
                                                          " has focal lengths " +
                                                          std::to_string(c.fx) + " and " +
                                                          std::to_string(c.fy) + ", expected > 0");
    const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> m(extrinsic);
    const Mat3<double> r = m.leftCols<3>();
    const Vec3<double> x = r.row(0), y = r.row(1), z = r.row(2);
    if ((r * r.transpose() - Mat3<double>::Identity()).cwiseAbs().maxCoeff() > most_off_rotation ||
        !(dot(cross(x, y), z) > 0))
        throw from.fault("tensor 'camera.extrinsic'",
                         "the 3 x 3 part of camera " + std::to_string(number) + " is no rotation");
    c.camera_from_world.rotation = r;
    c.camera_from_world.translation = m.col(3);
    return c;
}

void read_views(const Source& from, Capture& c, Index frames) {
    const auto cameras = static_cast<Index>(c.camera_ids.size());
    const std::vector<Index>& shape = from.file.at("camera.intrinsic").shape;
    const Index poses = shape.empty() ? 0 : shape[0];
    const auto intrinsic = from.numbers<double>("camera.intrinsic", {poses, intrinsic_numbers});
    const auto extrinsic = from.numbers<double>("camera.extrinsic", {poses, 3, 4});
    std::vector<Pinhole<double>> all;
    for (Index k = 0; k < poses; ++k) {
        all.push_back(camera_of(from, intrinsic.data() + k * intrinsic_numbers,
                                extrinsic.data() + k * extrinsic_numbers, k));
        all.back().width = c.width;
        all.back().height = c.height;
    }
    for (const std::int64_t k :
         from.file.values<std::int64_t>("camera.of_view", {frames, cameras})) {
        if (k < -1 || k >= poses)
            throw from.fault(
                "tensor 'camera.of_view'",
                "got " + std::to_string(k) + ", expected -1 to below " + std::to_string(poses));
        CaptureView& view = c.views.emplace_back();
        view.present = k >= 0;
        if (view.present) view.camera = all[static_cast<std::size_t>(k)];
    }
}

/// Returns the capture in a file.
Capture capture_of(const Source& from) {
    const auto expect = [&](const char* key, const std::string& expected) {
        const std::string& got = from.file.word(key);
        if (got != expected)
            throw from.fault(std::string("metadata '") + key + "'",
                             "got '" + got + "', expected '" + expected + "'");
    };
    expect("format", format_name);
    expect("version", format_version);
    Capture c;
    c.folder = from.who;
    c.subject = from.file.word("subject");
    c.width = from.side("width");
    c.height = from.side("height");
    c.camera_ids = from.names("cameras");
    c.expression_names = from.names("expression_names");
    const std::vector<std::string> ids = from.names("frames");
    require(!ids.empty() && !c.camera_ids.empty(), from.who,
            "got no frames or no cameras, expected both");
    // Frames are made only if the file has numbers for them.
    from.numbers<double>("landmarks", {static_cast<Index>(ids.size()), landmark_count, 3});
    for (const std::string& id : ids) c.frames.emplace_back().id = id;
    const int frames = c.frame_count();
    c.train = from.indices("train", frames);
    c.test = from.indices("test", frames);
    c.novel_gaze = from.indices("novel_gaze", frames);
    c.independent_gaze = from.indices("independent_gaze", frames);
    read_frames(from, c, frames);
    read_views(from, c, frames);
    return c;
}

} // namespace

std::string frames_mark(const Capture& capture) {
    const Arrays a = arrays_of(capture);
    return mark_of(a.entries(), a.words);
}

void save_frames(const fs::path& run, const Capture& capture) {
    const Arrays a = arrays_of(capture);
    const auto check = [&](const char* name, const auto& values) {
        for (const auto x : values)
            require(
                std::isfinite(x), frames_path(run).string() + ": not written", "tensor '", name,
                "': got ", [&] { return std::to_string(x); }, ", expected finite numbers");
    };
    check("expression", a.expression);
    check("pose", a.pose);
    check("scale", a.scale);
    check("landmarks", a.landmarks);
    check("gaze", a.gaze);
    check("visual", a.visual);
    check("eye_centre", a.eye_centre);
    check("camera.intrinsic", a.intrinsic);
    check("camera.extrinsic", a.extrinsic);
    write_safetensors(frames_path(run), a.entries(), a.words);
}

Capture load_frames(const fs::path& run, const std::string& mark) {
    const fs::path path = frames_path(run);
    const Source from{path.string(), read_safetensors(path)};
    if (!from.file.checked()) warn_unchecked(from.who);
    std::vector<TensorEntry> entries;
    for (const auto& [name, entry] : from.file.tensors()) entries.push_back(entry);
    if (!mark.empty() && mark_of(entries, from.file.metadata()) != mark)
        throw Error(from.who +
                    ": is damaged, or of another run than the checkpoint beside it; "
                    "`rye train --out " +
                    run.string() +
                    " --resume` writes it anew from the "
                    "capture, and --capture draws without it");
    return capture_of(from);
}

Capture parse_frames(ByteSpan bytes, const std::string& who) {
    return capture_of({who, parse_safetensors(bytes, who)});
}

} // namespace rye::trainer
