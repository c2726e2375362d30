// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/drawer.hpp: pictures of an avatar, driven, drawn and super-resolved on a device.
///     DeviceAvatarDrawer<E, CudaDevice> drawer(device, queue, {avatar, config, roles});
///     drawer.drive(queue, drivers);
///     const Image<float> picture = drawer.picture(queue, camera_of_the_render);
/// or, for a renderer with a picture in device memory, where nothing waits but set_drivers and
/// finish:
///     drawer.set_drivers(queue, drivers);
///     do { drawer.drive_into(queue); drawer.draw_into(queue, camera, picture); }
///     while (!drawer.finish(queue));
/// For both eyes of a viewer it is driven once and drawn twice, as views 0 and 1. A viewer that
/// draws again and again has each kind of frame as a graph, where the device has graphs:
///     do drawer.frame_into(queue, drivers, views);
///     while (!drawer.finish(queue));
/// The same build gives the same bits for a frame, whatever was drawn before.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <rye/avatar/cuda/frame_words.hpp>
#include <rye/avatar/cuda/two_stream.hpp>
#include <rye/backend/cuda/graphs.hpp>
#include <rye/core/columns.hpp>
#include <rye/nn/cuda/upsampler.hpp>
#include <rye/splat/cuda/rasterizer.hpp>

namespace rye {

/// How a drawer computes: planes and widths of networks' products, numbers of channels that renders
/// have kernels for, the rules of renders. By default of three planes, for pictures that agree with
/// the host's in float; one is faster, and off by what bf16 is.
template <class Networks_ = DeviceNetworks<3>, class Channels_ = KernelChannels<3, 32>,
          DeviceAccuracy A = Balanced, int upsampler_planes_ = 3>
struct DeviceDrawingPolicy {
    using Networks = Networks_;
    using Channels = Channels_;
    using Accuracy = FeaturesOnly<A>;
    static constexpr int upsampler_planes = upsampler_planes_;
};

namespace detail {

/// Features that say which eye a Gaussian is of: 2 a Gaussian, (1, 0) of the left eye's, (0, 1) of
/// the right one's, 0 of the face's.
struct EyesAsFeatures {
    static constexpr const char* name = "eyes as features";
    float* to; ///< 2 x all Gaussians
    Index face, left;

    RYE_DEVICE void operator()(Index i) const {
        to[2 * i] = i >= face && i < face + left ? 1.0F : 0.0F;
        to[2 * i + 1] = i >= face + left ? 1.0F : 0.0F;
    }
};

} // namespace detail

/// One of a frame's pictures: the camera of its render, and where it goes.
struct DeviceView {
    Pinhole<float> camera;
    DevicePicture<float> picture;
};

/// An avatar on a device with what draws it, on white. Policy: as DeviceDrawingPolicy.
template <DeviceEffects E, class Device, class Policy = DeviceDrawingPolicy<>>
class DeviceAvatarDrawer {
    using Host = TwoStream<float, E>;

  public:
    /// Takes a copy of the host's avatar. Waits. Throws an Error for networks that do not fit the
    /// tiles, and for landmarks that are not finite.
    DeviceAvatarDrawer(const Device& device, const CudaQueue& queue, const AvatarOnHost<E>& of)
        : device_(device),
          avatar_(device, queue, of),
          upsampler_(device, of.avatar.upsampler.shape),
          eyes_frame_(device),
          counts_(device) {
        const Index channels = of.avatar.upsampler.shape.in_channels;
        require(channels == of.config.channels, "DeviceAvatarDrawer", "super-resolution reads ",
                channels, " channels, renders have ", of.config.channels);
        const Columns<float> colours = Columns<float>::Ones(channels, 1);
        colours_.reserve(queue, static_cast<std::size_t>(channels) + 2);
        device.fill(queue, colours_.data(), 0, colours_.bytes());
        device.send(queue, colours_.data(), colours.data(), bytes_of(channels));
        upsampler_.set(queue, device_upsampler(avatar_.parameters(), avatar_.shapes().upsampler));
    }
    DeviceAvatarDrawer(const DeviceAvatarDrawer&) = delete;
    DeviceAvatarDrawer& operator=(const DeviceAvatarDrawer&) = delete;

    /// Takes the parameters of an avatar of the same shapes. Waits.
    void upload(const CudaQueue& queue, const Host& from) {
        avatar_.upload(queue, from);
        upsampler_.set(queue, device_upsampler(avatar_.parameters(), avatar_.shapes().upsampler));
        placed_ = false;
        driven_.clear();
        forget_frames();
    }
    /// The avatar, whose cloud is the driven one.
    const DeviceTwoStream<E, Device, typename Policy::Networks>& avatar() const { return avatar_; }
    /// Draws with this dilation from now on [px^2].
    void set_dilation(double dilation) {
        rasterizer_.accuracy.dilation = dilation;
        forget_frames();
    }
    /// Side of the picture over that of the render.
    int factor() const { return 1 << upsampler_.shape().doublings; }

    /// Takes what the next frame is driven by. Waits. Throws an Error as DeviceTwoStream's does.
    void set_drivers(const CudaQueue& queue, const Drivers<float, E>& drivers) {
        driven_.clear();
        avatar_.set_drivers(queue, drivers);
    }
    /// Puts the driving on the stream: what the drivers alone change, but for the first frame of
    /// parameters.
    void drive_into(const CudaQueue& queue) {
        driven_.clear();
        kept_ = false;
        if (placed_) return avatar_.redrive_into(queue);
        forget_frames();
        avatar_.drive_into(queue, false);
        placed_ = true;
    }
    /// The same where the drivers differ in the gazes alone from those of the last driving: what
    /// gazes move, with the same bits.
    void regaze_into(const CudaQueue& queue) {
        if (!placed_) return drive_into(queue);
        driven_.clear();
        kept_ = false;
        avatar_.regaze_into(queue);
    }
    /// Puts a picture of the driven avatar on the stream: 3 x pixels, factor() times as wide and
    /// high as the camera's, which is that of the render. Pictures that are drawn before the same
    /// finish() have different views, from 0 on.
    void draw_into(const CudaQueue& queue, const Pinhole<float>& camera,
                   const DevicePicture<float>& picture, std::size_t view = 0) {
        forget_frames();
        draw(queue, camera, picture, view, [&](const DeviceImages& to, DeviceFrame<Device>& frame) {
            rasterizer_.forward_into(queue, avatar_.cloud(), camera, colours_.data(), to, frame);
        });
    }
    /// Puts a whole frame on the stream: the driving and the pictures of all views, whose cameras
    /// have one size. It drives what gazes move where nothing else differs from the drivers of the
    /// last finished frame, and nothing where nothing does. A frame that differs from one before in
    /// numbers of drivers and cameras alone is launched as the graph of that one, with its bits;
    /// another size, principal point or picture's address, lists that had no room and pictures
    /// drawn by draw_into or eyes_into meanwhile make new graphs. The queue's stream is not null.
    /// Throws an Error as set_drivers does. finish() comes before the next frame.
    void frame_into(const CudaQueue& queue, const Drivers<float, E>& drivers,
                    std::span<const DeviceView> views) {
        for (const DeviceView& v : views)
            require(v.camera.width == views[0].camera.width &&
                        v.camera.height == views[0].camera.height,
                    "DeviceAvatarDrawer", "a frame's views have renders of ", v.camera.width, " x ",
                    v.camera.height, " and ", views[0].camera.width, " x ", views[0].camera.height,
                    ", expected one size");
        next_ = avatar_.packed(drivers, -1, {});
        const detail::DriverPlaces<E>& places = avatar_.driver_places();
        Change change = placed_ ? Change::drivers : Change::all;
        if (placed_ && places.same_but_gazes(next_, driven_))
            change = same_bits(next_, driven_) ? Change::camera : Change::gaze;
        driven_.clear();
        put_numbers(queue, change, views);
        const Key kind{static_cast<std::uintptr_t>(change), views.size()};
        Key key = kind;
        for (const DeviceView& v : views) {
            for (const float at : {v.camera.cx, v.camera.cy})
                key.push_back(std::bit_cast<std::uint32_t>(at));
            key.push_back(reinterpret_cast<std::uintptr_t>(v.picture.pixels.data));
        }
        graphs_.run(queue, kind, key, [&] { put_frame(queue, change, views); });
        placed_ = kept_ = true;
        for (std::size_t k = 0; k < views.size(); ++k) frames_[k]->drawn = true;
    }
    /// Graphs of frames that are kept.
    std::size_t graphs() const { return graphs_.size(); }
    /// Puts each eye's share of the pixels on the stream, 2 x pixels of the camera: of the light
    /// that reaches a pixel, what the eye's Gaussians stop behind and beside the face's.
    void eyes_into(const CudaQueue& queue, const Pinhole<float>& camera,
                   const DeviceColumns<float>& shares) {
        forget_frames();
        DeviceGaussians<float> shown = avatar_.cloud();
        const Index n = shown.count(), pixels = Index(camera.width) * camera.height;
        const std::size_t room = eyes_.size();
        eyes_.reserve(queue, 2 * static_cast<std::size_t>(n) + 1);
        eyes_alpha_.reserve(queue, static_cast<std::size_t>(pixels) + 1);
        if (eyes_.size() != room)
            launch_each(device_, queue, n,
                        detail::EyesAsFeatures{eyes_.data(), avatar_.face_count(),
                                               avatar_.shapes().eyes.points_of(0)});
        shown.feature = {eyes_.data(), 2, n};
        const float* const nothing = colours_.data() + upsampler_.shape().in_channels;
        rasterizer_.forward_into(queue, shown, camera, nothing,
                                 {shares, {eyes_alpha_.data(), 1, pixels}}, eyes_frame_.memory);
        eyes_frame_.drawn = true;
    }
    /// Waits for what was put on the stream since the last call. Whether there was room for it;
    /// where there was none there is now, and it has to be driven and drawn again. Throws an Error
    /// for a gaze without a direction and for driven Gaussians that are not finite.
    bool finish(const CudaQueue& queue) {
        const auto take = [&] {
            counts_.fetch(queue);
            const std::uint32_t* const lists = counts_.piece(1);
            const std::uint32_t bad = avatar_.bad_gaze() != nullptr ? *counts_.piece(0) : 0;
            return avatar_.take(bad, {lists, lists + avatar_.rooms().lists});
        };
        const bool driven = kept_ ? take() : avatar_.finish(queue);
        placed_ = placed_ && driven;
        bool whole = driven;
        const auto look = [&](Frame& frame, std::size_t piece) {
            if (!frame.drawn) return;
            frame.drawn = false;
            FrameReport report;
            if (kept_) std::memcpy(&report, counts_.piece(piece), sizeof report);
            const bool fits = kept_ ? frame.memory.take(report, most_entries, NonFinite::cull)
                                    : frame.memory.finish(queue, most_entries, NonFinite::cull);
            whole = whole && fits;
            require(!driven || frame.memory.cost.non_finite == 0, "the driven Gaussians",
                    frame.memory.cost.non_finite,
                    " of them are not finite everywhere; the avatar is damaged, or its drivers "
                    "are far from those of its training");
        };
        for (std::size_t k = 0; k < frames_.size(); ++k) look(*frames_[k], 2 + k);
        look(eyes_frame_, 0);
        if (kept_ && whole) driven_ = std::move(next_);
        if (!whole) graphs_.forget();
        kept_ = false;
        return whole;
    }

    /// Drives the avatar for the pictures that follow: what gazes move where nothing else differs
    /// from what the last call was given, and nothing where nothing does. Waits.
    void drive(const CudaQueue& queue, const Drivers<float, E>& drivers) {
        const detail::DriverPlaces<E>& places = avatar_.driver_places();
        std::vector<float> numbers = places.packed(drivers, -1);
        const bool by_gaze = placed_ && places.same_but_gazes(numbers, driven_);
        if (by_gaze && same_bits(numbers, driven_)) return;
        set_drivers(queue, drivers);
        do {
            if (by_gaze)
                regaze_into(queue);
            else
                drive_into(queue);
        } while (!finish(queue));
        driven_ = std::move(numbers);
    }
    /// A picture of the driven avatar. Waits. Throws an Error where a number of it is not finite.
    Image<float> picture(const CudaQueue& queue, const Pinhole<float>& camera) {
        Image<float> image(camera.width * factor(), camera.height * factor(), 3);
        picture_.reserve(queue, static_cast<std::size_t>(image.pixels.size()) + 1);
        drawn_whole(queue, [&] {
            draw_into(queue, camera,
                      {{picture_.data(), 3, image.pixels.cols()}, image.width, image.height});
        });
        return fetched(queue, std::move(image));
    }
    /// Each eye's share of the pixels, two channels. Waits.
    Image<float> eyes(const CudaQueue& queue, const Pinhole<float>& camera) {
        Image<float> image(camera.width, camera.height, 2);
        picture_.reserve(queue, static_cast<std::size_t>(image.pixels.size()) + 1);
        drawn_whole(queue, [&] {
            eyes_into(queue, camera, {picture_.data(), 2, image.pixels.cols()});
        });
        return fetched(queue, std::move(image));
    }

    /// Memory that is held [bytes].
    std::size_t bytes() const {
        std::size_t sum = avatar_.bytes() + upsampler_.bytes() + trace_.bytes() +
                          eyes_frame_.memory.bytes() + colours_.bytes() + render_.bytes() +
                          eyes_.bytes() + eyes_alpha_.bytes() + picture_.bytes() + lenses_.bytes() +
                          counts_.bytes();
        for (const auto& frame : frames_) sum += frame->memory.bytes();
        return sum;
    }

  private:
    static constexpr std::int64_t most_entries = std::int64_t(1) << 31;

    /// Memory of a render without a vjp.
    struct Frame {
        DeviceFrame<Device> memory;
        bool drawn = false; ///< since the last finish

        explicit Frame(const Device& device) : memory(device) { memory.for_vjp = false; }
    };

    /// What of a frame is not that of the last finished one.
    enum class Change { camera, gaze, drivers, all };
    using Key = std::vector<std::uintptr_t>;
    using Lens = DeviceLens<NoDistortion>;

    /// Forgets kept frames, as memory that they use may move or hold other numbers.
    void forget_frames() {
        graphs_.forget();
        kept_ = false;
    }
    /// Puts the frame's numbers where its kernels read them.
    void put_numbers(const CudaQueue& queue, Change change, std::span<const DeviceView> views) {
        const bool room = lenses_.size() > views.size();
        lenses_.reserve(queue, views.size() + 1);
        bool same = counts_.reserve(queue, views.size() + 2) && room && change != Change::all;
        if (!views.empty()) {
            const std::array<int, 2> size{views[0].camera.width, views[0].camera.height};
            same = same && size == size_;
            size_ = size;
        }
        if (!same) forget_frames();
        if (change != Change::camera)
            detail::put_words(device_, queue, avatar_.drivers(), next_.data(), next_.size());
        std::vector<Lens> lenses;
        for (const DeviceView& v : views) lenses.push_back(rasterizer_.lens(v.camera));
        detail::put_words(device_, queue, lenses_.data(), lenses.data(), lenses.size());
    }
    /// Puts the kernels of a frame on the stream.
    void put_frame(const CudaQueue& queue, Change change, std::span<const DeviceView> views) {
        if (change == Change::all) avatar_.drive_into(queue, false);
        if (change == Change::drivers) avatar_.redrive_into(queue);
        if (change == Change::gaze) avatar_.regaze_into(queue);
        const detail::DeviceRooms rooms = avatar_.rooms();
        std::vector<detail::CountsAt> counts{
            {avatar_.bad_gaze(), avatar_.bad_gaze() != nullptr ? 1U : 0U},
            {rooms.count, static_cast<std::uint32_t>(rooms.lists)}};
        for (std::size_t k = 0; k < views.size(); ++k) {
            draw(queue, views[k].camera, views[k].picture, k,
                 [&](const DeviceImages& to, DeviceFrame<Device>& frame) {
                     rasterizer_.forward_into(queue, avatar_.cloud(), lenses_.data() + k,
                                              views[k].camera, colours_.data(), to, frame);
                 });
            counts.push_back({reinterpret_cast<const std::uint32_t*>(frames_[k]->memory.m.report),
                              sizeof(FrameReport) / sizeof(std::uint32_t)});
        }
        counts_.gather_into(queue, counts);
    }
    /// Puts a picture on the stream, with its render by render(images, frame).
    template <class Render>
    void draw(const CudaQueue& queue, const Pinhole<float>& camera,
              const DevicePicture<float>& picture, std::size_t view, const Render& render) {
        const Index channels = upsampler_.shape().in_channels;
        const Index pixels = Index(camera.width) * camera.height;
        render_.reserve(queue, static_cast<std::size_t>((channels + 1) * pixels) + 1);
        const DeviceColumns<float> feature{render_.data(), channels, pixels},
            alpha{render_.data() + channels * pixels, 1, pixels};
        while (frames_.size() <= view) frames_.push_back(std::make_unique<Frame>(device_));
        render(DeviceImages{feature, alpha}, frames_[view]->memory);
        frames_[view]->drawn = true;
        upsampler_.forward_into(queue, {feature, camera.width, camera.height}, picture, trace_);
    }
    static std::size_t bytes_of(Index n) { return static_cast<std::size_t>(n) * sizeof(float); }

    /// Enqueues the work of `draw`, with enough memory.
    template <class Draw>
    void drawn_whole(const CudaQueue& queue, const Draw& draw) {
        require(placed_, "DeviceAvatarDrawer", "nothing was driven before the picture");
        do {
            draw();
        } while (!finish(queue));
    }
    Image<float> fetched(const CudaQueue& queue, Image<float> image) const {
        device_.fetch(queue, image.pixels.data(), picture_.data(), bytes_of(image.pixels.size()));
        require(image.pixels.allFinite(), "DeviceAvatarDrawer",
                "the picture is not finite everywhere; the avatar is damaged, or its drivers are "
                "far from those of its training");
        return image;
    }

    Device device_;
    DeviceTwoStream<E, Device, typename Policy::Networks> avatar_;
    DeviceUpsampler<Device, Policy::upsampler_planes> upsampler_;
    DeviceUpsamplerTrace trace_;
    DeviceRasterizer<typename Policy::Accuracy, Device, typename Policy::Channels> rasterizer_;
    std::vector<std::unique_ptr<Frame>> frames_; ///< of each view
    Frame eyes_frame_;
    DeviceBuffer<float> colours_; ///< white of the render's channels, then none of two
    DeviceBuffer<float> render_;  ///< features, then alpha
    DeviceBuffer<float> eyes_, eyes_alpha_, picture_;
    std::vector<float> driven_; ///< drivers that the cloud is by, or empty
    std::vector<float> next_;   ///< drivers of the frame that is on the stream
    bool placed_ = false;       ///< whether drive_into has seen the parameters
    bool kept_ = false;         ///< whether counts_ has those of all that is on the stream
    DeviceBuffer<Lens> lenses_; ///< of each view
    detail::GatheredCounts<Device> counts_; ///< bad gazes, lengths of lists, each view's report
    std::array<int, 2> size_{};             ///< of renders of kept frames [px]
    detail::KeptGraphs<Device, Key, Key> graphs_;
};

} // namespace rye
