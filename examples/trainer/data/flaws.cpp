// SPDX-License-Identifier: Apache-2.0
#include "data/flaws.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <optional>
#include <set>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/core/format.hpp>

#include "data/capture.hpp"
#include "data/checksums.hpp"
#include "data/flaw_labels.hpp"
#include "data/flaw_pictures.hpp"
#include "data/json_fields.hpp"
#include "data/memory_limit.hpp"
#include "data/threads.hpp"
#include "data/validate.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

/// Kinds of pictures; a longer name comes before one that it ends in.
constexpr std::array picture_kinds{"image_lowres_", "mask_lowres_", "eye_mask_",
                                   "visible_",      "image_",       "mask_"};
/// Records of an import or a flaw about its own folder.
constexpr std::array records{"flaws.json", "import.json", "lock"};

constexpr std::array label_kinds{
    Flaw::gaze_common,       Flaw::gaze_single,   Flaw::centres,    Flaw::expression,
    Flaw::pose_rotation,     Flaw::pose_position, Flaw::landmarks,  Flaw::camera_rotation,
    Flaw::camera_position,   Flaw::focal,         Flaw::soft_masks, Flaw::wrong_masks,
    Flaw::eye_mask_dilation, Flaw::drop_views};

bool is_label(Flaw flaw) {
    return std::find(label_kinds.begin(), label_kinds.end(), flaw) != label_kinds.end();
}

fs::path beside(const fs::path& out, const char* suffix) {
    fs::path path = out.has_filename() ? out : out.parent_path();
    path += suffix;
    return path;
}

/// Returns capture.json, or null if there is none.
Json description_of(const fs::path& folder) {
    const fs::path path = folder / "capture.json";
    return fs::exists(path) ? read_json<Json>(path) : Json();
}

/// Returns a world unit [mm]: unit_mm of capture.json, else a decimetre.
double unit_of(const Json& description, const std::string& who) {
    constexpr double decimetre = 100;
    if (!description.is_object()) return decimetre;
    const double unit = json_number(description, "unit_mm", decimetre, who);
    require(unit > 0, who + ": unit_mm", "got " + number_text(unit) + ", expected > 0");
    return unit;
}

void write_arrays(const fs::path& path, const NpzArrays& arrays) {
    write_atomic(path, npz_bytes(arrays), Durability::atomic_only);
}

/// View of the copy.
struct View {
    std::size_t frame, camera;
};

/// Copy of one capture with errors.
class Flawed {
  public:
    explicit Flawed(const FlawOptions& options);
    FlawReport write();

  private:
    bool has(std::initializer_list<Flaw> flaws) const {
        return std::any_of(flaws.begin(), flaws.end(), [&](Flaw f) { return o_.sizes[f] > 0; });
    }
    const std::string& frame_id(std::size_t f) const { return capture_.frames[f].id; }
    bool labels_of(std::size_t f) const { return label_frames_[f]; }
    bool pictures_of(std::size_t f) const { return picture_frames_[f]; }
    bool leaves_out(std::size_t f, std::size_t c) const {
        return left_out_[f * capture_.camera_ids.size() + c];
    }
    std::vector<bool> chosen(FlawedFrames which) const;
    void require_present() const;
    void choose_views();

    bool flaws_mask(std::size_t f) const {
        return labels_of(f) && has({Flaw::soft_masks, Flaw::wrong_masks});
    }
    bool flaws_picture(std::size_t f) const {
        return (pictures_of(f) && has({Flaw::gain, Flaw::white_balance, Flaw::exposure,
                                       Flaw::vignetting, Flaw::blur, Flaw::noise, Flaw::jpeg})) ||
               (flaws_mask(f) && capture_.images_over_black);
    }
    bool flaws_eye_mask(std::size_t f) const {
        return labels_of(f) && has({Flaw::eye_mask_dilation});
    }
    bool flaws_camera(std::size_t f) const {
        return labels_of(f) && has({Flaw::camera_rotation, Flaw::camera_position, Flaw::focal});
    }
    bool flaws_params(std::size_t f) const {
        return labels_of(f) && has({Flaw::expression, Flaw::pose_rotation, Flaw::pose_position});
    }
    bool flaws_gaze(std::size_t f) const {
        if (!labels_of(f) || !capture_.frames[f].has_gaze) return false;
        const bool turned = has({Flaw::pose_rotation}) && capture_.frames[f].eyes[0].optical_world;
        return turned || has({Flaw::gaze_common, Flaw::gaze_single, Flaw::centres});
    }
    bool flaws_points(std::size_t f) const { return labels_of(f) && has({Flaw::landmarks}); }

    bool copies(const fs::path& file) const;
    bool copies_view(std::size_t f, std::size_t c, const std::string& kind) const;
    void copy_files() const;
    void write_labels(std::size_t f, FlawSums& sums) const;
    void write_view(View v, FlawSums& sums) const;
    void write_picture(View v, const CaptureView& view, const Image8& mask,
                       const std::optional<Image8>& cut, FlawSums& sums) const;
    std::string in_out(std::string message) const;
    void write_description() const;
    void write_record(const FlawReport& report) const;

    const FlawOptions& o_;
    FlawDraws draws_;
    Capture capture_;
    Json description_;
    double unit_mm_;
    fs::path to_; // temporary folder of the copy
    std::map<std::string, std::size_t> frame_index_, camera_index_;
    std::vector<bool> label_frames_, picture_frames_; // by frame
    std::vector<bool> left_out_;                      // views, by frame and camera
    std::vector<CalibrationFlaws> calibrations_;      // by camera
    std::vector<LightFlaws> lights_;                  // by camera
    std::vector<double> exposures_;                   // by frame, factors
    FlawReport report_;
};

/// Rejects an impossible output before the capture is read.
const FlawOptions& checked(const FlawOptions& o) {
    const std::string who = o.out.string();
    require(!o.out.empty(), "--out", "got '', expected a folder to write");
    require(!fs::exists(o.out), "--out", "got '" + who + "', which exists already");
    const fs::path within =
        fs::weakly_canonical(o.out).lexically_relative(fs::weakly_canonical(o.capture));
    require(within.empty() || *within.begin() == "..", "--out",
            "got '" + who + "', which is inside the capture " + o.capture.string());
    const bool flawed = std::any_of(o.sizes.values.begin(), o.sizes.values.end(),
                                    [](double size) { return size > 0; });
    if (!flawed && o.one_camera.empty())
        throw Error("no flaw is asked for, expected one at least, such as --gaze-common 4");
    return o;
}

Flawed::Flawed(const FlawOptions& options)
    : o_(checked(options)),
      draws_{options.seed},
      capture_(read_valid_capture(options.capture)),
      description_(description_of(options.capture)),
      unit_mm_(unit_of(description_, (options.capture / "capture.json").string())),
      to_(beside(options.out, ".tmp")) {
    const std::size_t frames = capture_.frames.size(), cameras = capture_.camera_ids.size();
    for (std::size_t f = 0; f < frames; ++f) frame_index_[frame_id(f)] = f;
    for (std::size_t c = 0; c < cameras; ++c) camera_index_[capture_.camera_ids[c]] = c;
    label_frames_ = chosen(o_.labels);
    picture_frames_ = chosen(o_.pictures);
    require_present();
    choose_views();
    calibrations_.resize(cameras);
    lights_.resize(cameras);
    exposures_.resize(frames, 1);
    for (std::size_t c = 0; c < cameras; ++c) {
        // Each remaining camera counts once.
        FlawSums unseen;
        const bool stays = o_.one_camera.empty() || capture_.camera_ids[c] == o_.one_camera;
        FlawSums& sums = stays ? report_.sums : unseen;
        calibrations_[c] = calibration_flaws(draws_, o_.sizes, unit_mm_, c, sums);
        lights_[c] = light_flaws(draws_, o_.sizes, c, sums);
    }
    for (std::size_t f = 0; f < frames; ++f)
        if (has({Flaw::exposure}) && pictures_of(f))
            exposures_[f] = std::exp(drawn(draws_.of(Flaw::exposure, f), 0,
                                           o_.sizes[Flaw::exposure], report_.sums[Flaw::exposure]) /
                                     100);
}

std::vector<bool> Flawed::chosen(FlawedFrames which) const {
    std::vector<bool> list(capture_.frames.size(), which == FlawedFrames::all);
    for (const int f : capture_.train) list[static_cast<std::size_t>(f)] = true;
    return list;
}

/// Throws an Error if the capture lacks the data that an error is for.
void Flawed::require_present() const {
    const auto option = [&](std::initializer_list<Flaw> flaws) -> std::string {
        for (const Flaw f : flaws)
            if (o_.sizes[f] > 0) return std::string("--") + kind_of(f).name;
        return "";
    };
    if (!o_.one_camera.empty() && !camera_index_.contains(o_.one_camera)) {
        std::string all;
        for (const std::string& name : capture_.camera_ids) all += " " + name;
        throw Error("--one-camera: got '" + o_.one_camera + "', expected one of:" + all);
    }
    for (std::size_t f = 0; f < capture_.frames.size(); ++f) {
        if (!labels_of(f)) continue;
        const std::string file = (capture_.folder / "params" / frame_id(f) / "gaze.npz").string();
        if (has({Flaw::gaze_common, Flaw::gaze_single, Flaw::centres}))
            require(capture_.frames[f].has_gaze,
                    option({Flaw::gaze_common, Flaw::gaze_single, Flaw::centres}),
                    file + ": no such file, but its numbers are to be changed");
        if (has({Flaw::centres}))
            require(capture_.frames[f].has_centres, "--centres",
                    file + ": has no eye_center_left and eye_center_right");
    }
    if (has({Flaw::eye_mask_dilation}))
        require(capture_.has_eye_masks, "--eye-mask-dilation",
                capture_.folder.string() + ": not every view has an eye mask");
}

/// Drops views of cameras other than the chosen one, and a share of those with labels of flawed
/// frames; each frame and each camera keeps its last view.
void Flawed::choose_views() {
    const std::size_t frames = capture_.frames.size(), cameras = capture_.camera_ids.size();
    const double share = o_.sizes[Flaw::drop_views];
    const auto present = [&](std::size_t f, std::size_t c) {
        return capture_.views[f * cameras + c].present &&
               (o_.one_camera.empty() || capture_.camera_ids[c] == o_.one_camera);
    };
    const auto chance = [&](std::size_t f, std::size_t c) {
        return draws_.of(Flaw::drop_views, f, c).uniform(0);
    };
    left_out_.resize(frames * cameras);
    for (std::size_t f = 0; f < frames; ++f)
        for (std::size_t c = 0; c < cameras; ++c)
            left_out_[f * cameras + c] = !present(f, c) || (labels_of(f) && chance(f, c) < share);
    const auto keep_one = [&](const std::vector<View>& list) {
        const View* last = nullptr;
        for (const View& v : list) {
            if (!leaves_out(v.frame, v.camera)) return;
            if (present(v.frame, v.camera) &&
                (last == nullptr || chance(v.frame, v.camera) > chance(last->frame, last->camera)))
                last = &v;
        }
        if (last != nullptr) left_out_[last->frame * cameras + last->camera] = false;
    };
    for (std::size_t f = 0; f < frames; ++f) {
        std::vector<View> list;
        for (std::size_t c = 0; c < cameras; ++c) list.push_back({f, c});
        keep_one(list);
        require(std::any_of(list.begin(), list.end(),
                            [&](const View& v) { return present(v.frame, v.camera); }),
                "--one-camera",
                "got '" + o_.one_camera + "', which has no image of frame '" + frame_id(f) + "'");
    }
    for (std::size_t c = 0; c < cameras; ++c) {
        std::vector<View> list;
        for (std::size_t f = 0; f < frames; ++f) list.push_back({f, c});
        keep_one(list);
    }
    for (std::size_t f = 0; f < frames; ++f)
        for (std::size_t c = 0; c < cameras; ++c) {
            if (!capture_.views[f * cameras + c].present) continue;
            ++(leaves_out(f, c) ? report_.views_left_out : report_.views);
            if (present(f, c) && leaves_out(f, c)) ++report_.sums[Flaw::drop_views].count;
        }
}

/// Returns the camera in a file's name, after the kind that begins it; empty if it has none.
std::string camera_of(const fs::path& folder, const std::string& stem, std::string& kind) {
    if (folder == "cameras" && stem.starts_with("camera_")) kind = "camera_";
    if (folder == "images")
        for (const char* known : picture_kinds)
            if (kind.empty() && stem.starts_with(known)) kind = known;
    return kind.empty() ? "" : stem.substr(kind.size());
}

/// Returns true if the copy has a file of a view unchanged.
bool Flawed::copies_view(std::size_t f, std::size_t c, const std::string& kind) const {
    if (leaves_out(f, c)) return false;
    if (kind == "camera_") return !flaws_camera(f);
    if (kind == "image_") return !flaws_picture(f);
    if (kind == "mask_") return !flaws_mask(f);
    if (kind == "eye_mask_") return !flaws_eye_mask(f);
    // Half-size pictures would not match the others.
    return kind == "visible_" || (!flaws_picture(f) && !flaws_mask(f));
}

/// Returns true if the copy has a file, by its path in the capture, unchanged.
bool Flawed::copies(const fs::path& file) const {
    const std::vector<fs::path> parts(file.begin(), file.end());
    if (parts.size() == 1)
        return std::find(records.begin(), records.end(), file.string()) == records.end();
    if (parts.size() != 3) return true;
    std::string kind;
    const std::string camera = camera_of(parts[0], parts[2].stem().string(), kind);
    if (!kind.empty() && !o_.one_camera.empty() && camera != o_.one_camera) return false;
    const auto frame = frame_index_.find(parts[1].string());
    if (frame == frame_index_.end()) return true;
    const std::size_t f = frame->second;
    if (!kind.empty()) {
        const auto c = camera_index_.find(camera);
        return c == camera_index_.end() || copies_view(f, c->second, kind);
    }
    const std::string name = parts[2].string();
    if (parts[0] != "params") return true;
    if (name == "params.npz") return !flaws_params(f);
    if (name == "gaze.npz") return !flaws_gaze(f);
    return (name != "lmk_3d.npy" && name != "vertices.npy") || !flaws_points(f);
}

void Flawed::copy_files() const {
    std::vector<fs::path> files;
    for (const auto& entry : fs::recursive_directory_iterator(
             o_.capture, fs::directory_options::follow_directory_symlink))
        if (entry.is_regular_file()) files.push_back(entry.path().lexically_relative(o_.capture));
    std::sort(files.begin(), files.end());
    for (const char* folder : {"images", "cameras", "params"})
        for (const CaptureFrame& frame : capture_.frames)
            fs::create_directories(to_ / folder / frame.id);
    for (const fs::path& file : files) {
        if (!copies(file)) continue;
        fs::create_directories((to_ / file).parent_path());
        fs::copy_file(o_.capture / file, to_ / file);
    }
}

void Flawed::write_labels(std::size_t f, FlawSums& sums) const {
    const fs::path from = o_.capture / "params" / frame_id(f), to = to_ / "params" / frame_id(f);
    const LabelFlaws flaws{draws_, o_.sizes, o_.expression_share, unit_mm_, f};
    Vec3<double> rotation = capture_.frames[f].pose.head<3>();
    if (flaws_params(f)) {
        const std::string who = (from / "params.npz").string();
        NpzArrays arrays = read_npz(from / "params.npz", memory_limit());
        flaw_params(arrays, flaws, who, sums);
        rotation = Vec3<double>(arrays.at("pose").values<double>(who).data());
        write_arrays(to / "params.npz", arrays);
    }
    if (flaws_gaze(f)) {
        NpzArrays arrays = read_npz(from / "gaze.npz", memory_limit());
        flaw_gaze(arrays, rotation, flaws, (from / "gaze.npz").string(), sums);
        write_arrays(to / "gaze.npz", arrays);
    }
    if (!flaws_points(f)) return;
    std::size_t list = 0;
    for (const char* name : {"lmk_3d.npy", "vertices.npy"}) {
        ++list;
        if (!fs::exists(from / name)) continue;
        NpyArray points = read_npy(from / name);
        flaw_points(points, list, flaws, (from / name).string(), sums);
        write_atomic(to / name, npy_bytes(points), Durability::atomic_only);
    }
}

void Flawed::write_view(View v, FlawSums& sums) const {
    const std::string& camera = capture_.camera_ids[v.camera];
    const CaptureView& view = capture_.view(static_cast<int>(v.frame), static_cast<int>(v.camera));
    const fs::path images = to_ / "images" / frame_id(v.frame);
    if (flaws_camera(v.frame)) {
        const fs::path file =
            fs::path("cameras") / frame_id(v.frame) / ("camera_" + camera + ".npz");
        NpzArrays arrays = read_npz(o_.capture / file, memory_limit());
        flaw_camera(arrays, calibrations_[v.camera], (o_.capture / file).string());
        write_arrays(to_ / file, arrays);
    }
    if (flaws_eye_mask(v.frame))
        write_png(images / ("eye_mask_" + camera + ".png"),
                  dilated(read_image8(view.eye_mask, 1), o_.sizes[Flaw::eye_mask_dilation], sums));
    if (!flaws_mask(v.frame) && !flaws_picture(v.frame)) return;
    const Image8 mask = read_image8(view.mask, 1);
    std::optional<Image8> cut;
    if (flaws_mask(v.frame)) {
        cut = mask;
        if (has({Flaw::wrong_masks}))
            cut = displaced(*cut, o_.sizes[Flaw::wrong_masks],
                            draws_.of(Flaw::wrong_masks, v.frame, v.camera), sums);
        if (has({Flaw::soft_masks})) cut = softened(*cut, o_.sizes[Flaw::soft_masks], sums);
        write_png(images / ("mask_" + camera + ".png"), *cut);
    }
    if (flaws_picture(v.frame)) write_picture(v, view, mask, cut, sums);
}

void Flawed::write_picture(View v, const CaptureView& view, const Image8& mask,
                           const std::optional<Image8>& cut, FlawSums& sums) const {
    const Image8 before = read_image8(view.image, 3);
    const bool flawed = pictures_of(v.frame), over_black = capture_.images_over_black;
    LightFlaws light = flawed ? lights_[v.camera] : LightFlaws{};
    light.gains *= exposures_[v.frame];
    const FlawedPicture picture{&before, over_black ? &mask : nullptr,
                                over_black && cut ? &*cut : nullptr};
    const Image8 after =
        flawed_picture(picture, light, draws_.of(Flaw::noise, v.frame, v.camera), sums);
    const fs::path to =
        to_ / "images" / frame_id(v.frame) / ("image_" + capture_.camera_ids[v.camera]);
    if (!flawed || !has({Flaw::jpeg})) {
        write_png(to.string() + ".png", after);
        return;
    }
    const fs::path file = to.string() + ".jpg";
    write_jpeg(file, after, static_cast<int>(o_.sizes[Flaw::jpeg]));
    const Image8 back = read_image8(file, 3);
    for (std::size_t i = 0; i < back.values.size(); ++i)
        sums[Flaw::jpeg].add(double(back.values[i]) - double(after.values[i]));
}

/// Returns a message about the unfinished copy with the requested name.
std::string Flawed::in_out(std::string message) const {
    const std::string unfinished = to_.string();
    for (std::size_t at = 0; (at = message.find(unfinished, at)) != std::string::npos;)
        message.replace(at, unfinished.size(), o_.out.string());
    return message;
}

/// Replaces capture.json if cameras or checksums of arrays have changed.
void Flawed::write_description() const {
    if (!description_.is_object()) return;
    Json now = description_;
    if (!o_.one_camera.empty()) {
        if (now.contains("camera_ids")) now["camera_ids"] = {o_.one_camera};
        if (now.contains("cameras") && now["cameras"].is_array()) {
            Json kept = Json::array();
            for (const Json& camera : now["cameras"])
                if (!camera.is_object() || !camera.contains("id") || camera["id"] == o_.one_camera)
                    kept.push_back(camera);
            now["cameras"] = kept;
        }
    }
    if (has({Flaw::landmarks}) && now.contains("checksums"))
        now["checksums"] = array_checksums(to_);
    if (now == description_) return;
    const std::string text = now.contains("checksum") ? checked_text(now, 1) : now.dump(1) + "\n";
    write_atomic(to_ / "capture.json", as_bytes(text), Durability::atomic_only);
}

void Flawed::write_record(const FlawReport& report) const {
    const auto name = [](FlawedFrames which) {
        return which == FlawedFrames::all ? "all" : "train";
    };
    Json flaws = Json::object();
    for (std::size_t i = 0; i < flaw_count; ++i) {
        const double size = o_.sizes.values[i];
        const FlawSum& sum = report.sums.values[i];
        if (!(size > 0)) continue;
        Json entry{{"size", size}, {"unit", flaw_kinds[i].unit}};
        if (flaw_kinds[i].rms_unit != nullptr) {
            entry["rms"] = sum.rms();
            entry["rms_unit"] = flaw_kinds[i].rms_unit;
        }
        entry["count"] = sum.count;
        entry["frames"] = name(is_label(static_cast<Flaw>(i)) ? o_.labels : o_.pictures);
        if (static_cast<Flaw>(i) == Flaw::expression) entry["share"] = o_.expression_share;
        flaws[flaw_kinds[i].name] = entry;
    }
    if (!o_.one_camera.empty()) flaws["one-camera"] = {{"camera", o_.one_camera}};
    Json record{{"seed", o_.seed},
                {"unit_mm", unit_mm_},
                {"views", report.views},
                {"views_left_out", report.views_left_out},
                {"flaws", flaws}};
    if (const fs::path before = o_.capture / "flaws.json"; fs::exists(before))
        record["before"] = read_json<Json>(before);
    const std::string text = checked_text(record, 1);
    write_atomic(to_ / "flaws.json", as_bytes(text), Durability::atomic_only);
}

FlawReport Flawed::write() {
    fs::remove_all(to_);
    try {
        copy_files();
        std::vector<View> views;
        for (std::size_t f = 0; f < capture_.frames.size(); ++f)
            for (std::size_t c = 0; c < capture_.camera_ids.size(); ++c)
                if (!leaves_out(f, c)) views.push_back({f, c});
        const std::size_t frames = capture_.frames.size();
        std::vector<FlawSums> sums(frames + views.size());
        program_threads().run(static_cast<Index>(sums.size()), [&](Index k) {
            const auto i = static_cast<std::size_t>(k);
            if (i < frames)
                write_labels(i, sums[i]);
            else
                write_view(views[i - frames], sums[i]);
        });
        for (const FlawSums& some : sums)
            for (std::size_t i = 0; i < flaw_count; ++i) report_.sums.values[i].add(some.values[i]);
        report_.label_frames =
            static_cast<int>(std::count(label_frames_.begin(), label_frames_.end(), true));
        report_.picture_frames =
            static_cast<int>(std::count(picture_frames_.begin(), picture_frames_.end(), true));
        write_description();
        write_record(report_);
        std::vector<Problem> problems;
        const Capture copy = read_capture(to_, {}, &problems);
        const std::vector<Problem> more = validate(copy);
        problems.insert(problems.end(), more.begin(), more.end());
        const Verdict verdict = judge(copy, problems);
        for (const Problem& p : problems)
            if (p.severity == Problem::Severity::error)
                throw Error("flaws of this size make the copy unusable: " + in_out(p.message));
        report_.verdict = verdict.text();
        fs::rename(to_, o_.out);
    } catch (...) {
        std::error_code ignored;
        fs::remove_all(to_, ignored);
        throw;
    }
    return report_;
}

} // namespace

std::string FlawReport::text(const FlawOptions& options) const {
    std::string all;
    for (std::size_t i = 0; i < flaw_count; ++i) {
        if (!(options.sizes.values[i] > 0)) continue;
        const FlawKind& kind = flaw_kinds[i];
        const FlawSum& sum = sums.values[i];
        char line[160];
        if (kind.rms_unit != nullptr)
            std::snprintf(line, sizeof line, "%-18s %.4g %s; rms %.4g %s of %lld numbers\n",
                          kind.name, options.sizes.values[i], kind.unit, sum.rms(), kind.rms_unit,
                          static_cast<long long>(sum.count));
        else
            std::snprintf(
                line, sizeof line, "%-18s %.4g %s; %lld %s\n", kind.name, options.sizes.values[i],
                kind.unit, static_cast<long long>(sum.count),
                static_cast<Flaw>(i) == Flaw::drop_views ? "views left out" : "pixels added");
        all += line;
    }
    return all;
}

FlawReport write_flawed(const FlawOptions& options) { return Flawed(options).write(); }

} // namespace rye::trainer
