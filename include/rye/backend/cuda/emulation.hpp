// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/emulation.hpp: a device of the host: the same kernels, a warp being an array of
/// 32 lanes, a block its phases between barriers. Within a phase, threads and warps run in turn: in
/// order, in reverse or shuffled, so that a barrier that is missing shows. Shared memory begins as
/// NaN. It is slow, and for tests.
/// Layouts of matrices over lanes are those of the PTX manual ("Warp-level matrix instructions").
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include <rye/backend/cuda.hpp>
#include <rye/backend/cuda/host_copies.hpp>
#include <rye/backend/cuda/host_groups.hpp>
#include <rye/backend/cuda/unrolled.hpp>
#include <rye/backend/cuda/warp_lanes.hpp>

namespace rye {

/// A warp of the host: the functions of backend/cuda/device.hpp's.
struct HostWarp : detail::HostCopies, detail::HostGroups {
    using F = Lanes<float>;
    using U = Lanes<std::uint32_t>;
    using U64 = Lanes<std::uint64_t>;
    using M = Lanes<bool>;

    static U lane() {
        return U::each([](int l) { return static_cast<std::uint32_t>(l); });
    }
    /// Returns the same for rare uses: it is not kept in registers through loops.
    static U lane_here() { return lane(); }
    static F number(const U& x) { return F(x); }
    static F fma(const F& a, const F& b, const F& c) {
        return F::each([&](int l) { return std::fma(a.x[l], b.x[l], c.x[l]); });
    }
    /// Returns a b + c between 0 and 1; and the number before a, or -1 if a is not positive.
    static F saturated(const F& a, const F& b, const F& c) {
        return F::each([&](int l) {
            return std::fmin(std::fmax(std::fma(a.x[l], b.x[l], c.x[l]), 0.0F), 1.0F);
        });
    }
    static F next_below(const F& a) {
        return F::each([&](int l) { return a.x[l] > 0 ? std::nextafter(a.x[l], 0.0F) : -1.0F; });
    }
    static F min(const F& a, const F& b) {
        return F::each([&](int l) { return std::fmin(a.x[l], b.x[l]); });
    }
    static F max(const F& a, const F& b) {
        return F::each([&](int l) { return std::fmax(a.x[l], b.x[l]); });
    }
    static F exp2(const F& a) {
        return F::each([&](int l) { return a.x[l] < -126 ? 0.0F : std::exp2(a.x[l]); });
    }
    static F log2(const F& a) {
        return F::each([&](int l) { return std::log2(a.x[l]); });
    }
    static bool any(const M& m) {
        bool r = false;
        for (const bool b : m.x) r = r || b;
        return r;
    }
    static void sync() {}
    /// Returns a bit for each lane.
    static std::uint32_t ballot(const M& m) {
        std::uint32_t r = 0;
        for (int l = 0; l < 32; ++l) r |= m.x[l] ? 1U << l : 0U;
        return r;
    }
    static std::uint32_t bits_set(std::uint32_t x) {
        return static_cast<std::uint32_t>(std::popcount(x));
    }
    /// Returns for each lane the number of these lanes before it.
    static U below(std::uint32_t lanes) {
        return U::each([&](int l) {
            return static_cast<std::uint32_t>(std::popcount(lanes & ((1U << l) - 1U)));
        });
    }

    /// Returns the value of the lane `k` before, or after, within four lanes; else `other`.
    template <int k, class T>
    static Lanes<T> quad_up(const Lanes<T>& a, T other) {
        return Lanes<T>::each([&](int l) { return l % 4 >= k ? a.x[l - k] : other; });
    }
    template <int k, class T>
    static Lanes<T> quad_down(const Lanes<T>& a, T other) {
        return Lanes<T>::each([&](int l) { return l % 4 + k < 4 ? a.x[l + k] : other; });
    }
    /// Returns the value of lane k of each four.
    template <int k, class T>
    static Lanes<T> of_quad(const Lanes<T>& a) {
        return Lanes<T>::each([&](int l) { return a.x[l / 4 * 4 + k]; });
    }
    template <int mask, class T>
    static Lanes<T> across(const Lanes<T>& a) {
        return Lanes<T>::each([&](int l) { return a.x[l ^ mask]; });
    }

    template <class T>
    static Lanes<T> across(const Lanes<T>& a, int mask) {
        return Lanes<T>::each([&](int l) { return a.x[l ^ mask]; });
    }
    static U64 read64_where(const M& m, const std::uint64_t* p, const U& i, std::uint64_t other) {
        return U64::each([&](int l) { return m.x[l] ? p[i.x[l]] : other; });
    }

    template <class T>
    static auto read(const T* p, const U& i) {
        using V = std::conditional_t<std::is_same_v<T, float>, float, std::uint32_t>;
        return Lanes<V>::each([&](int l) { return static_cast<V>(p[i.x[l]]); });
    }
    /// Returns the numbers 4 i ... 4 i + 3.
    static Array<F, 4> read4(const detail::Quad4* p, const U& i) {
        return {{F::each([&](int l) { return p[i.x[l]].x; }),
                 F::each([&](int l) { return p[i.x[l]].y; }),
                 F::each([&](int l) { return p[i.x[l]].z; }),
                 F::each([&](int l) { return p[i.x[l]].w; })}};
    }
    template <class T, class V>
    static void write(T* p, const U& i, const Lanes<V>& v) {
        for (int l = 0; l < 32; ++l) p[i.x[l]] = static_cast<T>(v.x[l]);
    }
    template <class T, class V>
    static void write_where(const M& m, T* p, const U& i, const Lanes<V>& v) {
        for (int l = 0; l < 32; ++l)
            if (m.x[l]) p[i.x[l]] = static_cast<T>(v.x[l]);
    }
    /// Returns the numbers 4 i ... 4 i + 3 where the mask holds; elsewhere 0.
    static Array<F, 4> read4_where(const M& m, const detail::Quad4* p, const U& i) {
        const U at = select(m, i, U(0));
        Array<F, 4> r;
        for (int l = 0; l < 32; ++l) {
            const detail::Quad4 q = m.x[l] ? p[at.x[l]] : detail::Quad4{0, 0, 0, 0};
            r[0].x[l] = q.x, r[1].x[l] = q.y, r[2].x[l] = q.z, r[3].x[l] = q.w;
        }
        return r;
    }
    static void write4_where(const M& m, detail::Quad4* p, const U& i, const Array<F, 4>& v) {
        for (int l = 0; l < 32; ++l)
            if (m.x[l]) p[i.x[l]] = {v[0].x[l], v[1].x[l], v[2].x[l], v[3].x[l]};
    }
    /// Writes bytes 4 i ... 4 i + 3.
    static void write_word(void* p, const U& i, const U& v) {
        for (int l = 0; l < 32; ++l)
            std::memcpy(static_cast<unsigned char*>(p) + 4 * i.x[l], &v.x[l], 4);
    }
    static void write_word_where(const M& m, void* p, const U& i, const U& v) {
        for (int l = 0; l < 32; ++l)
            if (m.x[l]) std::memcpy(static_cast<unsigned char*>(p) + 4 * i.x[l], &v.x[l], 4);
    }
    /// Sets a bit of each lane's number; several warps may at once.
    static void set_bit(const M& m, std::uint32_t* p, const U& i, const U& bit) {
        for (int l = 0; l < 32; ++l)
            if (m.x[l]) p[i.x[l]] |= 1U << bit.x[l];
    }
    /// Returns the low or the high half of each lane's number.
    template <int half>
    static U read_half(const std::uint64_t* p, const U& i) {
        return U::each([&](int l) { return static_cast<std::uint32_t>(p[i.x[l]] >> (32 * half)); });
    }
    /// Takes one from a counter, for the warp.
    static std::uint32_t take_one(std::uint32_t* counter) { return (*counter)++; }
    static F read_where(const M& m, const float* p, const U& i, float other) {
        return F::each([&](int l) { return m.x[l] ? p[i.x[l]] : other; });
    }
    /// Returns the numbers 2 i and 2 i + 1, 8 bytes at once; 0 where the mask does not hold.
    static Array<F, 2> read2_where(const M& m, const float* p, const U& i) {
        return {{F::each([&](int l) { return m.x[l] ? p[2 * i.x[l]] : 0.0F; }),
                 F::each([&](int l) { return m.x[l] ? p[2 * i.x[l] + 1] : 0.0F; })}};
    }
    static Array<F, 2> read2(const float* p, const U& i) {
        return {{F::each([&](int l) { return p[2 * i.x[l]]; }),
                 F::each([&](int l) { return p[2 * i.x[l] + 1]; })}};
    }
    static Array<U, 2> read_words2(const std::uint32_t* p, const U& i) {
        return {{U::each([&](int l) { return p[2 * i.x[l]]; }),
                 U::each([&](int l) { return p[2 * i.x[l] + 1]; })}};
    }
    static void write2(float* p, const U& i, const F& a, const F& b) {
        for (int l = 0; l < 32; ++l) p[2 * i.x[l]] = a.x[l], p[2 * i.x[l] + 1] = b.x[l];
    }

    static void write2_where(const M& m, float* p, const U& i, const F& a, const F& b) {
        for (int l = 0; l < 32; ++l)
            if (m.x[l]) p[2 * i.x[l]] = a.x[l], p[2 * i.x[l] + 1] = b.x[l];
    }

    /// Two numbers as bf16, the first in the low half; and back.
    static U pack(const F& a, const F& b) {
        return U::each([&](int l) { return half(a.x[l]) | half(b.x[l]) << 16U; });
    }
    static F low(const U& a) {
        return F::each([&](int l) { return whole(a.x[l] & 0xFFFFU); });
    }
    static F high(const U& a) {
        return F::each([&](int l) { return whole(a.x[l] >> 16U); });
    }

    /// d += a b, of 16 x 16 and 16 x 8 bf16.
    static void mma(Array<F, 4>& d, const Array<U, 4>& a, const Array<U, 2>& b) {
        const auto at = [](const U& r, int lane, int k) {
            return whole(k % 2 == 0 ? r.x[lane] & 0xFFFFU : r.x[lane] >> 16U);
        };
        for (int l = 0; l < 32; ++l)
            for (int i = 0; i < 4; ++i) {
                const int row = l / 4 + i / 2 * 8, col = l % 4 * 2 + i % 2;
                double sum = static_cast<double>(d[std::size_t(i)].x[l]);
                for (int k = 0; k < 16; ++k) {
                    const int word = k % 8 / 2;
                    const auto ra = static_cast<std::size_t>(k / 8 * 2 + row / 8);
                    sum += static_cast<double>(at(a[ra], row % 8 * 4 + word, k)) *
                           static_cast<double>(at(b[std::size_t(k) / 8], col * 4 + word, k));
                }
                d[std::size_t(i)].x[l] = static_cast<float>(sum);
            }
    }
    /// Returns the transpose of 8 x 8 halves, of which each lane has two neighbours of a row.
    static U transpose(const U& a) {
        return U::each([&](int l) {
            const int r = l / 4, c = l % 4 * 2;
            const auto at = [&](int row, int col) {
                const std::uint32_t w = a.x[row * 4 + col / 2];
                return col % 2 == 0 ? w & 0xFFFFU : w >> 16U;
            };
            return at(c, r) | at(c + 1, r) << 16U;
        });
    }
    /// Four tiles of 8 x 8 halves; lane 8 i + r knows where row r of tile i begins [bytes].
    template <bool transposed>
    static Array<U, 4> tiles(const void* from, const U& offset) {
        Array<U, 4> r;
        const auto* const bytes = static_cast<const unsigned char*>(from);
        for (int i = 0; i < 4; ++i) {
            const U t = U::each([&](int l) {
                std::uint32_t w;
                std::memcpy(&w, bytes + offset.x[8 * i + l / 4] + 4 * (l % 4), 4);
                return w;
            });
            r[std::size_t(i)] = transposed ? transpose(t) : t;
        }
        return r;
    }

  private:
    static std::uint32_t half(float x) {
        const auto b = std::bit_cast<std::uint32_t>(x);
        if ((b & 0x7FFFFFFFU) > 0x7F800000U) return 0x7FFFU;
        return (b + 0x7FFFU + (b >> 16U & 1U)) >> 16U;
    }
    static float whole(std::uint32_t h) { return std::bit_cast<float>(h << 16U); }
};

/// The order in which threads and warps of a phase run.
enum class PhaseOrder { forward, backward, shuffled };

/// A block of the host.
template <int threads_>
class HostBlock {
  public:
    static constexpr int threads = threads_;
    using Warp = HostWarp;

    HostBlock(int index, PhaseOrder order) : index_(index), order_(order) {}

    int index() const { return index_; }
    template <class F>
    void each_thread(F&& f) {
        in_order(threads, f);
    }
    template <class F>
    void each_warp(F&& f) {
        in_order(threads / 32, f);
    }
    /// Returns a number of shared memory that all threads take, before any goes on to change it.
    template <class T>
    T agree(const T& shared) const {
        return shared;
    }
    /// Returns the values of threads, or of warps, from phase to phase.
    template <class T>
    auto of_threads() const {
        return std::vector<T>(static_cast<std::size_t>(threads));
    }
    template <class T>
    auto of_warps() const {
        return std::vector<T>(static_cast<std::size_t>(threads / 32));
    }
    /// Runs a phase of threads that wait for those of their own warp only.
    template <class F>
    void each_lane(F&& f) {
        in_order(threads, f);
    }
    static std::uint32_t pack(float a, float b) {
        return HostWarp::pack(Lanes<float>(a), Lanes<float>(b)).x[0];
    }
    static float low(std::uint32_t a) { return HostWarp::low(Lanes<std::uint32_t>(a)).x[0]; }
    static float high(std::uint32_t a) { return HostWarp::high(Lanes<std::uint32_t>(a)).x[0]; }
    static int bits_set(std::uint32_t x) { return std::popcount(x); }
    static int leading_zeros(std::uint64_t x) { return std::countl_zero(x); }
    /// Replaces each of the block's numbers by the sum of those before it; returns the sum of all.
    template <class T>
    T exclusive_sums(T* x) {
        T sum = 0;
        for (int t = 0; t < threads; ++t) {
            const T own = x[t];
            x[t] = sum;
            sum += own;
        }
        return sum;
    }
    template <class T>
    static T add(T* p, T x) {
        const T before = *p;
        *p = before + x;
        return before;
    }
    template <class T>
    static void raise(T* p, T x) {
        if (*p < x) *p = x;
    }
    /// Reads or writes what this kernel does not touch again: on a device, past its cache.
    static std::uint32_t read_once(const std::uint32_t* p) { return *p; }
    static void write_once(std::uint32_t* p, std::uint32_t x) { *p = x; }

  private:
    template <class F>
    void in_order(int n, F& f) {
        ++phase_;
        for (int k = 0; k < n; ++k) {
            int at = k;
            if (order_ == PhaseOrder::backward) at = n - 1 - k;
            if (order_ == PhaseOrder::shuffled) // n is a power of two: a bijection
                at = static_cast<int>((static_cast<unsigned>(k) * 5U + phase_ * 7U) %
                                      static_cast<unsigned>(n));
            f(at);
        }
    }

    int index_;
    PhaseOrder order_;
    unsigned phase_ = 0;
};

/// The device of the host: memory is the host's, and all is done when a call returns.
struct EmulatedDevice {
    PhaseOrder order = PhaseOrder::forward;
    int processors_of_groups = 0; ///< 0: without kernels of groups

    template <class Kernel>
    void launch(const CudaQueue& queue, Index blocks, const Kernel& kernel) const {
        if (queue.idle) return;
        using Shared = typename Kernel::Shared;
        const auto shared = std::make_unique<Shared>();
        for (Index b = 0; b < blocks; ++b) {
            const Index at = order == PhaseOrder::forward ? b : blocks - 1 - b;
            std::memset(static_cast<void*>(shared.get()), 0xFF, sizeof(Shared));
            HostBlock<Kernel::threads> block(static_cast<int>(at), order);
            kernel(block, *shared);
            HostWarp::forget_copies();
        }
    }
    void fill(const CudaQueue& queue, void* p, int byte, std::size_t bytes) const {
        if (bytes > 0 && !queue.idle) std::memset(p, byte, bytes);
    }
    /// Copies to the device, and waits for that.
    void send(const CudaQueue& queue, void* to, const void* from, std::size_t bytes) const {
        if (bytes > 0 && !queue.idle) std::memcpy(to, from, bytes);
    }
    /// Puts a copy of page-locked memory on the stream, which must stay as it is until then.
    void send_later(const CudaQueue& queue, void* to, const void* from, std::size_t bytes) const {
        send(queue, to, from, bytes);
    }
    /// Copies from the device, and waits for that.
    void fetch(const CudaQueue& queue, void* to, const void* from, std::size_t bytes) const {
        if (queue.idle)
            std::memset(to, 0, bytes);
        else if (bytes > 0)
            std::memcpy(to, from, bytes);
    }
};

/// Returns the processors of a device with kernels of groups, else 0.
inline int processors_of_groups(const EmulatedDevice& d) { return d.processors_of_groups; }

/// Memory of the host as device memory.
struct HostMemory {
    void* allocate(std::size_t bytes, CudaStream) {
        return ::operator new(bytes, std::align_val_t(256));
    }
    void release(void* p, CudaStream) { ::operator delete(p, std::align_val_t(256)); }
};

} // namespace rye
