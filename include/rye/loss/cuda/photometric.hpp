// SPDX-License-Identifier: Apache-2.0
/// rye/loss/cuda/photometric.hpp: the masked L1 term of images in device memory, value and
/// cotangent in one pass. Sums are doubles in fixed chunks of pixels.
#pragma once

#include <string>

#include <rye/backend/cuda.hpp>
#include <rye/loss/photometric.hpp>

namespace rye {

/// Images, channels x pixels; mask: 1 x pixels, or null for 1 everywhere.
struct DeviceImagePair {
    DeviceColumns<const float> a, b, mask = {};
};

/// The masked L1 term of a chunk of pixels, and its cotangent.
struct MaskedL1Kernel {
    static constexpr const char* name = "masked L1";
    static constexpr int threads = 128, blocks = 8;
    static constexpr Index chunk = 1024; ///< pixels
    struct Shared {
        double sum[threads];
    };
    DeviceImagePair images;
    float slope; ///< weight / number of values
    float* g;    ///< added to
    double* partial;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index channels = images.a.rows;
        const Index begin = block.index() * chunk, end = rye::min(begin + chunk, images.a.cols);
        block.each_thread([&](int t) {
            double sum = 0;
            for (Index j = begin + t; j < end; j += threads) {
                const float m = images.mask.data != nullptr ? images.mask.data[j] : 1.0F;
                if (m == 0.0F) continue; // masked pixels may hold NaN
                double pixel = 0;
                for (Index i = j * channels; i < (j + 1) * channels; ++i) {
                    const AbsoluteDifference<float> d(m, images.a.data[i], images.b.data[i]);
                    pixel += static_cast<double>(d.value());
                    g[i] += d.cotangent(m * slope);
                }
                sum += pixel;
            }
            shared.sum[t] = sum;
        });
        for (int apart = threads / 2; apart > 0; apart /= 2)
            block.each_thread([&](int t) {
                if (t < apart) shared.sum[t] += shared.sum[t + apart];
            });
        block.each_thread([&](int t) {
            if (t == 0) partial[block.index()] = shared.sum[0];
        });
    }
};

/// The chunks in their order, times a factor.
struct LossSumKernel {
    static constexpr const char* name = "sum of a loss";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {};
    const double* partial;
    Index chunks;
    double factor;
    float* value;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (t != 0) return;
            double sum = 0;
            for (Index k = 0; k < chunks; ++k) sum += partial[k];
            *value = static_cast<float>(sum * factor);
        });
    }
};

/// As add_masked_l1: mean |mask (a - b)| into `value`, a number in device memory, and `weight`
/// times its cotangent of a added to g (channels x pixels). `partial` has room for a double every
/// 1024 pixels. Throws an Error for shapes that differ.
template <class Device>
void masked_l1_into(const Device& device, const CudaQueue& queue, const DeviceImagePair& images,
                    float weight, const DeviceColumns<float>& g, DeviceBuffer<double>& partial,
                    float* value) {
    const auto shaped = [&](const char* what, Index rows, Index cols, Index want) {
        require(rows == want && cols == images.a.cols, "masked_l1", what, " is ", rows, " x ", cols,
                ", expected ", want, " x ", images.a.cols);
    };
    shaped("second image", images.b.rows, images.b.cols, images.a.rows);
    shaped("gradient", g.rows, g.cols, images.a.rows);
    if (images.mask.data != nullptr) shaped("mask", images.mask.rows, images.mask.cols, 1);
    const Index chunks = (images.a.cols + MaskedL1Kernel::chunk - 1) / MaskedL1Kernel::chunk;
    partial.reserve(queue, static_cast<std::size_t>(chunks) + 1);
    const double share = images.a.size() > 0 ? 1.0 / static_cast<double>(images.a.size()) : 0.0;
    device.launch(
        queue, chunks,
        MaskedL1Kernel{images, weight * static_cast<float>(share), g.data, partial.data()});
    device.launch(queue, 1, LossSumKernel{partial.data(), chunks, share, value});
}

} // namespace rye
