// SPDX-License-Identifier: Apache-2.0
/// c/device_drawing.hpp: the device of the library rye_device, and drawings on it by the rules of
/// an accuracy. By nvcc the device is CUDA's; by another compiler, for tests, the host emulates it.
#pragma once

#include <memory>

#include <rye/c/device.h>
#include <rye/splat/cuda/rasterizer.hpp>

#if defined(__CUDACC__)
#include <rye/backend/cuda/page_locked.hpp>
#else
#include <rye/backend/cuda/emulation.hpp>
#endif

namespace rye::c {

#if defined(__CUDACC__)
using LibraryDevice = CudaDevice;
using LibraryMemory = StreamMemory;
#else
using LibraryDevice = EmulatedDevice;
using LibraryMemory = HostMemory;
#endif
/// Few enough numbers of channels that the library builds in minutes.
using LibraryChannels = KernelChannels<3, 4, 8, 16, 32>;
using LibraryFrame = DeviceFrame<LibraryDevice>;

/// The numbers of an accuracy policy, whose rules are types.
struct AccuracyNumbers {
    double alpha_min, alpha_max, stop, dilation;
};

/// DeviceRasterizer of an accuracy that is chosen while the program runs.
struct DeviceDrawing {
    virtual ~DeviceDrawing() = default;
    virtual void forward(const CudaQueue& queue, const DeviceGaussians<const float>& g,
                         const Pinhole<float>& camera, const float* background,
                         const DeviceImages& images, LibraryFrame& frame) const = 0;
    virtual void vjp(const CudaQueue& queue, const DeviceGaussians<const float>& g,
                     const Pinhole<float>& camera, const float* background,
                     const DeviceCotangent& cotangent, const DeviceGaussians<float>& out,
                     LibraryFrame& frame) const = 0;
    virtual void background_vjp(const CudaQueue& queue, const DeviceColumns<const float>& g_feature,
                                const DeviceColumns<const float>& alpha, float* partial, float* out,
                                const LibraryFrame& frame) const = 0;
};

/// A drawing by the rules of A.
template <class A>
struct DrawingBy final : DeviceDrawing {
    DeviceRasterizer<A, LibraryDevice, LibraryChannels> rasterizer;

    explicit DrawingBy(const AccuracyNumbers& n) {
        rasterizer.accuracy.alpha_min = n.alpha_min;
        rasterizer.accuracy.alpha_max = n.alpha_max;
        rasterizer.accuracy.stop = n.stop;
        rasterizer.accuracy.dilation = n.dilation;
    }
    void forward(const CudaQueue& queue, const DeviceGaussians<const float>& g,
                 const Pinhole<float>& camera, const float* background, const DeviceImages& images,
                 LibraryFrame& frame) const override {
        rasterizer.forward_into(queue, g, camera, background, images, frame);
    }
    void vjp(const CudaQueue& queue, const DeviceGaussians<const float>& g,
             const Pinhole<float>& camera, const float* background,
             const DeviceCotangent& cotangent, const DeviceGaussians<float>& out,
             LibraryFrame& frame) const override {
        rasterizer.vjp_into(queue, g, camera, background, cotangent, out, frame);
    }
    void background_vjp(const CudaQueue& queue, const DeviceColumns<const float>& g_feature,
                        const DeviceColumns<const float>& alpha, float* partial, float* out,
                        const LibraryFrame& frame) const override {
        rasterizer.background_vjp_into(queue, g_feature, alpha, partial, out, frame);
    }
};

/// Policy A with features and alpha alone, and an antialiasing of one's choice.
template <class A, Antialias kind>
struct Chosen : A {
    static constexpr Antialias antialias = kind;
    static constexpr Outputs outputs = features_only;
};

/// Returns a drawing by the rules of Balanced, of which Fast and Tight differ in numbers alone; by
/// those of Compatible3dgs. A unit each.
std::unique_ptr<DeviceDrawing> drawing_by_ellipse(const AccuracyNumbers& numbers);
std::unique_ptr<DeviceDrawing> drawing_by_ellipse_mip(const AccuracyNumbers& numbers);
std::unique_ptr<DeviceDrawing> drawing_by_square(const AccuracyNumbers& numbers);
std::unique_ptr<DeviceDrawing> drawing_by_square_mip(const AccuracyNumbers& numbers);

} // namespace rye::c
