// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/device.hpp: a device of CUDA: launches of kernels, and the meaning of their
/// text in machine code: a lane's number is a register, a phase ends at a barrier of its block.
/// Under nvcc only. backend/cuda/emulation.hpp is the same for the host.
/// Source: NVIDIA, "PTX ISA", 9.7 (mma, ldmatrix, movmatrix).
#pragma once

#if defined(__CUDACC__)

#include <cuda_runtime.h>

#include <cstdint>
#include <cstring>

#include <rye/backend/cuda/group_products.hpp>
#include <rye/backend/cuda/launch.hpp>
#include <rye/backend/cuda/runtime.hpp>
#include <rye/backend/cuda/unrolled.hpp>

namespace rye {

/// A warp of the device; every function is called by all its lanes.
struct DeviceWarp : detail::DeviceGroups {
    using F = float;
    using U = std::uint32_t;
    using U64 = std::uint64_t;
    using M = bool;
    __device__ static U lane() { return threadIdx.x % 32; }
    __device__ static U lane_here() {
        U r;
        asm volatile("mov.u32 %0, %%laneid;" : "=r"(r));
        return r;
    }
    __device__ static F number(U x) { return static_cast<float>(x); }
    __device__ static F fma(F a, F b, F c) { return __fmaf_rn(a, b, c); }
    __device__ static F saturated(F a, F b, F c) { return __saturatef(__fmaf_rn(a, b, c)); }
    __device__ static F next_below(F a) {
        return a > 0.0F ? __uint_as_float(__float_as_uint(a) - 1U) : -1.0F;
    }
    __device__ static F min(F a, F b) { return fminf(a, b); }
    __device__ static F max(F a, F b) { return fmaxf(a, b); }
    __device__ static F exp2(F a) {
        F r;
        asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(a));
        return r;
    }
    __device__ static F log2(F a) { return log2f(a); }
    __device__ static bool any(M m) { return __any_sync(all_, m); }
    __device__ static void sync() { __syncwarp(); }
    __device__ static std::uint32_t ballot(M m) { return __ballot_sync(all_, m); }
    __device__ static std::uint32_t bits_set(std::uint32_t x) {
        return static_cast<std::uint32_t>(__popc(x));
    }
    __device__ static U below(std::uint32_t lanes) {
        return static_cast<U>(__popc(lanes & ((1U << lane()) - 1U)));
    }
    template <int k, class T>
    __device__ static T quad_up(T a, T other) {
        const T b = __shfl_up_sync(all_, a, k, 4);
        return threadIdx.x % 4 >= k ? b : other;
    }
    template <int k, class T>
    __device__ static T quad_down(T a, T other) {
        const T b = __shfl_down_sync(all_, a, k, 4);
        return threadIdx.x % 4 + k < 4 ? b : other;
    }
    template <int k, class T>
    __device__ static T of_quad(T a) {
        return __shfl_sync(all_, a, k, 4);
    }
    template <int mask, class T>
    __device__ static T across(T a) {
        return __shfl_xor_sync(all_, a, mask);
    }
    template <class T>
    __device__ static T across(T a, int mask) {
        return __shfl_xor_sync(all_, a, mask);
    }
    __device__ static U64 read64_where(M m, const U64* p, U i, U64 other) {
        return m ? p[i] : other;
    }
    template <class T>
    __device__ static auto read(const T* p, U i) {
        if constexpr (std::is_same_v<T, float>)
            return p[i];
        else
            return static_cast<std::uint32_t>(p[i]);
    }
    __device__ static Array<F, 4> read4(const detail::Quad4* p, U i) {
        const detail::Quad4 q = p[i];
        return {{q.x, q.y, q.z, q.w}};
    }
    template <class T, class V>
    __device__ static void write(T* p, U i, V v) {
        p[i] = static_cast<T>(v);
    }
    template <class T, class V>
    __device__ static void write_where(M m, T* p, U i, V v) {
        if (m) p[i] = static_cast<T>(v);
    }
    __device__ static Array<F, 4> read4_where(M m, const detail::Quad4* p, U i) {
        detail::Quad4 q{0, 0, 0, 0};
        if (m) q = p[i];
        return {{q.x, q.y, q.z, q.w}};
    }
    __device__ static void write4_where(M m, detail::Quad4* p, U i, const Array<F, 4>& v) {
        if (m) p[i] = detail::Quad4{v[0], v[1], v[2], v[3]};
    }
    __device__ static void write_word(void* p, U i, U v) { static_cast<std::uint32_t*>(p)[i] = v; }
    __device__ static void write_word_where(M m, void* p, U i, U v) {
        if (m) static_cast<std::uint32_t*>(p)[i] = v;
    }
    __device__ static void set_bit(M m, std::uint32_t* p, U i, U bit) {
        if (m) atomicOr(p + i, 1U << bit);
    }
    template <int half>
    __device__ static U read_half(const std::uint64_t* p, U i) {
        return reinterpret_cast<const std::uint32_t*>(p)[2 * i + half];
    }
    __device__ static void copy4_ahead(M m, detail::Quad4* to, U i, const detail::Quad4* from,
                                       U k) {
#if !defined(__CUDA_ARCH__) || __CUDA_ARCH__ >= 800
        if (m)
            asm volatile("cp.async.cg.shared.global [%0], [%1], 16;" ::"r"(
                             static_cast<U>(__cvta_generic_to_shared(to + i))),
                         "l"(from + k)
                         : "memory");
#else
        if (m) to[i] = from[k];
#endif
    }
    __device__ static void copy_ahead(M m, float* to, U i, const float* from, U k) {
#if !defined(__CUDA_ARCH__) || __CUDA_ARCH__ >= 800
        if (m)
            asm volatile("cp.async.ca.shared.global [%0], [%1], 4;" ::"r"(
                             static_cast<U>(__cvta_generic_to_shared(to + i))),
                         "l"(from + k)
                         : "memory");
#else
        if (m) to[i] = from[k];
#endif
    }
    __device__ static void copy4_or_zero(M m, detail::Quad4* to, U i, const detail::Quad4* from,
                                         U k) {
#if !defined(__CUDA_ARCH__) || __CUDA_ARCH__ >= 800
        asm volatile("cp.async.cg.shared.global [%0], [%1], 16, %2;" ::"r"(
                         static_cast<U>(__cvta_generic_to_shared(to + i))),
                     "l"(from + (m ? k : 0U)), "r"(m ? 16U : 0U)
                     : "memory");
#else
        to[i] = m ? from[k] : detail::Quad4{0, 0, 0, 0};
#endif
    }
    __device__ static void end_copies() {
#if !defined(__CUDA_ARCH__) || __CUDA_ARCH__ >= 800
        asm volatile("cp.async.commit_group;" ::: "memory");
#endif
    }
    template <int newer = 1>
    __device__ static void wait_for_copies() {
#if !defined(__CUDA_ARCH__) || __CUDA_ARCH__ >= 800
        asm volatile("cp.async.wait_group %0;" ::"n"(newer) : "memory");
#endif
        __syncwarp();
    }
    __device__ static std::uint32_t take_one(std::uint32_t* counter) {
        std::uint32_t r = 0;
        if (lane() == 0) r = atomicAdd(counter, 1U);
        return __shfl_sync(all_, r, 0);
    }
    __device__ static Array<F, 2> read2_where(M m, const float* p, U i) {
        float2 v = make_float2(0, 0);
        if (m) v = reinterpret_cast<const float2*>(p)[i];
        return {{v.x, v.y}};
    }
    __device__ static F read_where(M m, const float* p, U i, float other) {
        return m ? p[i] : other;
    }
    __device__ static Array<F, 2> read2(const float* p, U i) {
        const float2 v = reinterpret_cast<const float2*>(p)[i];
        return {{v.x, v.y}};
    }
    __device__ static Array<U, 2> read_words2(const std::uint32_t* p, U i) {
        const uint2 v = reinterpret_cast<const uint2*>(p)[i];
        return {{v.x, v.y}};
    }
    __device__ static void write2(float* p, U i, F a, F b) {
        reinterpret_cast<float2*>(p)[i] = make_float2(a, b);
    }
    __device__ static void write2_where(M m, float* p, U i, F a, F b) {
        if (m) reinterpret_cast<float2*>(p)[i] = make_float2(a, b);
    }
    __device__ static U pack(F a, F b) {
#if !defined(__CUDA_ARCH__) || __CUDA_ARCH__ >= 800
        U r;
        asm("cvt.rn.bf16x2.f32 %0, %1, %2;" : "=r"(r) : "f"(b), "f"(a));
        return r;
#else
        return half(a) | half(b) << 16U;
#endif
    }
    __device__ static F low(U a) { return __uint_as_float(a << 16U); }
    __device__ static F high(U a) { return __uint_as_float(a & 0xFFFF0000U); }
    __device__ static void mma(Array<F, 4>& d, const Array<U, 4>& a, const Array<U, 2>& b) {
#if !defined(__CUDA_ARCH__) || __CUDA_ARCH__ >= 800
        asm("mma.sync.aligned.m16n8k16.row.col.f32.bf16.bf16.f32 "
            "{%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, %3};"
            : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3])
            : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b[0]), "r"(b[1]));
#else
        // Units of matrices before sm_80 know no bf16: the same sums by lanes, which is slow.
#pragma unroll 1
        for (int k = 0; k < 16; ++k) {
            const int from = k % 8 / 2;
            const auto of = [&](U r, int row) {
                const U w = __shfl_sync(all_, r, row * 4 + from);
                return k % 2 == 0 ? low(w) : high(w);
            };
            const int row = static_cast<int>(lane() / 4), col = static_cast<int>(lane() % 4 * 2);
            const F top = of(k < 8 ? a[0] : a[2], row), bottom = of(k < 8 ? a[1] : a[3], row);
            const U own = k < 8 ? b[0] : b[1];
            const F left = of(own, col), right = of(own, col + 1);
            d[0] = fma(top, left, d[0]);
            d[1] = fma(top, right, d[1]);
            d[2] = fma(bottom, left, d[2]);
            d[3] = fma(bottom, right, d[3]);
        }
#endif
    }
    __device__ static U transpose(U a) {
        U r;
        asm("movmatrix.sync.aligned.m8n8.trans.b16 %0, %1;" : "=r"(r) : "r"(a));
        return r;
    }
    template <bool transposed>
    __device__ static Array<U, 4> tiles(const void* from, U offset) {
        const auto at = static_cast<U>(__cvta_generic_to_shared(from)) + offset;
        Array<U, 4> r;
        if constexpr (transposed)
            asm volatile("ldmatrix.sync.aligned.m8n8.x4.trans.shared.b16 {%0, %1, %2, %3}, [%4];"
                         : "=r"(r[0]), "=r"(r[1]), "=r"(r[2]), "=r"(r[3])
                         : "r"(at)
                         : "memory");
        else
            asm volatile("ldmatrix.sync.aligned.m8n8.x4.shared.b16 {%0, %1, %2, %3}, [%4];"
                         : "=r"(r[0]), "=r"(r[1]), "=r"(r[2]), "=r"(r[3])
                         : "r"(at)
                         : "memory");
        return r;
    }

  private:
    static constexpr unsigned all_ = 0xFFFFFFFFU;

    __device__ static U half(F x) {
        const U b = __float_as_uint(x);
        if ((b & 0x7FFFFFFFU) > 0x7F800000U) return 0x7FFFU;
        return (b + 0x7FFFU + (b >> 16U & 1U)) >> 16U;
    }
};

namespace detail {

/// A thread's value from phase to phase: a register of its own.
template <class T>
struct OwnState {
    T value;
    __device__ T& operator[](int) { return value; }
};

} // namespace detail

/// A block of the device.
template <int threads_>
struct DeviceBlock {
    static constexpr int threads = threads_;
    using Warp = DeviceWarp;

    __device__ int index() const { return static_cast<int>(blockIdx.x); }
    template <class F>
    __device__ void each_thread(F&& f) {
        f(static_cast<int>(threadIdx.x));
        __syncthreads();
    }
    template <class F>
    __device__ void each_warp(F&& f) {
        f(static_cast<int>(threadIdx.x) / 32);
        __syncthreads();
    }
    template <class T>
    __device__ T agree(const T& shared) const {
        const T r = shared;
        __syncthreads();
        return r;
    }
    template <class T>
    __device__ detail::OwnState<T> of_threads() const {
        return {};
    }
    template <class T>
    __device__ detail::OwnState<T> of_warps() const {
        return {};
    }
    template <class F>
    __device__ void each_lane(F&& f) {
        f(static_cast<int>(threadIdx.x));
        __syncwarp();
    }
    __device__ static std::uint32_t pack(float a, float b) { return DeviceWarp::pack(a, b); }
    __device__ static float low(std::uint32_t a) { return DeviceWarp::low(a); }
    __device__ static float high(std::uint32_t a) { return DeviceWarp::high(a); }
    __device__ static int bits_set(std::uint32_t x) { return __popc(x); }
    __device__ static int leading_zeros(std::uint64_t x) {
        return __clzll(static_cast<long long>(x));
    }
    template <class T>
    __device__ T exclusive_sums(T* x) {
        __shared__ T of_warp[32];
        const unsigned t = threadIdx.x, lane = t % 32;
        const T own = x[t];
        T sum = own;
        for (unsigned k = 1; k < 32; k *= 2) {
            const T before = __shfl_up_sync(0xFFFFFFFFU, sum, k);
            if (lane >= k) sum += before;
        }
        if (lane == 31) of_warp[t / 32] = sum;
        __syncthreads();
        constexpr unsigned warps = threads / 32;
        T of_warps = lane < warps ? of_warp[lane] : T(0);
        for (unsigned k = 1; k < warps; k *= 2) {
            const T before = __shfl_up_sync(0xFFFFFFFFU, of_warps, k);
            if (lane >= k) of_warps += before;
        }
        const T total = __shfl_sync(0xFFFFFFFFU, of_warps, warps - 1);
        const T before = __shfl_sync(0xFFFFFFFFU, of_warps, (t / 32 + 31) % 32);
        x[t] = (t < 32 ? T(0) : before) + sum - own;
        __syncthreads();
        return total;
    }
    __device__ static std::uint32_t add(std::uint32_t* p, std::uint32_t x) {
        return atomicAdd(p, x);
    }
    __device__ static void raise(std::uint32_t* p, std::uint32_t x) { atomicMax(p, x); }
    __device__ static std::uint32_t read_once(const std::uint32_t* p) { return __ldcs(p); }
    __device__ static void write_once(std::uint32_t* p, std::uint32_t x) { __stcs(p, x); }
};

namespace detail {

template <class Kernel, std::size_t = sizeof(Kernel)> // which tests/cuda/programs.sh reads
__global__ void __launch_bounds__(Kernel::threads, Kernel::blocks)
    run_kernel(const __grid_constant__ Kernel kernel) {
    extern __shared__ __align__(16) unsigned char shared_memory[];
    DeviceBlock<Kernel::threads> block;
    meet_neighbours<Kernel>();
    if constexpr (has_code<Kernel>)
        kernel(block, *reinterpret_cast<typename Kernel::Shared*>(shared_memory));
}

} // namespace detail

/// The device that is current for the calling thread.
struct CudaDevice {
    using Graph = CudaGraph;
    using Branch = CudaBranch;

    template <class Kernel>
    void launch(const CudaQueue& queue, Index blocks, const Kernel& kernel) const {
        if (blocks <= 0 || queue.idle) return;
        detail::start(detail::run_kernel<Kernel>, kernel, static_cast<unsigned>(blocks),
                      queue.stream);
    }
    void fill(const CudaQueue& queue, void* p, int byte, std::size_t bytes) const {
        if (bytes > 0 && !queue.idle)
            check_cuda(cudaMemsetAsync(p, byte, bytes, queue.stream), "device memory");
    }
    void send(const CudaQueue& queue, void* to, const void* from, std::size_t bytes) const {
        send_later(queue, to, from, bytes);
        if (!queue.idle) check_cuda(cudaStreamSynchronize(queue.stream), "device memory");
    }
    void send_later(const CudaQueue& queue, void* to, const void* from, std::size_t bytes) const {
        if (queue.idle) return;
        check_cuda(cudaMemcpyAsync(to, from, bytes, cudaMemcpyHostToDevice, queue.stream),
                   "device memory");
    }
    void fetch(const CudaQueue& queue, void* to, const void* from, std::size_t bytes) const {
        if (queue.idle) return static_cast<void>(std::memset(to, 0, bytes));
        check_cuda(cudaMemcpyAsync(to, from, bytes, cudaMemcpyDeviceToHost, queue.stream),
                   "device memory");
        check_cuda(cudaStreamSynchronize(queue.stream), "device memory");
    }
};

} // namespace rye

#endif
