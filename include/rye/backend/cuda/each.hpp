// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/each.hpp: kernels of a function of an index: a thread for each index, and sums
/// over all of them in a fixed order. The function is a struct with a name and an operator(); or
/// with read(i) and write(i, what was read), of which a thread does `at_once` indices, all reads
/// first: for little work on long arrays, where a block of a number a thread ends too soon.
#pragma once

#include <cstdint>

#include <rye/backend/cuda.hpp>
#include <rye/backend/cuda/unrolled.hpp>

namespace rye {

namespace detail {

/// True if f's reads and writes are apart.
template <class F>
concept ReadsFirst = requires(const F& f, Index i) { f.write(i, f.read(i)); };

/// f(i) for i in [0, count).
template <class F>
struct EachKernel {
    static constexpr const char* name = F::name;
    static constexpr int threads = 128, blocks = 8, at_once = ReadsFirst<F> ? 4 : 1;
    struct Shared {};
    F f;
    Index count;

    static Index blocks_of(Index count) {
        return (count + threads * at_once - 1) / (threads * at_once);
    }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index first = Index(block.index()) * (threads * at_once) + t;
            if constexpr (ReadsFirst<F>) {
                if (first + (at_once - 1) * threads < count) return several(first);
                for (Index i = first; i < count; i += threads) f.write(i, f.read(i));
            } else if (first < count) {
                f(first);
            }
        });
    }

  private:
    RYE_DEVICE void several(Index first) const {
        const auto a = f.read(first), b = f.read(first + threads);
        const auto c = f.read(first + 2 * threads), d = f.read(first + 3 * threads);
        f.write(first, a);
        f.write(first + threads, b);
        f.write(first + 2 * threads, c);
        f.write(first + 3 * threads, d);
    }
};

} // namespace detail

/// Puts f(i), for i in [0, count), on the stream: in any order, at once.
template <class Device, class F>
void launch_each(const Device& device, const CudaQueue& queue, Index count, const F& f) {
    using Kernel = detail::EachKernel<F>;
    device.launch(queue, Kernel::blocks_of(count), Kernel{f, count});
}

namespace detail {

/// Sums of F::sums numbers over blocks of indices: f(i, sum) adds those of index i. Threads add in
/// pairs, so that rounding grows with the logarithm of their number.
template <class F>
struct SumsKernel {
    static constexpr const char* name = F::name;
    static constexpr int threads = 128, blocks = 4;
    static constexpr int sums = F::sums;
    struct Shared {
        float sum[std::size_t(sums)][threads];
    };
    F f;
    Index count;
    float* partial; ///< sums x blocks

    static Index blocks_of(Index count) { return (count + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        block.each_thread([&](int t) {
            const Index i = Index(block.index()) * threads + t;
            Array<float, std::size_t(sums)> own;
            for (int k = 0; k < sums; ++k) own[std::size_t(k)] = 0.0F;
            if (i < count) f(i, own);
            for (int k = 0; k < sums; ++k) shared.sum[k][t] = own[std::size_t(k)];
        });
        for (int apart = threads / 2; apart > 0; apart /= 2)
            block.each_thread([&](int t) {
                for (int at = t; at < sums * apart; at += threads)
                    shared.sum[at / apart][at % apart] +=
                        shared.sum[at / apart][at % apart + apart];
            });
        block.each_thread([&](int t) {
            if (t < sums) partial[Index(block.index()) * sums + t] = shared.sum[t][0];
        });
    }
};

/// Adds the blocks' sums, in their order, in double.
struct MergeSumsKernel {
    static constexpr const char* name = "merge of sums";
    static constexpr int threads = 256, blocks = 1;
    static constexpr int most = 32, ways = threads / most; ///< sums; parts that add at once
    struct Shared {
        double part[most][ways];
    };
    const float* partial; ///< sums x blocks
    Index count;          ///< blocks
    int sums;
    bool again; ///< true to add to the present values
    float* to;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        block.each_thread([&](int t) {
            const int k = t / ways, way = t % ways;
            double sum = 0;
            if (k < sums)
                for (Index b = way; b < count; b += ways)
                    sum += static_cast<double>(partial[b * sums + k]);
            shared.part[k][way] = sum;
        });
        block.each_thread([&](int t) {
            if (t >= sums) return;
            double sum = again ? static_cast<double>(to[t]) : 0.0;
            for (int way = 0; way < ways; ++way) sum += shared.part[t][way];
            to[t] = static_cast<float>(sum);
        });
    }
};

/// Destination of sums: F::sums numbers in device memory, which they replace, or add to.
struct SumsTo {
    float* numbers;
    bool again = false;
};

/// A function of an index that could add to sums, and has none to add to.
template <class F>
struct WithoutSums {
    static constexpr const char* name = F::name;
    struct None {};
    F f;
    RYE_DEVICE void operator()(Index i) const {
        None none;
        f(i, none);
    }
};

} // namespace detail

/// Sums on a device, and the memory that they need meanwhile.
template <class Device>
class DeviceSums {
  public:
    explicit DeviceSums(const Device& device) : device_(device) {}

    /// Puts f over [0, count) on the stream, and its sums: F::sums numbers, at most 32, or none.
    template <class F>
    void launch(const CudaQueue& queue, Index count, const F& f, const detail::SumsTo& to) {
        static_assert(F::sums >= 0 && F::sums <= detail::MergeSumsKernel::most);
        if constexpr (F::sums == 0) {
            launch_each(device_, queue, count, detail::WithoutSums<F>{f});
        } else {
            using Kernel = detail::SumsKernel<F>;
            const Index blocks = Kernel::blocks_of(count);
            partial_.reserve(queue, static_cast<std::size_t>(blocks) * F::sums + 1);
            device_.launch(queue, blocks, Kernel{f, count, partial_.data()});
            device_.launch(
                queue, 1,
                detail::MergeSumsKernel{partial_.data(), blocks, F::sums, to.again, to.numbers});
        }
    }
    std::size_t bytes() const { return partial_.bytes(); }

  private:
    Device device_;
    DeviceBuffer<float> partial_;
};

namespace detail {

/// to[i] = from[i], between arrays of the device.
struct CopyNumbers {
    static constexpr const char* name = "copy";
    const float* from;
    float* to;
    RYE_DEVICE float read(Index i) const { return from[i]; }
    RYE_DEVICE void write(Index i, float x) const { to[i] = x; }
};

/// to[i] += from[i].
struct AddNumbers {
    static constexpr const char* name = "sum of arrays";
    const float* from;
    float* to;
    RYE_DEVICE float read(Index i) const { return to[i] + from[i]; }
    RYE_DEVICE void write(Index i, float x) const { to[i] = x; }
};

} // namespace detail

} // namespace rye
