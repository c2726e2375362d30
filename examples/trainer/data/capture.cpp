// SPDX-License-Identifier: Apache-2.0
#include "data/capture.hpp"

#include <rye/capture/read_capture.hpp>

#include "data/memory_limit.hpp"

namespace rye::trainer {
namespace {

/// Returns the options with the program's limit on memory.
CaptureOptions limited(CaptureOptions options) {
    options.memory = memory_limit();
    return options;
}

} // namespace

const Image8& ImageCache::read(const std::filesystem::path& path, int channels) {
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

CaptureContents read_contents(const std::filesystem::path& folder, CaptureOptions options) {
    return capture_contents(folder, limited(options));
}

Capture read_capture_frame(const CaptureContents& contents, const std::string& frame,
                           const std::vector<std::string>& cameras,
                           std::vector<Problem>* problems) {
    return rye::read_capture_frame(contents, {frame, cameras}, ImageCache(), problems);
}

Pinhole<double> read_capture_camera(const std::filesystem::path& path) {
    return read_view_camera(path, memory_limit());
}

Capture read_capture(const std::filesystem::path& folder, CaptureOptions options,
                     std::vector<Problem>* problems) {
    return rye::read_capture(folder, ImageCache(), limited(options), problems);
}

} // namespace rye::trainer
