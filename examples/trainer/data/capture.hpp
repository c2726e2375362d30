// SPDX-License-Identifier: Apache-2.0
/// data/capture.hpp: captures with the program's pictures: PNG and JPEG, decoded images cached, and
/// its limit on memory. What a capture is, and how it is read, is in rye/io/capture.hpp and
/// rye/io/read_capture.hpp.
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <rye/io/capture.hpp>

#include "data/picture.hpp"

namespace rye::trainer {

using rye::CaptureContents;
using rye::CaptureEye;
using rye::CaptureFrame;
using rye::CaptureOptions;
using rye::CaptureView;
using rye::CorrectedCamera;
using rye::eye_landmarks;
using rye::ImageContent;
using rye::Problem;

/// Image of a cache, which stays while it is held.
class CachedImage {
  public:
    explicit CachedImage(std::shared_ptr<const Image8> image) : image_(std::move(image)) {}
    operator const Image8&() const { return *image_; }

  private:
    std::shared_ptr<const Image8> image_;
};

/// Cache of decoded 8-bit images that evicts the least recently used first; a PictureReader that
/// several threads may use.
class ImageCache {
  public:
    explicit ImageCache(std::size_t budget = std::size_t(1) << 30U);
    ImageCache(ImageCache&&) noexcept;
    ImageCache& operator=(ImageCache&&) noexcept;
    ~ImageCache();

    ImageHeader header(const std::filesystem::path& path) const { return read_image_header(path); }
    /// Returns the image of `path` in `channels`, read unless cached.
    CachedImage read(const std::filesystem::path& path, int channels);
    /// Returns the bytes of the images that are cached.
    std::size_t bytes() const;

  private:
    struct State;
    std::unique_ptr<State> state_;
};

/// Capture whose images are decoded on demand and cached. Several threads may read it.
using Capture = CaptureOf<ImageCache>;

/// Throws an Error if capture.json or the folder is not that of a capture.
CaptureContents read_contents(const std::filesystem::path& folder, CaptureOptions options = {});

/// Reads one frame for these cameras, without pixels; opens no file of another frame or camera. All
/// of its views may be absent. Faults as in read_capture.
Capture read_capture_frame(const CaptureContents& contents, const std::string& frame,
                           const std::vector<std::string>& cameras,
                           std::vector<Problem>* problems = nullptr);

/// Reads a camera_<name>.npz; its size is not in it. Throws an Error that names file and field.
Pinhole<double> read_capture_camera(const std::filesystem::path& path);

/// Reads everything except the pixels. Without `problems` throws the first fault as an Error;
/// otherwise adds every fault to the list and returns the rest.
Capture read_capture(const std::filesystem::path& folder, CaptureOptions options = {},
                     std::vector<Problem>* problems = nullptr);

} // namespace rye::trainer
