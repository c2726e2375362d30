// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/views.hpp: pictures of a training: all of them once, as bytes, in device memory
/// or, beyond a bound, in the host's (train/cuda/view_ring.hpp); those of a step as floats, on the
/// final background, at full size and at the render's, as in train/samples.hpp. The view that a
/// step shows is read on the device.
#pragma once

#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <rye/backend/cuda/each.hpp>
#include <rye/backend/cuda/picture.hpp>
#include <rye/train/cuda/steps.hpp>
#include <rye/train/cuda/view_ring.hpp>

namespace rye {

namespace detail {

/// Arrays of a view in device memory.
struct DeviceViewPlace {
    const std::uint8_t *rgb, *mask, *visible, *eyes;
    const float* drivers; ///< packed by DriverPlaces
};

/// Pictures of a step in floats; full size: W x H; small: the render's size.
struct DeviceStepPictures {
    float *truth, *visible, *eyes;                                ///< 3, 1 and 1 per pixel
    float *truth_small, *visible_small, *eyes_small, *mask_small; ///< 3, 1, 1 and 1 per pixel
};

/// Writes pixel i of the render, and the factor x factor pixels of the picture that it covers.
struct StepPicturesAt {
    static constexpr const char* name = "pictures of a step";
    const DeviceViewPlace* view; ///< in device memory
    DeviceStepPictures to;
    int width;  ///< width of the picture [px]
    int factor; ///< picture size over render size

    RYE_DEVICE void operator()(Index i) const {
        const DeviceViewPlace from = *view;
        const int across = width / factor;
        const int x0 = static_cast<int>(i % across) * factor,
                  y0 = static_cast<int>(i / across) * factor;
        float truth[3] = {0, 0, 0}, visible = 0, eyes = 0, mask = 0;
        for (int y = y0; y < y0 + factor; ++y)
            for (int x = x0; x < x0 + factor; ++x) {
                const Index at = Index(y) * width + x;
                const float inside = unit_value(from.mask[at]), seen = unit_value(from.visible[at]),
                            eye = unit_value(from.eyes[at]);
                for (int c = 0; c < 3; ++c) { // on white
                    const float v = unit_value(from.rgb[3 * at + c]) + (1.0F - inside);
                    to.truth[3 * at + c] = v;
                    truth[c] += v;
                }
                to.visible[at] = seen;
                to.eyes[at] = eye;
                visible += seen;
                eyes += eye;
                mask += inside;
            }
        const float count = static_cast<float>(factor * factor);
        for (int c = 0; c < 3; ++c) to.truth_small[3 * i + c] = truth[c] / count;
        to.visible_small[i] = visible / count;
        to.eyes_small[i] = eyes / count;
        to.mask_small[i] = mask / count;
    }
};

} // namespace detail

/// Views of a training, and the pictures of the current step.
template <class Device>
class DeviceViews {
  public:
    /// factor: picture size over render size.
    DeviceViews(const Device& device, int factor)
        : device_(device),
          factor_(factor),
          ring_(std::make_unique<ViewRing<Device>>(device)) {
        require(factor >= 1, "DeviceViews", "factor is ", factor, ", expected 1 or more");
    }

    /// Keeps so many views in device memory, and further ones in page-locked memory of the host,
    /// which must outlive them. To be called before the first view.
    void keep_beyond(Index on_device, const DeviceArena& host) {
        most_ = on_device;
        host_ = std::make_unique<DeviceArena>(host);
    }

    /// Adds a view and its frame's drivers (packed by DriverPlaces); returns its number; waits.
    /// Throws an Error for arrays of another size, sides that the factor does not divide, and a
    /// size that differs from the first view's.
    Index add(const CudaQueue& queue, const TrainingView& view, const std::vector<float>& drivers) {
        check(view);
        const std::size_t pixels = view.mask.size(), floats = drivers.size() * sizeof(float);
        const std::size_t bytes = floats + 6 * pixels;
        const bool on_host = host_ != nullptr && count() >= most_;
        auto& own = *kept_.emplace_back(std::make_unique<DeviceBuffer<std::uint8_t>>());
        if (on_host) {
            own.reserve({queue.stream, *host_, queue.idle}, bytes);
            if (ring_->bytes() == 0) ring_->reserve(queue, bytes);
            bytes_on_host_ += bytes;
        } else {
            own.reserve(queue, bytes);
        }
        std::uint8_t* at = own.data();
        const auto put = [&](const void* from, std::size_t n) {
            if (on_host && !queue.idle)
                std::memcpy(at, from, n);
            else
                device_.send(queue, at, from, n);
            at += n;
        };
        put(drivers.data(), floats); // first, to be aligned
        put(view.rgb.data(), 3 * pixels);
        put(view.mask.data(), pixels);
        put(view.visible.data(), pixels);
        put(view.eyes.data(), pixels);
        drivers_ = floats;
        on_host_.push_back(on_host);
        cameras_.push_back(view.camera);
        return count() - 1;
    }

    /// Moves all views of another object of the same factor to this one, which must be empty. The
    /// other keeps the memory of its step's pictures.
    void take(DeviceViews& from) {
        RYE_ASSERT(count() == 0 && factor_ == from.factor_, "DeviceViews: cannot take the views");
        kept_ = std::exchange(from.kept_, {});
        on_host_ = std::exchange(from.on_host_, {});
        cameras_ = std::exchange(from.cameras_, {});
        host_ = std::exchange(from.host_, {});
        std::swap(ring_, from.ring_);
        most_ = from.most_;
        bytes_on_host_ = std::exchange(from.bytes_on_host_, 0);
        drivers_ = from.drivers_;
        width_ = from.width_;
        height_ = from.height_;
        from.sent_ = 0;
    }

    Index count() const { return static_cast<Index>(kept_.size()); }
    /// Returns true if a view is in the host's memory.
    bool on_host(Index view) const { return on_host_[static_cast<std::size_t>(view)]; }
    /// Returns the entry of places() for the j-th view of a run that comes from the host's memory.
    Index entry_of_fetched(Index j) const { return count() + j % ViewRing<Device>::places; }
    /// Begins to fetch views from the host's memory, in this order from number `first` on; see
    /// ViewRing.
    void fetch(const CudaQueue& queue, const std::vector<Index>& order, Index first) {
        std::vector<const std::uint8_t*> from;
        for (const Index v : order) from.push_back(kept_[static_cast<std::size_t>(v)]->data());
        ring_->begin(queue, from, first);
    }
    ViewRing<Device>& ring() { return *ring_; }
    int factor() const { return factor_; }
    int width() const { return width_; }   ///< width of the pictures [px]
    int height() const { return height_; } ///< height of the pictures [px]
    Index pixels() const { return Index(width_) * height_; }
    Index small_pixels() const { return pixels() / (Index(factor_) * factor_); }
    const Pinhole<float>& camera(Index view) const {
        return cameras_[static_cast<std::size_t>(view)];
    }

    /// Returns the numbers of a view's camera that kernels are launched with.
    std::vector<float> camera_numbers(Index view) const {
        const Pinhole<float>& c = camera(view);
        std::vector<float> numbers{c.fx, c.fy, c.cx, c.cy, c.near_depth};
        const Rigid<float>& pose = c.camera_from_world;
        numbers.insert(numbers.end(), pose.rotation.data(), pose.rotation.data() + 9);
        numbers.insert(numbers.end(), pose.translation.data(), pose.translation.data() + 3);
        return numbers;
    }

    /// Returns the views' arrays, in device memory, and behind them those of fetched views; waits
    /// if views were added since the last call. Entries of views on the host are not to be read.
    const detail::DeviceViewPlace* places(const CudaQueue& queue) {
        if (sent_ != kept_.size()) {
            std::vector<detail::DeviceViewPlace> all;
            for (const auto& k : kept_) all.push_back(place_at(k->data()));
            if (ring_->bytes() > 0)
                for (Index k = 0; k < ViewRing<Device>::places; ++k)
                    all.push_back(place_at(ring_->place(k)));
            table_.reserve(queue, all.size());
            device_.send(queue, table_.data(), all.data(),
                         all.size() * sizeof(detail::DeviceViewPlace));
            sent_ = kept_.size();
        }
        return table_.data();
    }

    /// Enqueues the float pictures of a view, whose arrays are read on the device.
    const detail::DeviceStepPictures& into(const CudaQueue& queue,
                                           const detail::DeviceViewPlace* view) {
        const std::size_t full = static_cast<std::size_t>(pixels()),
                          small = static_cast<std::size_t>(small_pixels());
        floats_.reserve(queue, 5 * full + 6 * small + 1);
        float* at = floats_.data();
        const auto take = [&](std::size_t n) {
            at += n;
            return at - n;
        };
        pictures_ = {take(3 * full), take(full),  take(full), take(3 * small),
                     take(small),    take(small), take(small)};
        launch_each(device_, queue, small_pixels(),
                    detail::StepPicturesAt{view, pictures_, width_, factor_});
        return pictures_;
    }

    /// Returns the memory of resident pictures [bytes].
    std::size_t resident_bytes() const {
        std::size_t sum = table_.bytes() + ring_->bytes();
        for (const auto& k : kept_) sum += k->bytes();
        return sum - bytes_on_host_;
    }
    /// Returns the page-locked memory of the host that views hold [bytes].
    std::size_t bytes_on_host() const { return bytes_on_host_; }
    /// Returns the memory of resident pictures and of a step's [bytes].
    std::size_t bytes() const { return resident_bytes() + floats_.bytes(); }

  private:
    /// Returns where a view's arrays are in its memory.
    detail::DeviceViewPlace place_at(const std::uint8_t* memory) const {
        const auto n = static_cast<std::size_t>(pixels());
        const std::uint8_t* const rgb = memory + drivers_;
        return {rgb, rgb + 3 * n, rgb + 4 * n, rgb + 5 * n, reinterpret_cast<const float*>(memory)};
    }
    void check(const TrainingView& v) {
        const char* const who = "DeviceViews";
        const std::string number = "view " + std::to_string(count());
        const auto side = [&](const char* name, int got, int first) {
            require(got > 0 && got % factor_ == 0, who, number, ": ", name, " is ", got,
                    ", expected a positive multiple of ", factor_);
            require(count() == 0 || got == first, who, number, ": ", name, " is ", got,
                    ", expected the first view's, ", first);
        };
        side("width", v.width, width_);
        side("height", v.height, height_);
        const std::size_t pixels =
            static_cast<std::size_t>(v.width) * static_cast<std::size_t>(v.height);
        const auto sized = [&](const char* name, std::size_t got, std::size_t want) {
            require(got == want, who, number, ": ", name, " has ", got, " bytes, expected ", want);
        };
        sized("rgb", v.rgb.size(), 3 * pixels);
        sized("mask", v.mask.size(), pixels);
        sized("visible", v.visible.size(), pixels);
        sized("eyes", v.eyes.size(), pixels);
        require(v.camera.width * factor_ == v.width && v.camera.height * factor_ == v.height, who,
                number, ": its camera has ", v.camera.width, " x ", v.camera.height,
                " pixels, expected ", v.width / factor_, " x ", v.height / factor_);
        width_ = v.width;
        height_ = v.height;
    }

    Device device_;
    int factor_, width_ = 0, height_ = 0;
    std::vector<std::unique_ptr<DeviceBuffer<std::uint8_t>>> kept_;
    std::vector<bool> on_host_;
    std::vector<Pinhole<float>> cameras_;
    std::unique_ptr<DeviceArena> host_; ///< page-locked memory; null: all views are on the device
    Index most_ = 0;                             ///< views on the device, if host_ is set
    std::size_t bytes_on_host_ = 0, drivers_ = 0; ///< [bytes]; drivers of a view
    std::unique_ptr<ViewRing<Device>> ring_;
    DeviceBuffer<detail::DeviceViewPlace> table_;
    std::size_t sent_ = 0;
    DeviceBuffer<float> floats_;
    detail::DeviceStepPictures pictures_{};
};

} // namespace rye
