// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/step_images.hpp: memory of a training step's pictures and their cotangents: three
/// renders, and super-resolution of two.
#pragma once

#include <rye/train/cuda/step_kernels.hpp>

namespace rye::detail {

/// Pictures of a step in device memory.
struct DeviceStepImages {
    DevicePicture<float> final, face, eyes, scaled, high, eyes_high;
    float* alpha[step_renders]; ///< of final, face, eyes
    DevicePicture<float> g_final, g_face, g_eyes, g_high, g_eyes_high;
    DevicePicture<float> g_feature; ///< cotangent of a render by super-resolution
};

/// Memory of a step's pictures.
class DeviceStepImageMemory {
  public:
    /// Returns pictures for renders of `channels`; the eyes' has as many with the high-resolution
    /// eye term, else 3.
    template <class Device>
    DeviceStepImages of(const CudaQueue& queue, const DeviceViews<Device>& views, Index channels,
                        bool eyes_high) {
        const Index s = views.small_pixels(), full = views.pixels();
        floats_.reserve(queue, static_cast<std::size_t>((6 * channels + 9) * s + 12 * full) + 64);
        float* at = floats_.data();
        const auto take = [&](Index rows, Index pixels) {
            at += rows * pixels;
            return at - rows * pixels;
        };
        const int f = views.factor();
        const auto small = [&](Index rows) {
            return DevicePicture<float>{
                {take(rows, s), rows, s}, views.width() / f, views.height() / f};
        };
        const auto large = [&] {
            return DevicePicture<float>{{take(3, full), 3, full}, views.width(), views.height()};
        };
        const Index of_eyes = eyes_high ? channels : 3;
        DeviceStepImages p;
        p.final = small(channels), p.face = small(3), p.eyes = small(of_eyes);
        p.scaled = small(channels);
        for (float*& a : p.alpha) a = take(1, s);
        p.g_final = small(channels), p.g_face = small(3), p.g_eyes = small(of_eyes);
        p.g_feature = small(channels);
        p.high = large(), p.g_high = large();
        if (eyes_high) p.eyes_high = large(), p.g_eyes_high = large();
        return p;
    }
    std::size_t bytes() const { return floats_.bytes(); }

  private:
    DeviceBuffer<float> floats_;
};

} // namespace rye::detail
