// SPDX-License-Identifier: Apache-2.0
/// rye/io/read_capture.hpp: reads a capture from its folder: all but the pixels, which the
/// caller's reader of pictures decodes on demand.
///     const auto capture = read_capture("capture", PngFiles{});
///     const Image<float> image = capture.image(0, 0);
/// Source: docs/capture_format.md.
#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <rye/io/capture.hpp>
#include <rye/io/capture_contents.hpp>
#include <rye/io/capture_frame.hpp>
#include <rye/io/json.hpp>

namespace rye {

/// One frame of a capture and some of its cameras.
struct FrameOfCameras {
    std::string frame;
    std::vector<std::string> cameras;
};

namespace detail {

/// Returns the header of a picture, or throws an Error.
using PictureHeader = std::function<ImageHeader(const std::filesystem::path&)>;

/// Reads frames into labels, whose contents are set.
class LabelsReader {
  public:
    LabelsReader(CaptureLabels& labels, PictureHeader header, Faults& faults)
        : labels_(labels), header_(std::move(header)), faults_(faults) {}

    /// Lists and reads everything.
    void read_all(const CaptureOptions& options) {
        const CaptureContents contents = list_contents(labels_.folder, options, faults_);
        begin(contents);
        const std::filesystem::path params = labels_.folder / "params";
        require(std::filesystem::is_directory(params), params.string(),
                "no such folder, expected the head's pose, expression and landmarks of each frame: "
                "track the head with VHAP, and `rye import vhap TRACKED --out CAPTURE` makes them");
        for (const std::string& id : contents.frames) add_frame(id, true);
        require_seen_cameras();
        if (indices(contents.train).empty())
            faults_.error(labels_.folder.string() + ": no training frame could be read");
        finish(contents);
    }
    /// Reads one frame, all of whose views may be absent.
    void read_one(const CaptureContents& contents, const FrameOfCameras& which) {
        begin(contents);
        labels_.camera_ids = which.cameras;
        if (add_frame(which.frame, false)) finish(contents);
    }

  private:
    /// Copies the contents, before any frame is read.
    void begin(const CaptureContents& contents) {
        memory_ = contents.options.memory;
        labels_.subject = contents.subject;
        labels_.camera_ids = contents.camera_ids;
        labels_.expression_names = contents.expression_names;
        labels_.images_over_black = contents.images_over_black;
    }
    /// Completes the labels after the frames are read.
    void finish(const CaptureContents& contents) {
        const std::vector<CaptureView>& views = labels_.views;
        labels_.has_eye_masks = !views.empty() &&
                                std::all_of(views.begin(), views.end(), [](const CaptureView& v) {
                                    return !v.present || !v.eye_mask.empty();
                                });
        labels_.train = indices(contents.train);
        labels_.test = indices(contents.test);
        labels_.novel_gaze = indices(contents.novel_gaze);
        labels_.independent_gaze = indices(contents.independent_gaze);
        require_one_width();
        if (!contents.image_size.empty() && labels_.width > 0 && !states_size(contents.image_size))
            faults_.error((labels_.folder / "capture.json").string() + ": image_size: got " +
                          contents.image_size + ", but the images have " +
                          size_text(labels_.width, labels_.height) + " pixels");
    }

    /// Adds a frame and its views; false, with the fault, if it cannot be used.
    bool add_frame(const std::string& id, bool needs_a_view) {
        const std::filesystem::path images = labels_.folder / "images" / id;
        if (!std::filesystem::is_directory(images)) {
            faults_.error(images.string() + ": no such folder, but capture.json names the frame");
            return false;
        }
        CaptureFrame frame;
        const std::filesystem::path params = labels_.folder / "params" / id;
        if (!faults_.attempt([&] { frame = read_capture_labels(params, id, memory_); }))
            return false;
        std::vector<CaptureView> views;
        for (const std::string& camera : labels_.camera_ids) views.push_back(read_view(id, camera));
        const bool seen =
            std::any_of(views.begin(), views.end(), [](const CaptureView& v) { return v.present; });
        if (needs_a_view && !seen) {
            faults_.error(images.string() + ": no camera has this frame whole");
            return false;
        }
        labels_.frames.push_back(std::move(frame));
        labels_.views.insert(labels_.views.end(), views.begin(), views.end());
        return true;
    }

    /// Reads the files of one camera in one frame; the first image sets the capture's size.
    CaptureView read_view(const std::string& frame, const std::string& camera) {
        const std::filesystem::path images = labels_.folder / "images" / frame;
        const std::filesystem::path camera_file =
            labels_.folder / "cameras" / frame / ("camera_" + camera + ".npz");
        CaptureView view;
        view.image = find_image(images, "image_" + camera);
        view.mask = find_image(images, "mask_" + camera);
        view.eye_mask = find_image(images, "eye_mask_" + camera);
        view.visible = find_image(images, "visible_" + camera);
        if (view.image.empty() && view.mask.empty() && !std::filesystem::exists(camera_file)) {
            faults_.warning(images.string() + ": camera " + camera + " missed this frame");
            return view;
        }
        const auto missing = [&](const std::string& stem, const char* suffixes) {
            return (images / (stem + camera)).string() + suffixes + ": no such file";
        };
        if (view.image.empty()) faults_.error(missing("image_", ".jpg or .png"));
        if (view.mask.empty())
            faults_.error(missing("mask_", ".png or .jpg") +
                          ", expected the subject's mask, as matting programs make it");
        bool whole = !view.image.empty() && !view.mask.empty();
        whole &= faults_.attempt([&] { view.camera = read_view_camera(camera_file, memory_); });
        if (!view.image.empty()) whole &= faults_.attempt([&] { take_size(view.image); });
        for (const std::filesystem::path* path :
             {&view.image, &view.mask, &view.eye_mask, &view.visible})
            if (whole && !path->empty()) whole &= faults_.attempt([&] { require_size(*path); });
        view.camera.width = labels_.width;
        view.camera.height = labels_.height;
        view.present = whole;
        return view;
    }
    /// Returns the first existing file of stem.png, stem.jpg, stem.jpeg; else an empty path.
    static std::filesystem::path find_image(const std::filesystem::path& folder,
                                            const std::string& stem) {
        for (const char* suffix : {".png", ".jpg", ".jpeg"})
            if (auto path = folder / (stem + suffix); std::filesystem::exists(path)) return path;
        return {};
    }
    void take_size(const std::filesystem::path& image) {
        const ImageHeader h = header_(image);
        if (labels_.width != 0) return;
        labels_.width = h.width;
        labels_.height = h.height;
    }
    void require_size(const std::filesystem::path& path) const {
        const ImageHeader h = header_(path);
        require(
            h.width == labels_.width && h.height == labels_.height, path.string(), "got ",
            [&] { return size_text(h.width, h.height); }, " pixels, expected ",
            [&] { return size_text(labels_.width, labels_.height); }, " as the first image has");
    }
    static std::string size_text(int width, int height) {
        return std::to_string(width) + " x " + std::to_string(height);
    }

    /// Returns the indices of the frames that were read.
    std::vector<int> indices(const std::vector<std::string>& ids) const {
        std::vector<int> out;
        for (const std::string& id : ids)
            for (int i = 0; i < labels_.frame_count(); ++i)
                if (labels_.frame(i).id == id) out.push_back(i);
        return out;
    }
    void require_seen_cameras() {
        for (int k = 0; k < labels_.camera_count() && labels_.frame_count() > 0; ++k) {
            int f = 0;
            while (f < labels_.frame_count() && !labels_.view(f, k).present) ++f;
            if (f == labels_.frame_count())
                faults_.error((labels_.folder / "images").string() + ": camera " +
                              labels_.camera_ids[static_cast<std::size_t>(k)] +
                              " has no whole frame");
        }
    }
    void require_one_width() {
        for (const CaptureFrame& f : labels_.frames) {
            const std::filesystem::path params = labels_.folder / "params" / f.id;
            const CaptureFrame& first = labels_.frames.front();
            const auto compare = [&](const char* file, const char* what, Index got,
                                     Index expected) {
                if (got != expected)
                    faults_.error((params / file).string() + ": " + what + ": got " +
                                  std::to_string(got) + ", expected " + std::to_string(expected) +
                                  " as in frame " + first.id);
            };
            compare("params.npz", "length of exp_coeff", static_cast<Index>(f.expression.size()),
                    static_cast<Index>(first.expression.size()));
            compare("vertices.npy", "number of vertices", f.vertices.cols(),
                    first.vertices.cols());
        }
        const std::size_t names = labels_.expression_names.size();
        if (names != 0 && !labels_.frames.empty() &&
            names != labels_.frames.front().expression.size())
            faults_.error((labels_.folder / "capture.json").string() + ": exp_names: got " +
                          std::to_string(names) + " names, expected one for each of the " +
                          std::to_string(labels_.frames.front().expression.size()) + " exp_coeff");
    }
    /// Returns whether a JSON text is the list of the images' width and height.
    bool states_size(const std::string& text) const {
        const JsonValue value = parse_json(text, "image_size");
        const auto* sides = value.get<JsonArray>();
        const auto is = [&](std::size_t i, int side) {
            const auto* whole = (*sides)[i].get<std::int64_t>();
            const auto* real = (*sides)[i].get<double>();
            return (whole != nullptr && *whole == side) || (real != nullptr && *real == side);
        };
        return sides != nullptr && sides->size() == 2 && is(0, labels_.width) &&
               is(1, labels_.height);
    }

    CaptureLabels& labels_;
    PictureHeader header_;
    Faults& faults_;
    std::uint64_t memory_ = default_memory; // of one file's arrays [bytes]
};

template <PictureReader P>
PictureHeader header_by(P& pictures) {
    return [&pictures](const std::filesystem::path& path) -> ImageHeader {
        return pictures.header(path);
    };
}

} // namespace detail

/// Reads one frame for these cameras, without pixels; opens no file of another frame or camera. All
/// of its views may be absent. Faults as in read_capture.
template <PictureReader P>
CaptureOf<P> read_capture_frame(const CaptureContents& contents, const FrameOfCameras& which,
                                P pictures, std::vector<Problem>* problems = nullptr) {
    CaptureLabels labels;
    labels.folder = contents.folder;
    Faults faults(problems);
    detail::LabelsReader reader(labels, detail::header_by(pictures), faults);
    faults.attempt([&] { reader.read_one(contents, which); });
    return {std::move(labels), std::move(pictures)};
}

/// Reads everything except the pixels. Without `problems` throws the first fault as an Error;
/// otherwise adds every fault to the list and returns the rest.
template <PictureReader P>
CaptureOf<P> read_capture(const std::filesystem::path& folder, P pictures,
                          const CaptureOptions& options = {},
                          std::vector<Problem>* problems = nullptr) {
    CaptureLabels labels;
    labels.folder = folder;
    Faults faults(problems);
    detail::LabelsReader reader(labels, detail::header_by(pictures), faults);
    faults.attempt([&] { reader.read_all(options); });
    return {std::move(labels), std::move(pictures)};
}

} // namespace rye
