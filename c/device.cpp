// SPDX-License-Identifier: Apache-2.0
/// c/device.cpp: renderers, frames and gradients, as rye/c/device.h has them.
#include <algorithm>
#include <cstring>
#include <limits>
#include <string>

#include <rye/splat/cuda/sh_color.hpp>

#include "device_drawing.hpp"
#include "status.hpp"

namespace rye::c {
namespace {

/// The caller's memory, or the library's.
class CallersMemory {
  public:
    explicit CallersMemory(const rye_device_options& o) : options_(o) {}

    void* allocate(std::size_t bytes, CudaStream stream) {
        if (options_.allocate == nullptr) return own_.allocate(bytes, stream);
        return options_.allocate(options_.context, bytes, stream);
    }
    void release(void* p, CudaStream stream) {
        if (options_.release == nullptr) return own_.release(p, stream);
        options_.release(options_.context, p, stream);
    }

  private:
    rye_device_options options_;
    LibraryMemory own_;
};

/// The report of a frame on its way to the host. Of a frame in a CUDA graph, whose launches nobody
/// counts, it stays on the device.
#if defined(__CUDACC__)
class Arriving {
  public:
    Arriving() = default;
    Arriving(const Arriving&) = delete;
    Arriving& operator=(const Arriving&) = delete;
    ~Arriving() {
        if (event_ != nullptr) cudaEventDestroy(event_);
        if (report_ != nullptr) memory_.release(report_, nullptr);
    }
    void send(const CudaQueue& queue, const FrameReport* from) {
        cudaStreamCaptureStatus status = cudaStreamCaptureStatusNone;
        check_cuda(cudaStreamIsCapturing(queue.stream, &status), "frame");
        captured_ = status != cudaStreamCaptureStatusNone;
        if (captured_) return;
        if (event_ == nullptr)
            check_cuda(cudaEventCreateWithFlags(&event_, cudaEventDisableTiming), "frame");
        if (report_ == nullptr)
            report_ = static_cast<FrameReport*>(memory_.allocate(sizeof(FrameReport), nullptr));
        check_cuda(cudaMemcpyAsync(report_, from, sizeof(FrameReport), cudaMemcpyDeviceToHost,
                                   queue.stream),
                   "frame");
        check_cuda(cudaEventRecord(event_, queue.stream), "frame");
    }
    /// Sets the report and returns true, if it is there.
    bool take(bool wait, const CudaQueue& queue, const FrameReport* from, FrameReport& report) {
        if (captured_) {
            if (wait) LibraryDevice().fetch(queue, &report, from, sizeof report);
            return wait;
        }
        const cudaError_t got = wait ? cudaEventSynchronize(event_) : cudaEventQuery(event_);
        if (got == cudaErrorNotReady) return false;
        check_cuda(got, "frame");
        report = *report_;
        return true;
    }

  private:
    PageLockedMemory memory_;
    FrameReport* report_ = nullptr;
    cudaEvent_t event_ = nullptr;
    bool captured_ = false;
};
#else
class Arriving {
  public:
    void send(const CudaQueue&, const FrameReport*) {}
    bool take(bool, const CudaQueue&, const FrameReport* from, FrameReport& report) {
        report = *from;
        return true;
    }
};
#endif

AccuracyNumbers numbers_of(const rye_device_options& o) {
    const auto of = [](const auto& a) {
        return AccuracyNumbers{a.alpha_min, a.alpha_max, a.stop, a.dilation};
    };
    AccuracyNumbers n = of(Balanced());
    if (o.accuracy == RYE_ACCURACY_FAST) n = of(Fast());
    if (o.accuracy == RYE_ACCURACY_TIGHT) n = of(Tight());
    if (o.accuracy == RYE_ACCURACY_3DGS) n = of(Compatible3dgs());
    if (o.dilation != 0) n.dilation = std::max(0.0, double(o.dilation));
    return n;
}
std::unique_ptr<DeviceDrawing> drawing_of(const rye_device_options& o) {
    const AccuracyNumbers n = numbers_of(o);
    const bool mip = o.antialias == RYE_ANTIALIAS_MIP;
    if (o.accuracy == RYE_ACCURACY_3DGS)
        return mip ? drawing_by_square_mip(n) : drawing_by_square(n);
    return mip ? drawing_by_ellipse_mip(n) : drawing_by_ellipse(n);
}

const rye_device_options& checked(const rye_device_options& o) {
    check_struct(&o, "options");
    require(o.accuracy >= 0 && o.accuracy <= RYE_ACCURACY_3DGS, "options: accuracy", "got ",
            o.accuracy, ", expected 0 to 3");
    require(o.antialias >= 0 && o.antialias <= RYE_ANTIALIAS_MIP, "options: antialias", "got ",
            o.antialias, ", expected 0 or 1");
    require(std::isfinite(o.dilation), "options: dilation", "got ", o.dilation,
            ", expected a finite number");
    require((o.allocate == nullptr) == (o.release == nullptr), "options",
            "got one of allocate and release, expected both or none");
    return o;
}

bool harmonic(const rye_device_cloud& c) { return c.harmonics != nullptr; }

const rye_device_cloud& checked(const rye_device_cloud* cloud) {
    check_struct(cloud, "cloud");
    const rye_device_cloud& c = *cloud;
    constexpr std::int64_t most = std::numeric_limits<std::int32_t>::max();
    require(c.count >= 0 && c.count <= most, "cloud: count", "got ", c.count, ", expected 0 to ",
            most);
    require(c.channels >= 1 && c.channels <= 1024, "cloud: channels", "got ", c.channels,
            ", expected 1 to 1024");
    if (harmonic(c)) {
        require(c.channels == 3 && c.feature == nullptr, "cloud",
                "got harmonics and features, or other channels than 3; expected harmonics alone");
        require(c.degree >= 0 && c.degree <= 4, "cloud: degree", "got ", c.degree,
                ", expected 0 to 4");
        require(c.bases >= sh_count(c.degree) && c.bases <= 1024, "cloud: bases", "got ", c.bases,
                ", expected ", sh_count(c.degree), " to 1024");
    }
    if (c.count > 0) {
        check_pointer(c.mean, "cloud: mean");
        check_pointer(c.rotation, "cloud: rotation");
        check_pointer(c.scale, "cloud: scale");
        check_pointer(c.opacity, "cloud: opacity");
        if (!harmonic(c)) check_pointer(c.feature, "cloud: feature");
    }
    return c;
}

DeviceGaussians<const float> gaussians_of(const rye_device_cloud& c, const float* feature) {
    const auto n = static_cast<Index>(c.count);
    return {{c.mean, 3, n}, {c.rotation, 4, n}, {c.scale, 3, n}, {c.opacity, 1, n},
            {feature, c.channels, n}};
}

/// The harmonics of a cloud, or their gradients in memory of the same order.
template <class T>
DeviceHarmonics<T> harmonics_of(const rye_device_cloud& c, T* mean, T* harmonics) {
    const auto n = static_cast<Index>(c.count);
    return {{mean, 3, n}, {harmonics, 3, n}, {harmonics, 3 * (sh_count(c.degree) - 1), n}};
}

void copy_on_device(const CudaQueue& queue, float* to, const float* from, std::size_t bytes) {
#if defined(__CUDACC__)
    check_cuda(cudaMemcpyAsync(to, from, bytes, cudaMemcpyDeviceToDevice, queue.stream), "frame");
#else
    static_cast<void>(queue);
    std::memcpy(to, from, bytes);
#endif
}

} // namespace

} // namespace rye::c

using namespace rye;
using namespace rye::c;

struct rye_device_renderer {
    CallersMemory memory;
    std::unique_ptr<DeviceDrawing> drawing;

    explicit rye_device_renderer(const rye_device_options& o) : memory(o), drawing(drawing_of(o)) {}
};

struct rye_device_frame {
    rye_device_renderer& renderer;
    LibraryFrame frame;
    Arriving arriving;
    Pinhole<float> camera;
    CudaStream stream = nullptr;
    DeviceColumns<const float> alpha; ///< of the caller, in the last image
    Index count = -1, channels = 0;   ///< of the last image; negative: there is none
    DeviceBuffer<float> background, color, unwanted, partial;

    explicit rye_device_frame(rye_device_renderer& r) : renderer(r) {}
    CudaQueue queue() { return {stream, renderer.memory}; }
    Vec3<float> eye() const {
        const auto& m = camera.camera_from_world;
        return Vec3<float>(-(m.rotation.transpose() * m.translation));
    }
};

extern "C" {

const char* rye_device_message(void) { return last_message(); }

int32_t rye_device_is_host(void) {
#if defined(__CUDACC__)
    return 0;
#else
    return 1;
#endif
}

rye_status rye_device_renderer_create(const rye_device_options* options,
                                      rye_device_renderer** renderer) {
    return guarded([&] {
        check_pointer(renderer, "renderer");
        const rye_device_options usual = RYE_INIT(rye_device_options);
        *renderer = new rye_device_renderer(checked(options == nullptr ? usual : *options));
    });
}

void rye_device_renderer_destroy(rye_device_renderer* renderer) { delete renderer; }

rye_status rye_device_frame_create(rye_device_renderer* renderer, rye_device_frame** frame) {
    return guarded([&] {
        check_pointer(renderer, "renderer");
        check_pointer(frame, "frame");
        *frame = new rye_device_frame(*renderer);
    });
}

void rye_device_frame_destroy(rye_device_frame* frame) { delete frame; }

rye_status rye_device_frame_room(rye_device_frame* frame, int64_t entries, int64_t groups) {
    return guarded([&] {
        check_pointer(frame, "frame");
        constexpr std::int64_t most = std::int64_t(1) << 31;
        require(entries >= 0 && entries <= most, "entries", "got ", entries, ", expected 0 to ",
                most);
        require(groups >= 0 && groups <= most, "groups", "got ", groups, ", expected 0 to ", most);
        LibraryFrame& f = frame->frame;
        f.entry_capacity = std::max<std::int64_t>(f.entry_capacity, entries);
        f.group_capacity = std::max<std::int64_t>(f.group_capacity, groups);
    });
}

rye_status rye_device_draw(rye_device_frame* frame, const rye_device_cloud* cloud,
                           const rye_camera* camera, const float* background,
                           const rye_device_image* image, int32_t gradient, void* stream) {
    return guarded([&] {
        check_pointer(frame, "frame");
        const rye_device_cloud& c = checked(cloud);
        const Pinhole<float> pinhole = camera_of(camera);
        check_struct(image, "image");
        check_pointer(image->feature, "image: feature");
        check_pointer(image->alpha, "image: alpha");
        rye_device_frame& f = *frame;
        f.count = -1; // until all is on the stream
        f.camera = pinhole;
        f.stream = static_cast<CudaStream>(stream);
        const CudaQueue queue = f.queue();
        const auto n = static_cast<Index>(c.count);
        const Index pixels = static_cast<Index>(pinhole.width) * pinhole.height;
        const LibraryDevice& device = f.frame.device;
        // The background is kept: the caller's may be gone when the gradient is asked for.
        f.background.reserve(queue, static_cast<std::size_t>(c.channels));
        const std::size_t bytes = sizeof(float) * static_cast<std::size_t>(c.channels);
        if (background == nullptr)
            device.fill(queue, f.background.data(), 0, bytes);
        else
            copy_on_device(queue, f.background.data(), background, bytes);
        const float* feature = c.feature;
        if (harmonic(c)) {
            f.color.reserve(queue, static_cast<std::size_t>(3 * n + 1));
            sh_colors_into(queue, device, harmonics_of<const float>(c, c.mean, c.harmonics),
                           f.eye(), f.color.data(), nullptr, HarmonicsByBasis{c.bases});
            feature = f.color.data();
        }
        const DeviceImages images{{image->feature, c.channels, pixels}, {image->alpha, 1, pixels}};
        // NaN, which stays if the frame does not fit.
        const std::size_t all = sizeof(float) * static_cast<std::size_t>(pixels);
        device.fill(queue, image->feature, 0xFF, all * static_cast<std::size_t>(c.channels));
        device.fill(queue, image->alpha, 0xFF, all);
        f.frame.for_vjp = gradient != 0;
        f.renderer.drawing->forward(queue, gaussians_of(c, feature), pinhole, f.background.data(),
                                    images, f.frame);
        f.arriving.send(queue, f.frame.m.report);
        f.alpha = images.alpha;
        f.channels = c.channels;
        f.count = n;
    });
}

rye_status rye_device_finish(rye_device_frame* frame, int32_t wait, rye_device_cost* cost) {
    return guarded([&] {
        check_pointer(frame, "frame");
        check_struct(cost, "cost");
        rye_device_frame& f = *frame;
        if (f.count < 0)
            throw Failure(RYE_ERROR_STATE, "rye_device_finish: rye_device_draw has drawn nothing");
        rye_device_cost r = RYE_INIT(rye_device_cost);
        r.bytes = static_cast<std::int64_t>(f.frame.bytes());
        r.fits = -1;
        FrameReport report{};
        if (f.arriving.take(wait != 0, f.queue(), f.frame.m.report, report)) {
            r.fits = f.frame.take(report) ? 1 : 0;
            r.entries = f.frame.cost.entries;
            r.groups = f.frame.cost.groups;
            r.skipped = f.frame.cost.non_finite;
        }
        *cost = r;
    });
}

rye_status rye_device_gradient(rye_device_frame* frame, const rye_device_cloud* cloud,
                               const rye_device_image_gradient* image,
                               const rye_device_cloud_gradient* gradient) {
    return guarded([&] {
        check_pointer(frame, "frame");
        check_struct(image, "image");
        check_pointer(image->feature, "image: feature");
        check_struct(gradient, "gradient");
        const rye_device_cloud& c = checked(cloud);
        rye_device_frame& f = *frame;
        const auto n = static_cast<Index>(c.count);
        if (f.count != n || f.channels != c.channels || !f.frame.for_vjp)
            throw Failure(RYE_ERROR_STATE,
                          "rye_device_gradient: the frame has no picture of this cloud that was "
                          "drawn for its gradient");
        const CudaQueue queue = f.queue();
        const LibraryDevice& device = f.frame.device;
        const Index pixels = static_cast<Index>(f.camera.width) * f.camera.height;
        // Room for what the caller does not want, or what harmonics are computed from.
        const rye_device_cloud_gradient& g = *gradient;
        const Index rows[] = {3, 4, 3, 1, c.channels};
        float* to[] = {g.mean, g.rotation, g.scale, g.opacity, harmonic(c) ? nullptr : g.feature};
        Index missing = 1;
        for (int k = 0; k < 5; ++k) missing += to[k] == nullptr ? rows[k] * n : 0;
        f.unwanted.reserve(queue, static_cast<std::size_t>(missing));
        float* at = f.unwanted.data();
        for (int k = 0; k < 5; ++k) {
            if (to[k] == nullptr) {
                to[k] = at;
                at += rows[k] * n;
            }
            device.fill(queue, to[k], 0xFF, sizeof(float) * static_cast<std::size_t>(rows[k] * n));
        }
        const DeviceColumns<const float> g_feature{image->feature, c.channels, pixels};
        const DeviceCotangent cotangent{
            g_feature, {image->alpha, 1, image->alpha != nullptr ? pixels : 0}};
        f.renderer.drawing->vjp(
            queue, gaussians_of(c, harmonic(c) ? f.color.data() : c.feature), f.camera,
            f.background.data(), cotangent,
            {{to[0], 3, n}, {to[1], 4, n}, {to[2], 3, n}, {to[3], 1, n}, {to[4], c.channels, n}},
            f.frame);
        if (harmonic(c) && g.harmonics != nullptr) {
            if (c.bases > sh_count(c.degree))
                device.fill(queue, g.harmonics, 0,
                            sizeof(float) * static_cast<std::size_t>(3 * c.bases * n));
            sh_colors_vjp_into(queue, device, harmonics_of<const float>(c, c.mean, c.harmonics),
                               f.eye(), to[4], harmonics_of<float>(c, to[0], g.harmonics),
                               &f.frame.m, HarmonicsByBasis{c.bases});
        }
        if (g.background != nullptr) {
            using Numbers = DeviceRasterizer<Chosen<Balanced, Antialias::dilate>, LibraryDevice>;
            f.partial.reserve(queue, static_cast<std::size_t>(
                                         Numbers::background_numbers(c.channels, pixels) + 1));
            f.renderer.drawing->background_vjp(queue, g_feature, f.alpha, f.partial.data(),
                                               g.background, f.frame);
        }
    });
}

} // extern "C"
