// SPDX-License-Identifier: Apache-2.0
#include "importers/import_folder.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <set>
#include <span>

#include <rye/io/npz.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>

#include "data/checksums.hpp"
#include "data/json_fields.hpp"
#include "data/threads.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

/// Returns the values converted to T.
template <class T>
NpyArray numbers(std::vector<Index> shape, std::span<const double> values) {
    std::vector<T> list;
    for (const double x : values) list.push_back(static_cast<T>(x));
    return npy_array<T>(std::move(shape), std::span<const T>(list));
}

void write_bytes(const fs::path& path, ByteSpan bytes) {
    write_atomic(path, bytes, Durability::atomic_only);
}

void write_camera(const fs::path& path, const Pinhole<double>& c) {
    const std::array<double, 9> k{c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1};
    Eigen::Matrix<double, 3, 4, Eigen::RowMajor> e;
    e << c.camera_from_world.rotation, c.camera_from_world.translation;
    write_bytes(path, npz_bytes({{"intrinsic", numbers<double>({3, 3}, k)},
                                 {"extrinsic", numbers<double>({3, 4}, {e.data(), 12})}}));
}

void write_points(const fs::path& path, const Columns<double>& points) {
    write_bytes(path, npy_bytes(npy_array<double>(points)));
}

std::span<const double> span_of(const Vec3<double>& v) { return {v.data(), 3}; }

/// Writes gazes and eyeballs; world directions follow from the pose.
void write_eyes(const fs::path& folder, const Vec<double, 6>& pose,
                const std::array<CaptureEye, 2>& eyes) {
    NpzArrays gaze;
    const Mat3<double> world_from_head = so3_exp(Vec3<double>(pose.head<3>()));
    static constexpr std::array sides{"left", "right"};
    for (std::size_t e = 0; e < 2; ++e) {
        const std::string side = sides[e];
        const CaptureEye& eye = eyes[e];
        const Vec3<double> world = world_from_head * eye.optical;
        gaze["gaze_" + side] = numbers<double>({3}, span_of(eye.optical));
        gaze["gaze_" + side + "_world"] = numbers<double>({3}, span_of(world));
        if (eye.visual) gaze["visual_" + side] = numbers<double>({3}, span_of(*eye.visual));
        if (eye.centre) gaze["eye_center_" + side] = numbers<double>({3}, span_of(*eye.centre));
    }
    const auto of_both = [&](const char* name, std::optional<double> CaptureEye::*length) {
        if (!(eyes[0].*length) || !(eyes[1].*length)) return;
        const std::array<double, 2> both{*(eyes[0].*length), *(eyes[1].*length)};
        gaze[name] = numbers<double>({2}, both);
    };
    of_both("eye_radius", &CaptureEye::radius);
    of_both("limbus_radius", &CaptureEye::limbus_radius);
    of_both("iris_plane", &CaptureEye::iris_plane);
    write_bytes(folder / "gaze.npz", npz_bytes(gaze));
}

/// Writes the files of the head.
void write_head(const fs::path& folder, const ImportHead& head) {
    const auto width = static_cast<Index>(head.expression.size());
    write_bytes(folder / "params.npz",
                npz_bytes({{"exp_coeff", numbers<float>({1, width}, head.expression)},
                           {"pose", numbers<double>({1, 6}, {head.pose.data(), 6})},
                           {"scale", numbers<double>({1, 1}, {&head.scale, 1})}}));
    write_points(folder / "lmk_3d.npy", head.landmarks);
    if (head.vertices.cols() > 0) write_points(folder / "vertices.npy", head.vertices);
    if (head.has_gaze) write_eyes(folder, head.pose, head.eyes);
}

/// Removes a picture of an earlier format: PNG has precedence over JPEG.
void remove_others(const fs::path& folder, const std::string& stem, const fs::path& kept) {
    for (const char* suffix : {".png", ".jpg", ".jpeg"})
        if (const fs::path path = folder / (stem + suffix); path != kept) {
            std::error_code ignored;
            fs::remove(path, ignored);
        }
}

void write_view(const fs::path& images, const fs::path& cameras, const ImportView& view) {
    write_camera(cameras / ("camera_" + view.camera + ".npz"), view.pinhole);
    const auto write = [&](const std::string& kind, const Image8& image) {
        if (image.values.empty()) return;
        const fs::path path = images / (kind + view.camera + ".png");
        write_png(path, image);
        remove_others(images, kind + view.camera, path);
    };
    if (view.copy_of.empty()) {
        write("image_", view.picture);
    } else {
        const Bytes bytes = read_file(view.copy_of);
        const bool png = bytes.size() > 1 && bytes[1] == std::byte{'P'};
        const fs::path path = images / ("image_" + view.camera + (png ? ".png" : ".jpg"));
        write_bytes(path, bytes);
        remove_others(images, "image_" + view.camera, path);
    }
    write("mask_", view.mask);
    write("eye_mask_", view.eyes);
    write("visible_", view.visible);
}

/// Throws an Error with the first key whose values differ.
void require_same_job(const ImportFolder::Json& now, const ImportFolder::Json& before,
                      const std::string& who) {
    for (const auto& [key, value] : now.items())
        require(
            before.contains(key) && before.at(key) == value, who, key, " was ",
            (before.contains(key) ? json_excerpt(before.at(key)) : "absent"),
            " in the import that began this folder, and is ",
            [&v = value] { return json_excerpt(v); }, " now; expected the same, or another --out");
}

void add_lines(std::string& text, const char* label, const std::vector<std::string>& lines) {
    for (std::size_t i = 0; i < lines.size(); ++i) {
        std::string first = i == 0 ? label : "";
        first.resize(10, ' ');
        text += first + lines[i] + "\n";
    }
}

/// Returns true if a folder is empty except for the lock of an import that wrote nothing.
bool is_free(const fs::path& folder) {
    for (const fs::directory_entry& entry : fs::directory_iterator(folder))
        if (entry.path().filename() != "lock") return false;
    return true;
}

} // namespace

std::string ImportSummary::text() const {
    std::string text = "frames    " + std::to_string(frames) + " (" + std::to_string(written) +
                       " written now, " + std::to_string(frames - written) + " complete before), " +
                       std::to_string(cameras) + " cameras\n";
    add_lines(text, "found", found);
    add_lines(text, "derived", derived);
    add_lines(text, "missing", missing);
    return text;
}

ImportRecord parse_import_record(std::string_view text, const std::string& who) {
    using Json = ImportFolder::Json;
    const Json json = parse_checked_json(text, who);
    require(json.is_object() && json.contains("job") && json.at("job").is_object() &&
                json.contains("frames") && json.at("frames").is_object(),
            who, "has no job and frames, expected the record of an import");
    ImportRecord record{json.at("job"), {}};
    for (const auto& [frame, facts] : json.at("frames").items()) {
        const std::string field = who + ": frames." + json_excerpt(Json(frame));
        require(
            facts.is_object(), field, "got ", [&v = facts] { return json_excerpt(v); },
            ", expected an object");
        for (const auto& [key, fact] : facts.items()) {
            const bool flag = key == "gaze";
            require(
                flag ? fact.is_boolean()
                     : fact.is_number() && fact.get<double>() >= 0 && fact.get<double>() < 1e9,
                field + "." + json_excerpt(Json(key)), "got ",
                [&v = fact] { return json_excerpt(v); }, ", expected ",
                (flag ? "true or false" : "a number from 0 to below 1e9"));
        }
        record.frames[frame] = facts;
    }
    return record;
}

ImportFolder::ImportFolder(const fs::path& out, const Json& job) : out_(out), record_{job, {}} {
    require(!out.empty(), "rye import", "--out is missing, expected the folder of the capture");
    const fs::path record = out / "import.json";
    require(!fs::exists(out) || (fs::is_directory(out) && (fs::exists(record) || is_free(out))),
            out.string(),
            "exists already and was not begun by `rye import` (no import.json); expected a new or "
            "empty folder");
    fs::create_directories(out);
    lock_.emplace(out, LockOptions{"rye import"});
    if (fs::exists(record)) {
        ImportRecord before =
            parse_import_record(as_text(read_file(record, max_json_bytes)), record.string());
        require_same_job(job, before.job, record.string());
        record_.frames = std::move(before.frames);
        return;
    }
    save_progress();
}

void ImportFolder::save_progress() const {
    Json frames = Json::object();
    for (const auto& [frame, facts] : record_.frames) frames[frame] = facts;
    const std::string text = checked_text({{"job", record_.job}, {"frames", frames}}, 1);
    write_bytes(out_ / "import.json", as_bytes(text));
}

void ImportFolder::write_views(const ImportFrame& frame) const {
    const fs::path images = out_ / "images" / frame.id, cameras = out_ / "cameras" / frame.id;
    fs::create_directories(images);
    fs::create_directories(cameras);
    program_threads().run(static_cast<Index>(frame.views.size()), [&](Index i) {
        write_view(images, cameras, frame.views[static_cast<std::size_t>(i)]);
    });
}

void ImportFolder::write(const ImportFrame& frame, const Json& facts) {
    write_views(frame);
    if (frame.head) {
        const fs::path params = out_ / "params" / frame.id;
        fs::create_directories(params);
        write_head(params, *frame.head);
    }
    record_.frames[frame.id] = facts;
    save_progress();
}

void ImportFolder::write_eyes(const Capture& capture) const {
    for (const CaptureFrame& f : capture.frames)
        if (f.has_gaze) trainer::write_eyes(out_ / "params" / f.id, f.pose, f.eyes);
}

std::optional<Capture> ImportFolder::read(const Json& train) const {
    std::vector<Problem> problems;
    Capture capture = read_capture(out_, {}, &problems);
    for (const Problem& p : problems)
        if (p.severity == Problem::Severity::error) return std::nullopt;
    capture.train.clear();
    for (int f = 0; f < capture.frame_count(); ++f)
        if (std::find(train.begin(), train.end(), capture.frame(f).id) != train.end())
            capture.train.push_back(f);
    return capture;
}

void ImportFolder::write_file(const std::string& name, const std::string& text) const {
    write_bytes(out_ / name, as_bytes(text));
}

void ImportFolder::finish(Json description, const ImportSummary& summary) {
    description["import"] = {{"kind", record_.job.at("kind")},
                             {"source", record_.job.at("source")},
                             {"found", summary.found},
                             {"derived", summary.derived},
                             {"missing", summary.missing}};
    description["checksums"] = array_checksums(out_);
    const std::string text = checked_text(std::move(description), 1);
    write_bytes(out_ / "capture.json", as_bytes(text));
}

double unit_factor(double landmark_span) {
    constexpr double head = 2.2; // span of an adult's landmarks [dm]
    if (landmark_span > 0.7 && landmark_span < 7) return 1;
    return std::pow(10.0, std::round(std::log10(head / landmark_span)));
}

std::string factor_text(double x) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%.4g", x);
    return digits;
}

ImportFolder::Json import_job(const std::string& kind, const ImportOptions& options) {
    require(!options.source.empty(), "rye import " + kind, "SOURCE is missing");
    require(fs::exists(options.source), options.source.string(), "no such file or folder");
    return {{"kind", kind}, {"source", fs::weakly_canonical(options.source).string()}};
}

fs::path named_file(const ImportOptions& options, const fs::path& folder, const fs::path& name,
                    const std::string& who) {
    const fs::path base = fs::absolute(folder).lexically_normal();
    const fs::path from_base = (base / name).lexically_normal().lexically_relative(base);
    const bool inside = !from_base.empty() && *from_base.begin() != "..";
    require(inside || options.allow_outside, who, "got '", name.string(), "', which is outside ",
            (folder.empty() ? "." : folder.string()),
            ", expected a file in that folder; --allow-outside takes others, too");
    return folder / name;
}

void require_finite_numbers(const std::vector<double>& values, const std::string& who) {
    for (std::size_t i = 0; i < values.size(); ++i)
        require(
            std::isfinite(values[i]), who, "value ", i, " is ",
            [&] { return std::to_string(values[i]); }, ", expected a finite number");
}

} // namespace rye::trainer
