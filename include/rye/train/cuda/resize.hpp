// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/resize.hpp: the random scale of train/augment.hpp for pictures in device memory:
/// each pixel takes that of the source, or 1 for none; and its vjp, which gathers. The resizing is
/// read on the device, so that a captured step may change it.
#pragma once

#include <rye/loss/cuda/terms.hpp>
#include <rye/train/augment.hpp>

namespace rye {

namespace detail {

/// Returns the value that stands for 1 in a picture.
template <class P>
RYE_HD P unit_of() {
    return std::is_same_v<P, float> ? P(1) : P(255);
}

/// Resizes a picture.
template <class P>
struct ResizeKernel {
    static constexpr const char* name = "resized picture";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {};
    DeviceColumns<const P> from;
    const detail::Resizing* resizing; ///< in device memory
    int factor;                       ///< picture size over the resizing's size
    P* to;

    Index blocks_of() const { return (from.rows * from.cols + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index i = Index(block.index()) * threads + t;
            if (i >= from.rows * from.cols) return;
            const detail::Resizing& r = *resizing;
            const int width = r.size.width * factor, height = r.size.height * factor;
            const Index pixel = i / from.rows, c = i % from.rows;
            const Index x = detail::resized_source(static_cast<int>(pixel % width), r.dx * factor,
                                                   r.resized.width * factor, width);
            const Index y = detail::resized_source(static_cast<int>(pixel / width), r.dy * factor,
                                                   r.resized.height * factor, height);
            to[i] =
                x < 0 || y < 0 ? detail::unit_of<P>() : from.data[(y * width + x) * from.rows + c];
        });
    }
};

/// Accumulates the cotangent of the source.
struct ResizeVjpKernel {
    static constexpr const char* name = "gradient of a resized picture";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {};
    DeviceColumns<const float> g;
    const detail::Resizing* resizing;
    float* to;

    Index blocks_of() const { return (g.rows * g.cols + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index i = Index(block.index()) * threads + t;
            if (i >= g.rows * g.cols) return;
            const detail::Resizing& r = *resizing;
            const Index pixel = i / g.rows, c = i % g.rows;
            const int width = r.size.width, x = static_cast<int>(pixel % width),
                      y = static_cast<int>(pixel / width);
            const auto across = detail::resized_range(x, r.dx, r.resized.width, width);
            const auto down = detail::resized_range(y, r.dy, r.resized.height, r.size.height);
            float sum = to[i];
            for (int v = down.begin; v < down.end; ++v)
                for (int u = across.begin; u < across.end; ++u)
                    sum += g.data[(Index(v) * width + u) * g.rows + c];
            to[i] = sum;
        });
    }
};

} // namespace detail

/// Writes `to`, of the shape of `from`: `factor` times the size of the resizing, which is in device
/// memory.
template <class Device, class P>
void resize_into(const Device& device, const CudaQueue& queue,
                 const detail::ResizeKernel<P>& kernel) {
    device.launch(queue, kernel.blocks_of(), kernel);
}
/// Adds to `to` the cotangent of the source of a resizing without a factor, of the shape of `g`.
template <class Device>
void resize_vjp_into(const Device& device, const CudaQueue& queue,
                     const detail::ResizeVjpKernel& kernel) {
    device.launch(queue, kernel.blocks_of(), kernel);
}

} // namespace rye
