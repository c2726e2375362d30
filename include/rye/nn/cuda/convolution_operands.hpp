// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/convolution_operands.hpp: the weights of a convolution as operands of products of
/// matrices, in the order in which convolution_kernels.hpp copies them.
#pragma once

#include <cstdint>

#include <rye/backend/cuda.hpp>
#include <rye/backend/cuda/unrolled.hpp>

namespace rye::detail {

/// Weights as operands: for every tile of outputs, chunk of inputs and column of taps, 2 halves of
/// the chunk x 3 taps x (outputs / 8) operands of 16 x 8 numbers, of each its planes, of a plane
/// two registers a lane. Element (tap, k, n) is from[first + tap tap_apart + k k_apart + n
/// n_apart].
struct ConvolutionPackJob {
    const float* from;
    Index first, tap_apart, k_apart, n_apart;
    int k_count, n_count, outputs, planes;
    std::uint32_t* to;

    RYE_HD int chunks() const { return (k_count + 31) / 32; }
    RYE_HD int tiles() const { return (n_count + outputs - 1) / outputs; }
    /// Words of one plane.
    RYE_HD Index words() const { return Index(tiles()) * chunks() * 9 * (outputs / 8) * 128; }
    /// Word `word` of each plane; B: a block of the device.
    template <class B>
    RYE_DEVICE void write(Index word) const {
        const Index operand = word / 64;
        const int lane = static_cast<int>(word % 64) / 2, half = static_cast<int>(word % 2);
        const int columns = outputs / 8;
        const int column = static_cast<int>(operand % columns);
        const int down = static_cast<int>(operand / columns % 3);
        const int half_chunk = static_cast<int>(operand / columns / 3 % 2);
        const Index step = operand / (6 * columns);
        const int tap = 3 * down + static_cast<int>(step % 3);
        const int chunk = static_cast<int>(step / 3 % chunks());
        const int tile = static_cast<int>(step / 3 / chunks());
        const int k = chunk * 32 + half_chunk * 16 + lane % 4 * 2 + half * 8;
        const int n = tile * outputs + column * 8 + lane / 4;
        float a = at(tap, k, n), b = at(tap, k + 1, n);
        for (int p = 0; p < planes; ++p) {
            const std::uint32_t both = B::pack(a, b);
            to[(operand * planes + p) * 64 + word % 64] = both;
            a = a - B::low(both);
            b = b - B::high(both);
        }
    }

  private:
    RYE_DEVICE float at(int tap, int k, int n) const {
        return k < k_count && n < n_count
                   ? from[first + tap * tap_apart + k * k_apart + n * n_apart]
                   : 0.0F;
    }
};

/// Several of them at once.
struct ConvolutionPackKernel {
    static constexpr const char* name = "convolution's operands";
    static constexpr int threads = 128, blocks = 8, most = 16; ///< jobs
    struct Shared {};
    ConvolutionPackJob job[most];
    int count = 0;

    RYE_HD static Index blocks_of(const ConvolutionPackJob& j) {
        return (j.words() + threads - 1) / threads;
    }
    Index blocks_of() const {
        Index sum = 0;
        for (int k = 0; k < count; ++k) sum += blocks_of(job[k]);
        return sum;
    }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        Index first = block.index();
        int own = 0;
        for (; first >= blocks_of(job[own]); ++own) first -= blocks_of(job[own]);
        block.each_thread([&](int t) {
            const Index word = first * threads + t;
            if (word < job[own].words()) job[own].write<Block>(word);
        });
    }
};

} // namespace rye::detail
