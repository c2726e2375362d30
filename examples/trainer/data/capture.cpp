// SPDX-License-Identifier: Apache-2.0
#include "data/capture.hpp"

#include <list>
#include <map>
#include <mutex>

#include <rye/io/read_capture.hpp>

#include "data/memory_limit.hpp"

namespace rye::trainer {
namespace {

/// Returns the options with the program's limit on memory.
CaptureOptions limited(CaptureOptions options) {
    options.memory = memory_limit();
    return options;
}

} // namespace

struct ImageCache::State {
    struct Entry {
        std::string key;
        std::shared_ptr<const Image8> image;
    };

    std::shared_ptr<const Image8> cached(const std::string& key) {
        const auto found = by_key.find(key);
        if (found == by_key.end()) return nullptr;
        entries.splice(entries.begin(), entries, found->second);
        return entries.front().image;
    }
    void keep(const std::string& key, const std::shared_ptr<const Image8>& image) {
        entries.push_front({key, image});
        by_key[key] = entries.begin();
        bytes += image->values.size();
        while (bytes > budget && entries.size() > 1) {
            bytes -= entries.back().image->values.size();
            by_key.erase(entries.back().key);
            entries.pop_back();
        }
    }

    std::size_t budget, bytes = 0;
    std::list<Entry> entries{}; // most recently used first
    std::map<std::string, std::list<Entry>::iterator> by_key{};
    std::mutex mutex{};
};

ImageCache::ImageCache(std::size_t budget) : state_(new State{budget}) {}
ImageCache::ImageCache(ImageCache&&) noexcept = default;
ImageCache& ImageCache::operator=(ImageCache&&) noexcept = default;
ImageCache::~ImageCache() = default;

CachedImage ImageCache::read(const std::filesystem::path& path, int channels) {
    const std::string key = std::to_string(channels) + ":" + path.string();
    {
        const std::lock_guard<std::mutex> lock(state_->mutex);
        if (auto image = state_->cached(key)) return CachedImage(std::move(image));
    }
    // Without the lock; two threads that want the same image at once both decode it.
    auto decoded = std::make_shared<const Image8>(read_image8(path, channels));
    const std::lock_guard<std::mutex> lock(state_->mutex);
    if (auto image = state_->cached(key)) return CachedImage(std::move(image));
    state_->keep(key, decoded);
    return CachedImage(std::move(decoded));
}

std::size_t ImageCache::bytes() const {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    return state_->bytes;
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
