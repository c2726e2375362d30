// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/cloud_buffer.hpp: a cloud of Gaussians in device memory of its own.
#pragma once

#include <rye/backend/cuda.hpp>
#include <rye/splat/cuda/gaussians.hpp>

namespace rye::detail {

/// A cloud of Gaussians in device memory of its own.
class DeviceCloudBuffer {
  public:
    void reserve(const CudaQueue& queue, Index count, Index channels) {
        const Index rows[] = {3, 4, 3, 1, channels};
        for (int k = 0; k < 5; ++k)
            buffer_[k].reserve(queue, static_cast<std::size_t>(rows[k] * count) + 1);
        view_ = {{buffer_[0].data(), 3, count},
                 {buffer_[1].data(), 4, count},
                 {buffer_[2].data(), 3, count},
                 {buffer_[3].data(), 1, count},
                 {buffer_[4].data(), channels, count}};
    }
    const DeviceGaussians<float>& view() const { return view_; }
    std::size_t bytes() const {
        std::size_t sum = 0;
        for (const auto& b : buffer_) sum += b.bytes();
        return sum;
    }

  private:
    DeviceBuffer<float> buffer_[5];
    DeviceGaussians<float> view_;
};

} // namespace rye::detail
