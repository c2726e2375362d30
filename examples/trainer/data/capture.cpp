// SPDX-License-Identifier: Apache-2.0
#include "data/capture.hpp"

#include <algorithm>
#include <cmath>
#include <set>
#include <span>

#include <rye/capture/npy.hpp>
#include <rye/capture/npz.hpp>
#include <rye/core/error.hpp>
#include <rye/math/linalg.hpp>

#include "data/json.hpp"
#include "data/memory_limit.hpp"
#include "data/srgb.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

/// Destination of faults: a list, or else an exception.
class Faults {
  public:
    explicit Faults(std::vector<Problem>* list) : list_(list) {}

    void error(const std::string& message) {
        if (!list_) throw Error(message);
        list_->push_back({Problem::Severity::error, message});
    }
    void warning(const std::string& message) {
        if (list_) list_->push_back({Problem::Severity::warning, message});
    }
    /// Returns true if f() did not throw an Error.
    template <class F>
    bool attempt(F&& f) {
        try {
            f();
            return true;
        } catch (const Error& e) {
            error(e.what());
        } catch (const fs::filesystem_error& e) {
            error(e.path1().string() + ": " + e.code().message());
        }
        return false;
    }

  private:
    std::vector<Problem>* list_;
};

// ---- arrays ------------------------------------------------------------------------------------

void require_finite(std::span<const double> values, const std::string& who) {
    for (std::size_t i = 0; i < values.size(); ++i)
        if (!std::isfinite(values[i]))
            throw Error(who + ": value " + std::to_string(i) + " is " + std::to_string(values[i]) +
                        ", expected a finite number");
}

/// Returns the finite values of one array, whose count must be one of `counts` (any count if
/// empty).
std::vector<double> numbers(const NpyArray& array, const std::string& who,
                            std::initializer_list<Index> counts) {
    const Index* end = counts.end();
    if (counts.size() > 0 && std::find(counts.begin(), end, array.size()) == end) {
        std::string expected;
        for (const Index n : counts)
            expected += (expected.empty() ? "" : " or ") + std::to_string(n);
        throw Error(who + ": got shape " + shape_text(array.shape) + ", expected " + expected +
                    " numbers");
    }
    std::vector<double> values = array.values<double>(who);
    require_finite(values, who);
    return values;
}

/// Arrays of an npz and its file name.
struct Archive {
    explicit Archive(const fs::path& file) : path(file), arrays(read_npz(file, memory_limit())) {}

    std::string label(const std::string& name) const { return path.string() + ": " + name; }
    bool has(const std::string& name) const { return arrays.count(name) != 0; }
    std::vector<double> get(const std::string& name, std::initializer_list<Index> counts) const {
        const auto found = arrays.find(name);
        require(found != arrays.end(), label(name), "is missing from the file");
        return numbers(found->second, label(name), counts);
    }
    /// Returns a matrix stored row-major.
    template <int Rows, int Cols>
    Mat<double, Rows, Cols> matrix(const std::string& name) const {
        const std::vector<double> v = get(name, {Rows * Cols});
        require_shape(name, {Rows, Cols});
        using RowMajor = Eigen::Matrix<double, Rows, Cols, Eigen::RowMajor>;
        return Eigen::Map<const RowMajor>(v.data());
    }
    void require_shape(const std::string& name, const std::vector<Index>& shape) const {
        const std::vector<Index>& got = arrays.at(name).shape;
        require(
            got == shape, label(name), "got shape ", [&] { return shape_text(got); }, ", expected ",
            [&] { return shape_text(shape); });
    }

    fs::path path;
    NpzArrays arrays;
};

/// Returns points (N, 3) as 3 x N.
Columns<double> read_points(const fs::path& path) {
    const NpyArray array = read_npy(path);
    require(
        array.shape.size() == 2 && array.shape[1] == 3, path.string(), "got shape ",
        [&] { return shape_text(array.shape); }, ", expected (N, 3)");
    const std::vector<double> v = numbers(array, path.string(), {});
    return Eigen::Map<const Columns<double>>(v.data(), 3, array.shape[0]);
}

// ---- one frame ---------------------------------------------------------------------------------

void read_gaze(const fs::path& path, CaptureFrame& frame) {
    const Archive file(path);
    static constexpr std::array<const char*, 2> sides{"left", "right"};
    for (std::size_t e = 0; e < 2; ++e) {
        CaptureEye& eye = frame.eyes[e];
        const std::string side = sides[e];
        const auto vector = [&](const std::string& name) -> std::optional<Vec3<double>> {
            if (!file.has(name)) return std::nullopt;
            return Vec3<double>(file.get(name, {3}).data());
        };
        const auto of_both = [&](const std::string& name) -> std::optional<double> {
            if (!file.has(name)) return std::nullopt;
            const double length = file.get(name, {2})[e];
            require(
                length > 0, file.label(name), "got ", [&] { return std::to_string(length); },
                " for the ", side, " eye, expected > 0");
            return length;
        };
        eye.optical = Vec3<double>(file.get("gaze_" + side, {3}).data());
        eye.optical_world = vector("gaze_" + side + "_world");
        eye.visual = vector("visual_" + side);
        eye.centre = vector("eye_center_" + side);
        if (file.has("kappa_" + side))
            eye.kappa = Vec2<double>(file.get("kappa_" + side, {2}).data());
        eye.radius = of_both("eye_radius");
        eye.limbus_radius = of_both("limbus_radius");
        eye.iris_plane = of_both("iris_plane");
    }
    frame.has_gaze = true;
    frame.has_centres = frame.eyes[0].centre.has_value() && frame.eyes[1].centre.has_value();
}

CaptureFrame read_frame(const fs::path& folder, const std::string& id) {
    const fs::path params = folder / "params" / id;
    CaptureFrame frame;
    frame.id = id;
    const Archive file(params / "params.npz");
    const std::vector<double> pose = file.get("pose", {6});
    frame.pose = Eigen::Map<const Vec<double, 6>>(pose.data());
    if (file.has("scale")) frame.scale = file.get("scale", {1})[0];
    require(
        frame.scale > 0, file.label("scale"), "got ", [&] { return std::to_string(frame.scale); },
        ", expected > 0");
    for (const double weight : file.get("exp_coeff", {}))
        frame.expression.push_back(static_cast<float>(weight));
    frame.landmarks =
        common_landmarks(read_points(params / "lmk_3d.npy"), (params / "lmk_3d.npy").string());
    frame.vertices.resize(3, 0);
    if (fs::exists(params / "vertices.npy")) frame.vertices = read_points(params / "vertices.npy");
    if (fs::exists(params / "gaze.npz")) read_gaze(params / "gaze.npz", frame);
    return frame;
}

// ---- one view ----------------------------------------------------------------------------------

Pinhole<double> read_camera(const fs::path& path) {
    const Archive file(path);
    const Mat3<double> k = file.matrix<3, 3>("intrinsic");
    const std::string label = file.label("intrinsic");
    require(
        k(0, 0) > 0 && k(1, 1) > 0, label, "got focal lengths ",
        [&] { return std::to_string(k(0, 0)); }, " and ", [&] { return std::to_string(k(1, 1)); },
        ", expected > 0");
    require(
        std::abs(k(0, 1)) <= 1e-6 * k(0, 0), label, "got skew ",
        [&] { return std::to_string(k(0, 1)); }, ", expected 0");
    require(k(1, 0) == 0 && k(2, 0) == 0 && k(2, 1) == 0 && std::abs(k(2, 2) - 1) < 1e-9, label,
            "its rows are not (fx 0 cx), (0 fy cy), (0 0 1)");
    if (file.has("distortion"))
        for (const double x : file.get("distortion", {}))
            require(
                x == 0, file.label("distortion"), "got a coefficient of ",
                [&] { return std::to_string(x); },
                ", expected 0: captures are pinhole images, undistort them first");
    Pinhole<double> camera;
    camera.fx = k(0, 0);
    camera.fy = k(1, 1);
    camera.cx = k(0, 2);
    camera.cy = k(1, 2);

    // World to camera; a last row (0 0 0 1) is optional.
    const std::vector<double> m = file.get("extrinsic", {12, 16});
    file.require_shape("extrinsic", {m.size() == 12 ? 3 : 4, 4});
    const Mat<double, 3, 4> extrinsic =
        Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(m.data());
    const Mat3<double> r = extrinsic.leftCols<3>();
    const double skewed = (r * r.transpose() - Mat3<double>::Identity()).cwiseAbs().maxCoeff();
    require(skewed < 1e-3, file.label("extrinsic"),
            "its 3 x 3 part is no rotation: R R^T differs from the identity by ",
            [&] { return std::to_string(skewed); });
    const Vec3<double> x = r.row(0), y = r.row(1), z = r.row(2);
    require(cross(x, y).dot(z) > 0, file.label("extrinsic"),
            "its 3 x 3 part has determinant -1: the camera is mirrored (one axis negated)");
    camera.camera_from_world.rotation = r;
    camera.camera_from_world.translation = extrinsic.col(3);
    return camera;
}

/// Returns the first existing file of stem.jpg, stem.jpeg, stem.png; else an empty path.
fs::path find_image(const fs::path& folder, const std::string& stem) {
    for (const char* suffix : {".png", ".jpg", ".jpeg"})
        if (fs::path path = folder / (stem + suffix); fs::exists(path)) return path;
    return {};
}

std::string size_text(int width, int height) {
    return std::to_string(width) + " x " + std::to_string(height);
}

void require_size(const fs::path& path, int width, int height) {
    if (path.empty()) return;
    const ImageHeader h = read_image_header(path);
    require(
        h.width == width && h.height == height, path.string(), "got ",
        [&] { return size_text(h.width, h.height); }, " pixels, expected ",
        [&] { return size_text(width, height); }, " as the first image has");
}

/// Reads the files of one camera in one frame; the first image sets the capture's size.
void read_view(Capture& c, const std::string& frame, const std::string& camera, CaptureView& view,
               Faults& faults) {
    const fs::path images = c.folder / "images" / frame;
    const fs::path camera_file = c.folder / "cameras" / frame / ("camera_" + camera + ".npz");
    view.image = find_image(images, "image_" + camera);
    view.mask = find_image(images, "mask_" + camera);
    view.eye_mask = find_image(images, "eye_mask_" + camera);
    view.visible = find_image(images, "visible_" + camera);
    if (view.image.empty() && view.mask.empty() && !fs::exists(camera_file)) {
        faults.warning(images.string() + ": camera " + camera + " missed this frame");
        return;
    }
    const auto missing = [](const fs::path& path, const char* suffixes) {
        return path.string() + suffixes + ": no such file";
    };
    if (view.image.empty()) faults.error(missing(images / ("image_" + camera), ".jpg or .png"));
    if (view.mask.empty())
        faults.error(missing(images / ("mask_" + camera), ".png or .jpg") +
                     ", expected the subject's mask, as matting programs make it");
    bool whole = !view.image.empty() && !view.mask.empty();
    whole &= faults.attempt([&] { view.camera = read_camera(camera_file); });
    if (!view.image.empty())
        whole &= faults.attempt([&] {
            const ImageHeader h = read_image_header(view.image);
            if (c.width == 0) {
                c.width = h.width;
                c.height = h.height;
            }
        });
    for (const fs::path* path : {&view.image, &view.mask, &view.eye_mask, &view.visible})
        if (whole) whole &= faults.attempt([&] { require_size(*path, c.width, c.height); });
    view.camera.width = c.width;
    view.camera.height = c.height;
    view.present = whole;
}

// ---- the whole ---------------------------------------------------------------------------------

std::vector<std::string> sorted(const std::set<std::string>& names) {
    return {names.begin(), names.end()};
}

std::set<std::string> list_frames(const fs::path& folder) {
    const fs::path images = folder / "images";
    require(fs::is_directory(images), images.string(),
            "no such folder, expected it to hold one folder of images per frame");
    std::set<std::string> names;
    for (const fs::directory_entry& entry : fs::directory_iterator(images))
        if (entry.is_directory()) names.insert(entry.path().filename().string());
    require(!names.empty(), images.string(), "has no folders, expected one per frame");
    return names;
}

std::set<std::string> list_cameras(const fs::path& folder, const std::set<std::string>& frames) {
    std::set<std::string> ids;
    for (const std::string& frame : frames)
        for (const fs::directory_entry& entry : fs::directory_iterator(folder / "images" / frame)) {
            const std::string stem = entry.path().stem().string();
            if (stem.starts_with("image_") && !stem.starts_with("image_lowres_"))
                ids.insert(stem.substr(6));
        }
    require(!ids.empty(), (folder / "images").string(), "has no files named image_<camera>.jpg");
    return ids;
}

/// Returns capture.json, or null if there is none.
Json read_description(const fs::path& path) {
    if (!fs::exists(path)) return nullptr;
    Json json = read_json(path);
    require(json.is_object(), path.string(), "expected an object");
    return json;
}

/// Returns a list of strings; empty if the key is absent.
std::vector<std::string> strings(const Json& json, const char* key, const std::string& who) {
    std::vector<std::string> out;
    if (!json.is_object() || !json.contains(key)) return out;
    require(json.at(key).is_array(), who + ": " + key, "expected a list of names");
    std::set<std::string> seen;
    for (const Json& item : json.at(key)) {
        require(
            item.is_string(), who + ": " + key, "got ", [&] { return item.dump(); },
            ", expected a name");
        out.push_back(item.get<std::string>());
        // Names become path components.
        require(!out.back().empty() && out.back().find_first_of("/\\") == std::string::npos &&
                    out.back() != "..",
                who + ": " + key, "got '", out.back(), "', expected a name without slashes");
        require(seen.insert(out.back()).second, who + ": " + key, "names '", out.back(), "' twice");
    }
    return out;
}

std::string string_of(const Json& json, const char* key) {
    if (!json.is_object() || !json.contains(key) || !json.at(key).is_string()) return {};
    return json.at(key).get<std::string>();
}

struct Splits {
    std::vector<std::string> train, test, novel_gaze, independent_gaze;
};

Splits described_splits(const Json& json, const std::string& who) {
    Splits s{strings(json, "train_frames", who), strings(json, "test_frames", who),
             strings(json, "novel_gaze_test_frames", who),
             strings(json, "independent_gaze_test_frames", who)};
    const std::set<std::string> train(s.train.begin(), s.train.end());
    for (const auto* list : {&s.test, &s.novel_gaze, &s.independent_gaze})
        for (const std::string& id : *list)
            require(!train.contains(id), who, "frame '", id,
                    "' is in train_frames and in a list of test frames");
    require(!s.train.empty(), who, "train_frames is empty, expected at least one frame");
    return s;
}

/// Assigns the last frames to the tests, at least one of two or more.
Splits default_splits(const std::vector<std::string>& ids, double test_fraction) {
    require(
        test_fraction >= 0 && test_fraction < 1, "test_fraction", "got ",
        [&] { return std::to_string(test_fraction); }, ", expected 0 to below 1");
    const auto n = static_cast<double>(ids.size());
    auto tests = static_cast<std::ptrdiff_t>(std::lround(n * test_fraction));
    if (test_fraction > 0 && ids.size() > 1) tests = std::max<std::ptrdiff_t>(tests, 1);
    tests = std::min(tests, static_cast<std::ptrdiff_t>(ids.size()) - 1);
    return {{ids.begin(), ids.end() - tests}, {ids.end() - tests, ids.end()}, {}, {}};
}

/// Returns the indices of the frames that were read.
std::vector<int> indices(const Capture& c, const std::vector<std::string>& ids) {
    std::vector<int> out;
    for (const std::string& id : ids)
        for (int i = 0; i < c.frame_count(); ++i)
            if (c.frames[static_cast<std::size_t>(i)].id == id) out.push_back(i);
    return out;
}

void require_one_width(const Capture& c, Faults& faults) {
    for (const CaptureFrame& f : c.frames) {
        const fs::path params = c.folder / "params" / f.id;
        const CaptureFrame& first = c.frames.front();
        const auto compare = [&](const char* file, const char* what, Index got, Index expected) {
            if (got != expected)
                faults.error((params / file).string() + ": " + what + ": got " +
                             std::to_string(got) + ", expected " + std::to_string(expected) +
                             " as in frame " + first.id);
        };
        compare("params.npz", "length of exp_coeff", static_cast<Index>(f.expression.size()),
                static_cast<Index>(first.expression.size()));
        compare("vertices.npy", "number of vertices", f.vertices.cols(), first.vertices.cols());
    }
    const std::size_t names = c.expression_names.size();
    if (names != 0 && !c.frames.empty() && names != c.frames.front().expression.size())
        faults.error((c.folder / "capture.json").string() + ": exp_names: got " +
                     std::to_string(names) + " names, expected one for each of the " +
                     std::to_string(c.frames.front().expression.size()) + " exp_coeff");
}

CaptureContents list_contents(const fs::path& folder, const CaptureOptions& options,
                              Faults& faults) {
    CaptureContents c;
    c.folder = folder;
    const fs::path description = folder / "capture.json";
    const std::string who = description.string();
    require(fs::is_directory(folder), folder.string(), "no such folder");
    require(fs::exists(folder / "cameras") || !fs::exists(folder / "transforms.json"),
            (folder / "transforms.json").string(),
            "a folder of photographs, expected a capture (folders images, cameras, params)");
    const Json json = read_description(description);
    c.subject = string_of(json, "subject");
    c.expression_names = strings(json, "exp_names", who);
    const Json conventions =
        json.is_object() && json.contains("conventions") ? json.at("conventions") : Json();
    const std::string image = string_of(conventions, "image");
    c.images_over_black = options.content == ImageContent::automatic
                              ? image.find("over black") != std::string::npos
                              : options.content == ImageContent::over_black;
    if (json.is_object() && json.contains("image_size"))
        c.image_size = json.at("image_size").dump();

    const std::set<std::string> on_disk = list_frames(folder);
    c.camera_ids = strings(json, "camera_ids", who);
    if (c.camera_ids.empty()) c.camera_ids = sorted(list_cameras(folder, on_disk));
    const bool described = json.is_object() && json.contains("train_frames");
    const Splits splits = described ? described_splits(json, who)
                                    : default_splits(sorted(on_disk), options.test_fraction);
    c.train = splits.train;
    c.test = splits.test;
    c.novel_gaze = splits.novel_gaze;
    c.independent_gaze = splits.independent_gaze;
    std::set<std::string> wanted;
    for (const auto* list : {&c.train, &c.test, &c.novel_gaze, &c.independent_gaze})
        wanted.insert(list->begin(), list->end());
    for (const std::string& id : on_disk)
        if (!wanted.contains(id))
            faults.warning(who + ": frame '" + id + "' is in no list and is left out");
    c.frames = sorted(wanted);
    return c;
}

/// Adds a frame and its views; returns false, with the fault, if it cannot be used.
bool add_frame(Capture& c, const std::string& id, bool needs_a_view, Faults& faults) {
    const fs::path images = c.folder / "images" / id;
    if (!fs::is_directory(images)) {
        faults.error(images.string() + ": no such folder, but capture.json names the frame");
        return false;
    }
    CaptureFrame frame;
    if (!faults.attempt([&] { frame = read_frame(c.folder, id); })) return false;
    std::vector<CaptureView> views(c.camera_ids.size());
    for (std::size_t i = 0; i < views.size(); ++i)
        read_view(c, id, c.camera_ids[i], views[i], faults);
    const bool seen =
        std::any_of(views.begin(), views.end(), [](const CaptureView& v) { return v.present; });
    if (needs_a_view && !seen) {
        faults.error(images.string() + ": no camera has this frame whole");
        return false;
    }
    c.frames.push_back(std::move(frame));
    c.views.insert(c.views.end(), views.begin(), views.end());
    return true;
}

/// Copies the contents to the capture, before any frame is read.
void begin(Capture& c, const CaptureContents& contents) {
    c.subject = contents.subject;
    c.camera_ids = contents.camera_ids;
    c.expression_names = contents.expression_names;
    c.images_over_black = contents.images_over_black;
}

/// Completes the capture after the frames are read.
void finish(Capture& c, const CaptureContents& contents, Faults& faults) {
    c.has_eye_masks =
        !c.views.empty() && std::all_of(c.views.begin(), c.views.end(), [](const CaptureView& v) {
            return !v.present || !v.eye_mask.empty();
        });
    c.train = indices(c, contents.train);
    c.test = indices(c, contents.test);
    c.novel_gaze = indices(c, contents.novel_gaze);
    c.independent_gaze = indices(c, contents.independent_gaze);
    require_one_width(c, faults);
    if (!contents.image_size.empty() && c.width > 0 &&
        Json::parse(contents.image_size) != Json({c.width, c.height}))
        faults.error((c.folder / "capture.json").string() + ": image_size: got " +
                     contents.image_size + ", but the images have " +
                     size_text(c.width, c.height) + " pixels");
}

void read_everything(Capture& c, const CaptureOptions& options, Faults& faults) {
    const CaptureContents contents = list_contents(c.folder, options, faults);
    begin(c, contents);
    require(fs::is_directory(c.folder / "params"), (c.folder / "params").string(),
            "no such folder, expected the head's pose, expression and landmarks of each frame: "
            "track the head with VHAP, and `rye import vhap TRACKED --out CAPTURE` makes them");
    for (const std::string& id : contents.frames) add_frame(c, id, true, faults);
    for (int k = 0; k < c.camera_count() && c.frame_count() > 0; ++k) {
        int f = 0;
        while (f < c.frame_count() && !c.view(f, k).present) ++f;
        if (f == c.frame_count())
            faults.error((c.folder / "images").string() + ": camera " +
                         c.camera_ids[static_cast<std::size_t>(k)] + " has no whole frame");
    }
    if (indices(c, contents.train).empty())
        faults.error(c.folder.string() + ": no training frame could be read");
    finish(c, contents, faults);
}

} // namespace

Pinhole<double> read_capture_camera(const fs::path& path) { return read_camera(path); }

Columns<double> common_landmarks(const Columns<double>& all, const std::string& who) {
    if (all.cols() == 66) return all;
    require(all.cols() == 68, who, "got ", all.cols(), " landmarks, expected 66 or 68");
    Columns<double> kept(3, 66);
    kept << all.leftCols(48), all.middleCols(49, 5), all.rightCols(13);
    return kept;
}

const Image8& ImageCache::get(const fs::path& path, int channels) {
    const std::string key = std::to_string(channels) + ":" + path.string();
    if (const auto found = by_key_.find(key); found != by_key_.end()) {
        entries_.splice(entries_.begin(), entries_, found->second);
        return entries_.front().image;
    }
    entries_.push_front({key, read_image8(path, channels)});
    by_key_[key] = entries_.begin();
    bytes_ += entries_.front().image.values.size();
    while (bytes_ > budget_ && entries_.size() > 1) {
        bytes_ -= entries_.back().image.values.size();
        by_key_.erase(entries_.back().key);
        entries_.pop_back();
    }
    return entries_.front().image;
}

bool Capture::has_gaze() const {
    return std::all_of(frames.begin(), frames.end(), [](const auto& f) { return f.has_gaze; });
}

bool Capture::has_centres() const {
    return std::all_of(frames.begin(), frames.end(), [](const auto& f) { return f.has_centres; });
}

const CaptureView& Capture::view(int frame, int camera) const {
    RYE_ASSERT(frame >= 0 && frame < frame_count() && camera >= 0 && camera < camera_count(),
               "Capture::view: frame or camera out of range");
    return views[static_cast<std::size_t>(frame) * camera_ids.size() +
                 static_cast<std::size_t>(camera)];
}

namespace {

const CaptureView& present_view(const Capture& c, int frame, int camera) {
    const CaptureView& v = c.view(frame, camera);
    require(v.present, c.folder.string(), "camera ", c.camera_ids[static_cast<std::size_t>(camera)],
            " has no frame ", c.frames[static_cast<std::size_t>(frame)].id);
    return v;
}

} // namespace

namespace {

/// Divides a picture of 8 bits by a camera's gains, in linear light.
void take_out(const Vec3<double>& gains, Image<float>& rgb) {
    std::array<std::array<float, 256>, 3> table{};
    for (std::size_t c = 0; c < 3; ++c)
        for (std::size_t v = 0; v < 256; ++v)
            table[c][v] = static_cast<float>(std::min(
                1.0, srgb(linear(static_cast<double>(v) / 255) / gains[static_cast<Index>(c)])));
    for (Index i = 0; i < rgb.pixels.size(); ++i) {
        float& x = rgb.pixels.data()[i];
        x = table[static_cast<std::size_t>(i % 3)][static_cast<std::size_t>(
            std::lround(255.0F * x))];
    }
}

} // namespace

Image<float> Capture::image(int frame, int camera) const {
    const CaptureView& v = present_view(*this, frame, camera);
    Image<float> rgb = to_float(cache.get(v.image, 3));
    if (!camera_gains.empty())
        take_out(camera_gains[static_cast<std::size_t>(camera)], rgb);
    if (!images_over_black) {
        const Image<float> alpha = mask(frame, camera);
        rgb.pixels.array().rowwise() *= alpha.pixels.row(0).array();
    }
    return rgb;
}

Image<float> Capture::mask(int frame, int camera) const {
    return to_float(cache.get(present_view(*this, frame, camera).mask, 1));
}

Image<float> Capture::visible(int frame, int camera) const {
    const CaptureView& v = present_view(*this, frame, camera);
    if (v.visible.empty()) return Image<float>(width, height, 1, 1.0f);
    return to_float(cache.get(v.visible, 1));
}

Image<float> Capture::eye_mask(int frame, int camera) const {
    const CaptureView& v = present_view(*this, frame, camera);
    Image<float> eyes(width, height, 2);
    if (v.eye_mask.empty()) return eyes;
    const Image8& labels = cache.get(v.eye_mask, 1);
    for (std::size_t i = 0; i < labels.values.size(); ++i) {
        const int value = labels.values[i];
        if (value % 85 != 0)
            throw Error(v.eye_mask.string() + ": got the value " + std::to_string(value) +
                        ", expected 0 (none), 85 (left), 170 (right) or 255 (reserved)");
        if (value == 85 || value == 170) eyes.pixels(value / 85 - 1, static_cast<Index>(i)) = 1;
    }
    return eyes;
}

CaptureContents read_contents(const fs::path& folder, const CaptureOptions& options) {
    CaptureContents contents;
    Faults faults(nullptr);
    faults.attempt([&] { contents = list_contents(folder, options, faults); });
    return contents;
}

Capture read_capture_frame(const CaptureContents& contents, const std::string& frame,
                           const std::vector<std::string>& cameras, const CaptureOptions& options,
                           std::vector<Problem>* problems) {
    Capture c;
    c.folder = contents.folder;
    c.cache = ImageCache(options.cache_bytes);
    Faults faults(problems);
    faults.attempt([&] {
        begin(c, contents);
        c.camera_ids = cameras;
        if (add_frame(c, frame, false, faults)) finish(c, contents, faults);
    });
    return c;
}

Capture read_capture(const fs::path& folder, const CaptureOptions& options,
                     std::vector<Problem>* problems) {
    Capture c;
    c.folder = folder;
    c.cache = ImageCache(options.cache_bytes);
    Faults faults(problems);
    faults.attempt([&] { read_everything(c, options, faults); });
    return c;
}

} // namespace rye::trainer
