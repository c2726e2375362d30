// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/rasterizer.hpp: Rasterizer's verbs for Gaussians in device memory: it puts
/// kernels on the caller's stream, and neither waits nor reads anything back, so a step can be
/// captured as a CUDA graph. Memory is reserved when a frame is shaped, never while it is drawn.
/// The number of a frame's entries is known to the device alone. If they do not fit, nothing is
/// drawn and `finish`, the one function that waits, says so and makes room:
///     do { r.forward_into(...); } while (!frame.finish(queue));
#pragma once

#include <span>

#include <rye/splat/cuda/blend.hpp>
#include <rye/splat/cuda/frame.hpp>
#include <rye/splat/cuda/jvp.hpp>
#include <rye/splat/cuda/lists.hpp>
#include <rye/splat/cuda/merge.hpp>
#include <rye/splat/cuda/reverse.hpp>

namespace rye {

/// The numbers of channels that kernels are made for: some of 1 to 4, 8, 16 and 32, ascending.
/// Other numbers are drawn by the next larger kernel, or by the largest several times.
template <int... C>
struct KernelChannels {
    static constexpr int largest = (std::max)({C...});

    /// Calls f(integral_constant) of the kernels for this many channels.
    template <class F>
    static auto with(Index channels, const F& f) {
        bool done = false;
        const auto attempt = [&](auto c) {
            if (done || (channels > c() && c() != largest)) return;
            done = true;
            f(c);
        };
        (attempt(std::integral_constant<int, C>{}), ...);
    }
};

namespace detail {

/// Kernels for the usual numbers of channels.
using AnyChannels = KernelChannels<1, 3, 4, 8, 16, 32>;

} // namespace detail

/// True if pixels blend in the order of centres' depths: by_peak has plain loops only.
template <class A>
concept BlendsByCentre = A::order == BlendOrder::by_centre;
/// True if depths are compared as 32 bits: only backends of the host compare more.
template <class A>
concept DepthsOf32Bits = A::depth_bits == 32;
/// An accuracy policy that has kernels on a device.
template <class A>
concept DeviceAccuracy = AccuracyPolicy<A> && BlendsByCentre<A> && DepthsOf32Bits<A>;

/// Draws Gaussians by the rules of A on a device, and differentiates the pictures.
template <DeviceAccuracy A, class Device, class Kernels = detail::AnyChannels>
struct DeviceRasterizer {
    A accuracy;

    using Frame = DeviceFrame<Device>;

    /// Puts a render on the stream. `background` has a number a channel, in device memory.
    template <Distortion D>
    void forward_into(const CudaQueue& queue, const DeviceGaussians<const float>& g,
                      const Pinhole<float, D>& camera, const float* background,
                      const DeviceImages& images, Frame& frame) const {
        draw(queue, g, lens(camera), camera, background, images, frame);
    }
    /// The same by a lens that is in device memory when the picture is drawn, so that a kept graph
    /// draws by another one: of `camera` its size and principal point count.
    template <Distortion D>
    void forward_into(const CudaQueue& queue, const DeviceGaussians<const float>& g,
                      const DeviceLens<D>* by, const Pinhole<float, D>& camera,
                      const float* background, const DeviceImages& images, Frame& frame) const {
        draw(queue, g, DeviceLens<LensInMemory<D>>{by}, camera, background, images, frame);
    }
    /// Returns a camera as kernels take it.
    template <Distortion D>
    DeviceLens<D> lens(const Pinhole<float, D>& camera) const {
        return DeviceLens<D>(
            Projector<float, D>(camera, accuracy.frustum_margin, screen_dilation(accuracy)));
    }

    /// Puts the vjp of the frame's last render on the stream: gradients of everything in `g`.
    template <Distortion D>
    void vjp_into(const CudaQueue& queue, const DeviceGaussians<const float>& g,
                  const Pinhole<float, D>& camera, const float* background,
                  const DeviceCotangent& cotangent, const DeviceGaussians<float>& out,
                  Frame& frame) const {
        require(frame.for_vjp, "rasterizer",
                "got a frame that keeps nothing for a vjp, expected one that does");
        require(A::outputs.depth || cotangent.depth.data == nullptr, "rasterizer",
                "got a cotangent of depth, expected none: the policy's outputs have no depth");
        const detail::FrameMemory& m = frame.m;
        const Device& device = frame.device;
        const bool extra = cotangent.alpha.data != nullptr || cotangent.depth.data != nullptr;
        each_block_of_channels(g.channels(), [&](auto C, Index first, int channels) {
            const DeviceScene s = scene(g, background, camera, first, channels);
            if (extra && first == 0)
                device.launch(queue, Index(m.tiles) * detail::tile_strips,
                              detail::ReverseKernel<A, C(), true>{m, s, cotangent, accuracy});
            else
                device.launch(queue, Index(m.tiles) * detail::tile_strips,
                              detail::ReverseKernel<A, C(), false>{m, s, cotangent, accuracy});
            device.launch(queue, m.blocks,
                          detail::MergeKernel<A, D, C()>{g, out, lens(camera), m, first, channels,
                                                         first > 0});
        });
    }

    /// Puts the derivatives of the frame's last render in some directions on the stream: their
    /// images get the tangents of feature, alpha and depth. `splats`: memory for the work on the
    /// stream, to be kept until that is done; a later call takes it again.
    template <Distortion D>
    void jvp_into(const CudaQueue& queue, const DeviceGaussians<const float>& g,
                  std::span<const detail::DeviceDirection<D>> directions,
                  const Pinhole<float, D>& camera, const float* background,
                  DeviceBuffer<detail::SplatRecord>& splats, const Frame& frame) const {
        require(frame.for_vjp, "rasterizer",
                "got a frame that keeps nothing for a jvp, expected one that does");
        for (const detail::DeviceDirection<D>& d : directions) check(g, d, camera);
        splats.reserve(queue, 2 * static_cast<std::size_t>(g.count()) + 2);
        const auto walk = [&](auto K, std::size_t at) {
            constexpr auto count = static_cast<std::size_t>(K());
            detail::WalkedDirection walked[count];
            for (std::size_t k = 0; k < count; ++k) {
                const detail::DeviceDirection<D>& d = directions[at + k];
                detail::SplatRecord* const out =
                    splats.data() + k * static_cast<std::size_t>(g.count());
                project_tangents(queue, g, d, camera, out, frame);
                walked[k] = {out, d.gaussians.feature, d.camera != nullptr ? d.camera->cx : 0.0F,
                             d.camera != nullptr ? d.camera->cy : 0.0F, d.images};
            }
            each_block_of_channels(g.channels(), [&](auto C, Index first, int channels) {
                if constexpr (K() == 1 || C() <= 4) {
                    detail::TangentKernel<A, C(), K()> kernel{
                        frame.m, scene(g, background, camera, first, channels), accuracy, {}};
                    std::copy_n(walked, count, kernel.direction);
                    frame.device.launch(queue, Index(frame.m.tiles) * detail::tile_strips, kernel);
                }
            });
        };
        std::size_t at = 0;
        if (g.channels() <= 4)
            for (; at + 2 <= directions.size(); at += 2)
                walk(std::integral_constant<int, 2>(), at);
        for (; at < directions.size(); ++at) walk(std::integral_constant<int, 1>(), at);
    }

    /// Puts the gradient of the background on the stream, a number a channel; `partial` has room
    /// for background_numbers numbers.
    void background_vjp_into(const CudaQueue& queue, const DeviceColumns<const float>& g_feature,
                             const DeviceColumns<const float>& alpha, float* partial, float* out,
                             const Frame& frame) const {
        const Index chunks = (g_feature.cols + detail::BackgroundKernel::chunk - 1) /
                             detail::BackgroundKernel::chunk;
        frame.device.launch(queue, chunks, detail::BackgroundKernel{g_feature, alpha, partial});
        frame.device.launch(queue, 1,
                            detail::BackgroundSumKernel{partial, g_feature.rows, chunks, out});
    }
    static Index background_numbers(Index channels, Index pixels) {
        return channels *
               ((pixels + detail::BackgroundKernel::chunk - 1) / detail::BackgroundKernel::chunk);
    }

  private:
    template <class L, Distortion D>
    void draw(const CudaQueue& queue, const DeviceGaussians<const float>& g,
              const DeviceLens<L>& by, const Pinhole<float, D>& camera, const float* background,
              const DeviceImages& images, Frame& frame) const {
        check(g, camera, images);
        detail::check_alpha_min<float>(accuracy);
        require(A::payload == Payload::whole || !frame.for_vjp, "rasterizer",
                "got a frame for a vjp, expected one without: features are halves");
        Kernels::with(g.channels(), [&](auto C) {
            frame.shape(queue, g.count(), camera.width, camera.height,
                        detail::ChannelLayout<C()>::stride);
        });
        const detail::FrameMemory& m = frame.m;
        const Device& device = frame.device;
        constexpr std::uint32_t of_block = detail::ClearKernel::of_block;
        const auto counters =
            static_cast<std::uint32_t>(std::size_t(m.tiles) * detail::FrameMemory::apart +
                                       sizeof(FrameReport) / 4 + detail::FrameMemory::classes);
        device.launch(queue, (counters + of_block - 1) / of_block,
                      detail::ClearKernel{m.counters, counters});
        device.launch(queue, m.blocks,
                      detail::ProjectKernel<A, L>{g, by, accuracy, camera.cx, camera.cy,
                                                  camera.width, camera.height, m});
        device.launch(queue, 1, detail::ScanKernel{m});
        const std::uint32_t passes = frame.passes();
        device.launch(queue, passes * m.blocks,
                      detail::BinKernel<A>{camera.width, camera.height, m, passes});
        each_block_of_channels(g.channels(), [&](auto C, Index first, int channels) {
            if (first > 0) {
                device.launch(queue, 1, detail::ClearKernel{&m.report->groups, 1});
                device.launch(queue, 1,
                              detail::ClearKernel{m.walked, detail::FrameMemory::classes});
            }
            device.launch(queue, m.tiles,
                          detail::BlendKernel<A, C()>{
                              m, scene(g, background, camera, first, channels), images, accuracy});
        });
    }
    template <Distortion D>
    void project_tangents(const CudaQueue& queue, const DeviceGaussians<const float>& g,
                          const detail::DeviceDirection<D>& direction,
                          const Pinhole<float, D>& camera, detail::SplatRecord* out,
                          const Frame& frame) const {
        using Number = Dual<float, 1>;
        const auto moving = detail::dual_camera<float>(camera, direction.camera);
        using Lens = std::remove_cvref_t<decltype(moving.distortion)>;
        const Projector<Number, Lens> projector(moving, accuracy.frustum_margin,
                                                screen_dilation(accuracy));
        frame.device.launch(queue, frame.m.blocks,
                            detail::ProjectTangentsKernel<A, Lens>{
                                g, direction.gaussians, DeviceLens<Lens, Number>(projector),
                                accuracy, frame.m, out});
    }
    template <Distortion D>
    static DeviceScene scene(const DeviceGaussians<const float>& g, const float* background,
                             const Pinhole<float, D>& camera, Index first, int channels) {
        return {g.feature, background, first,        channels,
                camera.cx, camera.cy,  camera.width, camera.height};
    }

    /// Calls f(C, first, channels): kernels of C channels do channels [first, first + channels).
    template <class F>
    static void each_block_of_channels(Index channels, const F& f) {
        Kernels::with(channels, [&](auto C) {
            Index first = 0;
            do {
                f(C, first, static_cast<int>(std::min<Index>(C(), channels - first)));
                first += C();
            } while (first < channels);
        });
    }

    static void shaped(const char* name, Index rows, Index cols, Index want_rows, Index want) {
        require(rows == want_rows && cols == want, "rasterizer", "got ", name, " of ", rows, " x ",
                cols, ", expected ", want_rows, " x ", want);
    }
    template <Distortion D>
    static void check(const DeviceGaussians<const float>& g, const detail::DeviceDirection<D>& d,
                      const Pinhole<float, D>& camera) {
        const auto moved = [](const char* name, const DeviceColumns<const float>& x,
                              const DeviceColumns<const float>& dx) {
            if (dx.data != nullptr) shaped(name, dx.rows, dx.cols, x.rows, x.cols);
        };
        moved("tangent of mean", g.mean, d.gaussians.mean);
        moved("tangent of rotation", g.rotation, d.gaussians.rotation);
        moved("tangent of scale", g.scale, d.gaussians.scale);
        moved("tangent of opacity", g.opacity, d.gaussians.opacity);
        moved("tangent of feature", g.feature, d.gaussians.feature);
        check(g, camera, d.images);
    }
    template <Distortion D>
    static void check(const DeviceGaussians<const float>& g, const Pinhole<float, D>& camera,
                      const DeviceImages& images) {
        const Index n = g.count();
        shaped("mean", g.mean.rows, g.mean.cols, 3, n);
        shaped("rotation", g.rotation.rows, g.rotation.cols, 4, n);
        shaped("scale", g.scale.rows, g.scale.cols, 3, n);
        shaped("opacity", g.opacity.rows, g.opacity.cols, 1, n);
        shaped("feature", g.feature.rows, g.feature.cols, g.channels(), n);
        require(static_cast<std::uint64_t>(n) < std::uint64_t(1) << 31U, "rasterizer", "got ", n,
                " Gaussians, expected fewer than 2^31");
        const auto numbers = [&](Index columns) { // in 64 bits: an index may have 32
            return static_cast<std::uint64_t>(columns) *
                   static_cast<std::uint64_t>(std::max<Index>(g.channels(), 1));
        };
        require(numbers(n) < std::uint64_t(1) << 32U, "rasterizer", "got ", n, " Gaussians of ",
                g.channels(), " channels, expected fewer than 2^32 numbers");
        require(camera.width >= 0 && camera.height >= 0, "rasterizer", "got an image of ",
                camera.width, " x ", camera.height, " pixels, expected no negative size");
        const Index pixels = static_cast<Index>(camera.width) * camera.height;
        require(numbers(pixels) < std::uint64_t(1) << 32U, "rasterizer", "got an image of ", pixels,
                " pixels and ", g.channels(), " channels, expected fewer than 2^32 numbers");
        require(camera.near_depth > 0, "rasterizer",
                "got a near depth that is not positive, expected a positive one");
        shaped("feature image", images.feature.rows, images.feature.cols, g.channels(), pixels);
        shaped("alpha image", images.alpha.rows, images.alpha.cols, 1, pixels);
    }
};

} // namespace rye
