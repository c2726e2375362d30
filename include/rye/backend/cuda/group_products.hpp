// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/group_products.hpp: products of matrices by a warpgroup, here a group, on
/// units of bf16, and copies of many bytes at once to shared memory, of sm_90a alone. A warp of a
/// group has 16 of the 64 rows of sums; its registers are laid out as those of planes.hpp, 16 rows
/// by 8 columns after another. Under nvcc only; host_groups.hpp is the same for the host.
/// Source: NVIDIA, "PTX ISA", 9.7.15 (wgmma), 9.7.9.25 (cp.async.bulk), 9.7.13.15 (mbarrier).
#pragma once

#if defined(__CUDACC__)

#include <cuda_runtime.h>

#include <cstdint>
#include <type_traits>

#include <rye/backend/cuda/ring_memory.hpp>
#include <rye/backend/cuda/unrolled.hpp>

namespace rye::detail {

/// True for kernels whose products are of groups.
template <class Kernel>
concept OfGroups = requires {
    Kernel::of_groups;
};

/// True where a kernel has machine code: those of groups have it on sm_90a alone.
template <class Kernel>
inline constexpr bool has_code =
#if defined(__CUDA_ARCH__) && !defined(__CUDA_ARCH_FEAT_SM90_ALL)
    !OfGroups<Kernel>;
#else
    true;
#endif

/// The shared memory of a kernel that is never launched tells whether the code that the current
/// device would run has products of groups.
template <class Kernel>
__global__ void group_probe(int* out) {
    __shared__ int size[has_code<Kernel> ? 64 : 32];
    size[threadIdx.x % 32] = static_cast<int>(threadIdx.x);
    __syncthreads();
    if (out != nullptr) *out = size[(threadIdx.x + 1) % 32];
}
template <class = void>
struct GroupProbe {
    static constexpr bool of_groups = true;

    /// Returns the number of multiprocessors of the current device if the program has code for it
    /// with products of groups, else 0.
    static int processors() {
        int device = 0, count = 0;
        cudaFuncAttributes found{};
        if (cudaGetDevice(&device) == cudaSuccess &&
            cudaFuncGetAttributes(&found, group_probe<GroupProbe>) == cudaSuccess &&
            found.sharedSizeBytes >= 64 * sizeof(int) &&
            cudaDeviceGetAttribute(&count, cudaDevAttrMultiProcessorCount, device) == cudaSuccess)
            return count;
        static_cast<void>(cudaGetLastError());
        return 0;
    }
};

/// What a warp of a group does. Operands in shared memory are of tiles of 8 x 8 bf16, 128 bytes.
struct DeviceGroups {
    using F = float;
    using U = std::uint32_t;
    /// An operand in shared memory: 8 rows, or columns, and the next 8 are `along` bytes apart, 8
    /// numbers along K and the next 8 `deep` bytes.
    using Operand = std::uint64_t;

    __device__ static Operand operand(const void* at, int along, int deep) {
        const auto bits = [](std::uint32_t x) { return std::uint64_t((x & 0x3FFFFU) >> 4U); };
        return bits(static_cast<U>(__cvta_generic_to_shared(at))) |
               bits(static_cast<U>(deep)) << 16U | bits(static_cast<U>(along)) << 32U;
    }
    /// The operand that begins so many bytes later, a multiple of 16.
    __device__ static Operand moved(Operand o, int bytes) {
        return o + static_cast<std::uint64_t>(bytes / 16);
    }
    /// Before products: registers are as they are now.
    __device__ static void begin_products() {
        asm volatile("wgmma.fence.sync.aligned;" ::: "memory");
    }
    /// Ends a batch of products; waits for all but the last `newer` batches.
    __device__ static void end_products() {
        asm volatile("wgmma.commit_group.sync.aligned;" ::: "memory");
    }
    template <int newer = 0>
    __device__ static void wait_for_products() {
        asm volatile("wgmma.wait_group.sync.aligned %0;" ::"n"(newer) : "memory");
    }
    /// After that: nobody reads sums before.
    template <std::size_t count>
    __device__ static void settle(Array<F, count>& d) {
        expanded<int(count)>([&](auto i) { asm volatile("" : "+f"(d[i])::"memory"); });
    }

    /// d += a b, or with `onto` false d = a b, of 64 x 16 and 16 x n numbers; in shared memory
    /// numbers along K are neighbours, or with `transposed` those along n.
    template <int n, bool onto, bool transposed>
    __device__ static void product(Array<F, std::size_t(n / 2)>& d, const Array<U, 4>& a,
                                   Operand b) {
#if defined(__CUDA_ARCH_FEAT_SM90_ALL)
        static_assert(n == 16 || n == 32 || n == 64 || n == 128);
        if constexpr (n == 16)
            asm volatile(
                "{ .reg .pred p; setp.ne.b32 p, %13, 0; "
                "wgmma.mma_async.sync.aligned.m64n16k16.f32.bf16.bf16 {%0, %1, %2, %3, %4, "
                "%5, %6, %7}, {%8, %9, %10, %11}, %12, p, 1, 1, %14; }"
                : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3]), "+f"(d[4]), "+f"(d[5]),
                  "+f"(d[6]), "+f"(d[7])
                : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "l"(b), "n"(onto), "n"(transposed));
        else if constexpr (n == 32)
            asm volatile(
                "{ .reg .pred p; setp.ne.b32 p, %21, 0; "
                "wgmma.mma_async.sync.aligned.m64n32k16.f32.bf16.bf16 {%0, %1, %2, %3, %4, "
                "%5, %6, %7, %8, %9, %10, %11, %12, %13, %14, %15}, {%16, %17, %18, %19}, "
                "%20, p, 1, 1, %22; }"
                : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3]), "+f"(d[4]), "+f"(d[5]),
                  "+f"(d[6]), "+f"(d[7]), "+f"(d[8]), "+f"(d[9]), "+f"(d[10]), "+f"(d[11]),
                  "+f"(d[12]), "+f"(d[13]), "+f"(d[14]), "+f"(d[15])
                : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "l"(b), "n"(onto), "n"(transposed));
        else if constexpr (n == 64)
            asm volatile(
                "{ .reg .pred p; setp.ne.b32 p, %37, 0; "
                "wgmma.mma_async.sync.aligned.m64n64k16.f32.bf16.bf16 {%0, %1, %2, %3, %4, "
                "%5, %6, %7, %8, %9, %10, %11, %12, %13, %14, %15, %16, %17, %18, %19, %20, "
                "%21, %22, %23, %24, %25, %26, %27, %28, %29, %30, %31}, {%32, %33, %34, "
                "%35}, %36, p, 1, 1, %38; }"
                : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3]), "+f"(d[4]), "+f"(d[5]),
                  "+f"(d[6]), "+f"(d[7]), "+f"(d[8]), "+f"(d[9]), "+f"(d[10]), "+f"(d[11]),
                  "+f"(d[12]), "+f"(d[13]), "+f"(d[14]), "+f"(d[15]), "+f"(d[16]), "+f"(d[17]),
                  "+f"(d[18]), "+f"(d[19]), "+f"(d[20]), "+f"(d[21]), "+f"(d[22]), "+f"(d[23]),
                  "+f"(d[24]), "+f"(d[25]), "+f"(d[26]), "+f"(d[27]), "+f"(d[28]), "+f"(d[29]),
                  "+f"(d[30]), "+f"(d[31])
                : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "l"(b), "n"(onto), "n"(transposed));
        else if constexpr (n == 128)
            asm volatile(
                "{ .reg .pred p; setp.ne.b32 p, %69, 0; "
                "wgmma.mma_async.sync.aligned.m64n128k16.f32.bf16.bf16 {%0, %1, %2, %3, %4, "
                "%5, %6, %7, %8, %9, %10, %11, %12, %13, %14, %15, %16, %17, %18, %19, %20, "
                "%21, %22, %23, %24, %25, %26, %27, %28, %29, %30, %31, %32, %33, %34, %35, "
                "%36, %37, %38, %39, %40, %41, %42, %43, %44, %45, %46, %47, %48, %49, %50, "
                "%51, %52, %53, %54, %55, %56, %57, %58, %59, %60, %61, %62, %63}, {%64, %65, "
                "%66, %67}, %68, p, 1, 1, %70; }"
                : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3]), "+f"(d[4]), "+f"(d[5]),
                  "+f"(d[6]), "+f"(d[7]), "+f"(d[8]), "+f"(d[9]), "+f"(d[10]), "+f"(d[11]),
                  "+f"(d[12]), "+f"(d[13]), "+f"(d[14]), "+f"(d[15]), "+f"(d[16]), "+f"(d[17]),
                  "+f"(d[18]), "+f"(d[19]), "+f"(d[20]), "+f"(d[21]), "+f"(d[22]), "+f"(d[23]),
                  "+f"(d[24]), "+f"(d[25]), "+f"(d[26]), "+f"(d[27]), "+f"(d[28]), "+f"(d[29]),
                  "+f"(d[30]), "+f"(d[31]), "+f"(d[32]), "+f"(d[33]), "+f"(d[34]), "+f"(d[35]),
                  "+f"(d[36]), "+f"(d[37]), "+f"(d[38]), "+f"(d[39]), "+f"(d[40]), "+f"(d[41]),
                  "+f"(d[42]), "+f"(d[43]), "+f"(d[44]), "+f"(d[45]), "+f"(d[46]), "+f"(d[47]),
                  "+f"(d[48]), "+f"(d[49]), "+f"(d[50]), "+f"(d[51]), "+f"(d[52]), "+f"(d[53]),
                  "+f"(d[54]), "+f"(d[55]), "+f"(d[56]), "+f"(d[57]), "+f"(d[58]), "+f"(d[59]),
                  "+f"(d[60]), "+f"(d[61]), "+f"(d[62]), "+f"(d[63])
                : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "l"(b), "n"(onto), "n"(transposed));
#endif
    }
    /// ... of two operands in shared memory, whose neighbours are not those along K, for warp w of
    /// the group.
    template <int n>
    __device__ static void product_transposed(Array<F, std::size_t(n / 2)>& d, Operand a, Operand b,
                                              int) {
#if defined(__CUDA_ARCH_FEAT_SM90_ALL)
        static_assert(n == 16 || n == 32 || n == 64 || n == 128);
        constexpr bool onto = true;
        if constexpr (n == 16)
            asm volatile(
                "{ .reg .pred p; setp.ne.b32 p, %10, 0; "
                "wgmma.mma_async.sync.aligned.m64n16k16.f32.bf16.bf16 {%0, %1, %2, %3, %4, "
                "%5, %6, %7}, %8, %9, p, 1, 1, 1, 1; }"
                : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3]), "+f"(d[4]), "+f"(d[5]),
                  "+f"(d[6]), "+f"(d[7])
                : "l"(a), "l"(b), "n"(onto));
        else if constexpr (n == 32)
            asm volatile(
                "{ .reg .pred p; setp.ne.b32 p, %18, 0; "
                "wgmma.mma_async.sync.aligned.m64n32k16.f32.bf16.bf16 {%0, %1, %2, %3, %4, "
                "%5, %6, %7, %8, %9, %10, %11, %12, %13, %14, %15}, %16, %17, p, 1, 1, 1, 1; "
                "}"
                : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3]), "+f"(d[4]), "+f"(d[5]),
                  "+f"(d[6]), "+f"(d[7]), "+f"(d[8]), "+f"(d[9]), "+f"(d[10]), "+f"(d[11]),
                  "+f"(d[12]), "+f"(d[13]), "+f"(d[14]), "+f"(d[15])
                : "l"(a), "l"(b), "n"(onto));
        else if constexpr (n == 64)
            asm volatile(
                "{ .reg .pred p; setp.ne.b32 p, %34, 0; "
                "wgmma.mma_async.sync.aligned.m64n64k16.f32.bf16.bf16 {%0, %1, %2, %3, %4, "
                "%5, %6, %7, %8, %9, %10, %11, %12, %13, %14, %15, %16, %17, %18, %19, %20, "
                "%21, %22, %23, %24, %25, %26, %27, %28, %29, %30, %31}, %32, %33, p, 1, 1, "
                "1, 1; }"
                : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3]), "+f"(d[4]), "+f"(d[5]),
                  "+f"(d[6]), "+f"(d[7]), "+f"(d[8]), "+f"(d[9]), "+f"(d[10]), "+f"(d[11]),
                  "+f"(d[12]), "+f"(d[13]), "+f"(d[14]), "+f"(d[15]), "+f"(d[16]), "+f"(d[17]),
                  "+f"(d[18]), "+f"(d[19]), "+f"(d[20]), "+f"(d[21]), "+f"(d[22]), "+f"(d[23]),
                  "+f"(d[24]), "+f"(d[25]), "+f"(d[26]), "+f"(d[27]), "+f"(d[28]), "+f"(d[29]),
                  "+f"(d[30]), "+f"(d[31])
                : "l"(a), "l"(b), "n"(onto));
        else if constexpr (n == 128)
            asm volatile(
                "{ .reg .pred p; setp.ne.b32 p, %66, 0; "
                "wgmma.mma_async.sync.aligned.m64n128k16.f32.bf16.bf16 {%0, %1, %2, %3, %4, "
                "%5, %6, %7, %8, %9, %10, %11, %12, %13, %14, %15, %16, %17, %18, %19, %20, "
                "%21, %22, %23, %24, %25, %26, %27, %28, %29, %30, %31, %32, %33, %34, %35, "
                "%36, %37, %38, %39, %40, %41, %42, %43, %44, %45, %46, %47, %48, %49, %50, "
                "%51, %52, %53, %54, %55, %56, %57, %58, %59, %60, %61, %62, %63}, %64, %65, "
                "p, 1, 1, 1, 1; }"
                : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3]), "+f"(d[4]), "+f"(d[5]),
                  "+f"(d[6]), "+f"(d[7]), "+f"(d[8]), "+f"(d[9]), "+f"(d[10]), "+f"(d[11]),
                  "+f"(d[12]), "+f"(d[13]), "+f"(d[14]), "+f"(d[15]), "+f"(d[16]), "+f"(d[17]),
                  "+f"(d[18]), "+f"(d[19]), "+f"(d[20]), "+f"(d[21]), "+f"(d[22]), "+f"(d[23]),
                  "+f"(d[24]), "+f"(d[25]), "+f"(d[26]), "+f"(d[27]), "+f"(d[28]), "+f"(d[29]),
                  "+f"(d[30]), "+f"(d[31]), "+f"(d[32]), "+f"(d[33]), "+f"(d[34]), "+f"(d[35]),
                  "+f"(d[36]), "+f"(d[37]), "+f"(d[38]), "+f"(d[39]), "+f"(d[40]), "+f"(d[41]),
                  "+f"(d[42]), "+f"(d[43]), "+f"(d[44]), "+f"(d[45]), "+f"(d[46]), "+f"(d[47]),
                  "+f"(d[48]), "+f"(d[49]), "+f"(d[50]), "+f"(d[51]), "+f"(d[52]), "+f"(d[53]),
                  "+f"(d[54]), "+f"(d[55]), "+f"(d[56]), "+f"(d[57]), "+f"(d[58]), "+f"(d[59]),
                  "+f"(d[60]), "+f"(d[61]), "+f"(d[62]), "+f"(d[63])
                : "l"(a), "l"(b), "n"(onto));
#endif
    }

    /// Halves that are all ones where a half of the pair is greater than 0.
    __device__ static U positive(U pair) {
        U r = 0;
#if defined(__CUDA_ARCH_FEAT_SM90_ALL)
        asm("set.gt.u32.bf16x2 %0, %1, %2;" : "=r"(r) : "r"(pair), "r"(0U));
#endif
        return r;
    }

    /// Makes a ring ready for so many warps that take from it; by one thread, before the block's
    /// next barrier.
    template <class Ring>
    __device__ static void set_ring(Ring& ring, int warps) {
#if defined(__CUDA_ARCH_FEAT_SM90_ALL)
        for (int i = 0; i < Ring::slots; ++i) {
            asm volatile("mbarrier.init.shared::cta.b64 [%0], 1;" ::"r"(address(&ring.full[i]))
                         : "memory");
            asm volatile("mbarrier.init.shared::cta.b64 [%0], %1;" ::"r"(address(&ring.empty[i])),
                         "r"(warps)
                         : "memory");
        }
        asm volatile("fence.mbarrier_init.release.cluster;" ::: "memory");
        asm volatile("fence.proxy.async.shared::cta;" ::: "memory");
#endif
    }
    /// Fills the slot of a place once its last piece was given back, by one warp: f(k, copy) calls
    /// copy(to, from, bytes) for the parts of piece k, whose bytes go `to` bytes behind the slot's
    /// first. Bytes are multiples of 16.
    template <class Ring, class F>
    __device__ static void fill(Ring& ring, const RingPlace<Ring>& place, const F& f) {
#if defined(__CUDA_ARCH_FEAT_SM90_ALL)
        if (threadIdx.x % 32 == 0) {
            wait(&ring.empty[place.slot], place.round ^ 1U);
            const U full = address(&ring.full[place.slot]);
            f(place.piece, [&](int to, const void* from, int bytes) {
                asm volatile("mbarrier.expect_tx.relaxed.cta.shared::cta.b64 [%0], %1;" ::"r"(full),
                             "r"(bytes)
                             : "memory");
                asm volatile(
                    "cp.async.bulk.shared::cluster.global.mbarrier::complete_tx::bytes [%0], [%1], "
                    "%2, [%3];" ::"r"(address(&ring.slot[place.slot][to])),
                    "l"(__cvta_generic_to_global(from)), "r"(bytes), "r"(full)
                    : "memory");
            });
            asm volatile("mbarrier.arrive.shared::cta.b64 _, [%0];" ::"r"(full) : "memory");
        }
        __syncwarp();
#endif
    }
    /// Waits for the piece at a place; f is that of fill.
    template <class Ring, class F>
    __device__ static const unsigned char* take(Ring& ring, const RingPlace<Ring>& place,
                                                const F&) {
        wait(&ring.full[place.slot], place.round);
        return &ring.slot[place.slot][0];
    }
    /// The warp has read what it took.
    template <class Ring>
    __device__ static void give(Ring& ring, const RingPlace<Ring>& place) {
#if defined(__CUDA_ARCH_FEAT_SM90_ALL)
        __syncwarp();
        if (threadIdx.x % 32 == 0)
            asm volatile(
                "mbarrier.arrive.shared::cta.b64 _, [%0];" ::"r"(address(&ring.empty[place.slot]))
                : "memory");
#endif
    }

  private:
    __device__ static U address(const void* p) {
        return static_cast<U>(__cvta_generic_to_shared(p));
    }
    __device__ static void wait(const std::uint64_t* barrier, U round) {
#if defined(__CUDA_ARCH_FEAT_SM90_ALL)
        U there = 0;
        while (there == 0)
            asm volatile(
                "{ .reg .pred p; mbarrier.try_wait.parity.shared::cta.b64 p, [%1], %2; "
                "selp.b32 %0, 1, 0, p; }"
                : "=r"(there)
                : "r"(address(barrier)), "r"(round)
                : "memory");
#endif
    }
};

} // namespace rye::detail

namespace rye {

struct CudaDevice; // device.hpp

/// Returns the processors of a device whose program has kernels of groups for it, else 0.
template <class Device>
    requires std::is_base_of_v<CudaDevice, Device>
int processors_of_groups(const Device&) { return detail::GroupProbe<>::processors(); }

} // namespace rye

#endif
