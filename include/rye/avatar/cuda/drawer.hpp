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
/// For both eyes of a viewer it is driven once and drawn twice, as views 0 and 1.
/// The same build gives the same bits for a frame, whatever was drawn before.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <rye/avatar/cuda/two_stream.hpp>
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
          eyes_frame_(device) {
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
    }
    /// The avatar, whose cloud is the driven one.
    const DeviceTwoStream<E, Device, typename Policy::Networks>& avatar() const { return avatar_; }
    /// Draws with this dilation from now on [px^2].
    void set_dilation(double dilation) { rasterizer_.accuracy.dilation = dilation; }
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
        if (placed_)
            avatar_.redrive_into(queue);
        else
            avatar_.drive_into(queue, false);
        placed_ = true;
    }
    /// The same where the drivers differ in the gazes alone from those of the last driving: what
    /// gazes move, with the same bits.
    void regaze_into(const CudaQueue& queue) {
        if (!placed_) return drive_into(queue);
        driven_.clear();
        avatar_.regaze_into(queue);
    }
    /// Puts a picture of the driven avatar on the stream: 3 x pixels, factor() times as wide and
    /// high as the camera's, which is that of the render. Pictures that are drawn before the same
    /// finish() have different views, from 0 on.
    void draw_into(const CudaQueue& queue, const Pinhole<float>& camera,
                   const DevicePicture<float>& picture, std::size_t view = 0) {
        const Index channels = upsampler_.shape().in_channels;
        const Index pixels = Index(camera.width) * camera.height;
        render_.reserve(queue, static_cast<std::size_t>((channels + 1) * pixels) + 1);
        const DeviceColumns<float> feature{render_.data(), channels, pixels},
            alpha{render_.data() + channels * pixels, 1, pixels};
        while (frames_.size() <= view) frames_.push_back(std::make_unique<Frame>(device_));
        rasterizer_.forward_into(queue, avatar_.cloud(), camera, colours_.data(), {feature, alpha},
                                 frames_[view]->memory);
        frames_[view]->drawn = true;
        upsampler_.forward_into(queue, {feature, camera.width, camera.height}, picture, trace_);
    }
    /// Puts each eye's share of the pixels on the stream, 2 x pixels of the camera: of the light
    /// that reaches a pixel, what the eye's Gaussians stop behind and beside the face's.
    void eyes_into(const CudaQueue& queue, const Pinhole<float>& camera,
                   const DeviceColumns<float>& shares) {
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
        const bool driven = avatar_.finish(queue);
        placed_ = placed_ && driven;
        bool whole = driven;
        const auto look = [&](Frame& frame) {
            if (!frame.drawn) return;
            frame.drawn = false;
            whole = frame.memory.finish(queue, most_entries, NonFinite::cull) && whole;
            require(!driven || frame.memory.cost.non_finite == 0, "the driven Gaussians",
                    frame.memory.cost.non_finite,
                    " of them are not finite everywhere; the avatar is damaged, or its drivers "
                    "are far from those of its training");
        };
        for (const auto& frame : frames_) look(*frame);
        look(eyes_frame_);
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
                          eyes_.bytes() + eyes_alpha_.bytes() + picture_.bytes();
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
    bool placed_ = false;       ///< whether drive_into has seen the parameters
};

} // namespace rye
