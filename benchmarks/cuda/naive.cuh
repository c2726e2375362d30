// SPDX-License-Identifier: Apache-2.0
// naive.cuh: the yardstick: splatting as one writes it in a day. Tiles of 16 x 16 by the square
// around three standard deviations, one global sort of (tile, depth), a thread a pixel, near to far
// forward; on the way back far to near from the stored end, divided by 1 - alpha, every partial
// gradient an atomic. The projection is rye's. Rules of Fast; a call waits for the device once, to
// learn how many pairs to sort.
#pragma once

#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_scan.cuh>

#include <rye/backend/cuda/device.hpp>
#include <rye/splat/cuda/lists.hpp>

namespace rye::bench {

struct NaiveSplat {
    float x, y, ux, vx, vy, log2_opacity, depth;
    int left, top, right, bottom; // of tiles
};

__device__ inline Shape<float> naive_shape(const DeviceGaussians<const float>& g, int i) {
    return rye::detail::ProjectKernel<Fast, NoDistortion>::shape_of(g,
                                                                    static_cast<std::uint32_t>(i));
}

static __global__ void naive_project(DeviceGaussians<const float> g, DeviceLens<NoDistortion> lens,
                                     float cx, float cy, int columns, int rows, NaiveSplat* splats,
                                     int* counts) {
    const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (i >= g.count()) return;
    counts[i] = 0;
    DeviceLens<NoDistortion>::Held held;
    lens.put(held);
    const auto s = project(naive_shape(g, i), held.projector);
    if (!s.drawable || !(g.opacity.data[i] > 1.0F / 255)) return;
    const Splat<float> p = make_splat(s, g.opacity.data[i], Fast());
    const float rx = 3 * sqrtf(s.covariance.xx), ry = 3 * sqrtf(s.covariance.yy);
    const auto tile = [](float a, int most) {
        return max(0, min(most, static_cast<int>(floorf(a / 16))));
    };
    NaiveSplat n{p.x,
                 p.y,
                 p.ux,
                 p.vx,
                 p.vy,
                 p.log2_opacity,
                 p.depth,
                 tile(p.x + cx - rx, columns),
                 tile(p.y + cy - ry, rows),
                 tile(p.x + cx + rx + 16, columns),
                 tile(p.y + cy + ry + 16, rows)};
    splats[i] = n;
    counts[i] = (n.right - n.left) * (n.bottom - n.top);
}

static __global__ void naive_emit(int count, int columns, const NaiveSplat* splats,
                                  const int* counts, const int* ends, std::uint64_t* keys,
                                  int* values) {
    const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (i >= count || counts[i] == 0) return;
    const NaiveSplat s = splats[i];
    int at = ends[i] - counts[i];
    for (int y = s.top; y < s.bottom; ++y)
        for (int x = s.left; x < s.right; ++x) {
            keys[at] = std::uint64_t(y * columns + x) << 32U | rye::detail::depth_key(s.depth);
            values[at++] = i;
        }
}

static __global__ void naive_ranges(int total, const std::uint64_t* keys, int2* ranges) {
    const int k = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (k >= total) return;
    const auto tile = keys[k] >> 32U;
    if (k == 0 || keys[k - 1] >> 32U != tile) ranges[tile].x = k;
    if (k == total - 1 || keys[k + 1] >> 32U != tile) ranges[tile].y = k + 1;
}

struct NaivePixel {
    int x, y, width, height, index;
    float px, py;
    __device__ NaivePixel(int w, int h, float cx, float cy)
        : x(static_cast<int>(blockIdx.x * 16 + threadIdx.x)),
          y(static_cast<int>(blockIdx.y * 16 + threadIdx.y)),
          width(w),
          height(h),
          index(y * w + x),
          px(static_cast<float>(x) + 0.5F - cx),
          py(static_cast<float>(y) + 0.5F - cy) {}
    __device__ bool inside() const { return x < width && y < height; }
};

__device__ inline float naive_alpha(const NaiveSplat& s, float dx, float dy, float& u, float& v) {
    u = s.ux * dx;
    v = s.vx * dx + s.vy * dy;
    return fminf(0.999F, exp2f(s.log2_opacity - u * u - v * v));
}

template <int C>
__global__ void naive_forward(int width, int height, float cx, float cy, const NaiveSplat* splats,
                              const float* features, const int2* ranges, const int* values,
                              float* image, float* end, int* last) {
    const NaivePixel p(width, height, cx, cy);
    if (!p.inside()) return;
    const int2 range = ranges[blockIdx.y * gridDim.x + blockIdx.x];
    float t = 1, sum[C] = {};
    int k = range.x;
    for (; k < range.y && t >= 1e-4F; ++k) {
        const NaiveSplat s = splats[values[k]];
        float u, v;
        const float a = naive_alpha(s, p.px - s.x, p.py - s.y, u, v);
        if (a < 1.0F / 255) continue;
        for (int c = 0; c < C; ++c) sum[c] += a * t * features[values[k] * C + c];
        t *= 1 - a;
    }
    for (int c = 0; c < C; ++c) image[p.index * C + c] = sum[c];
    end[p.index] = t;
    last[p.index] = k;
}

template <int C>
__global__ void naive_reverse(int width, int height, float cx, float cy, const NaiveSplat* splats,
                              const float* features, const int2* ranges, const int* values,
                              const float* g_image, const float* end, const int* last,
                              float* g_splat, float* g_feature) {
    const NaivePixel p(width, height, cx, cy);
    if (!p.inside()) return;
    const int2 range = ranges[blockIdx.y * gridDim.x + blockIdx.x];
    float t = end[p.index], g[C], behind = 0;
    for (int c = 0; c < C; ++c) g[c] = g_image[p.index * C + c];
    for (int k = last[p.index]; k-- > range.x;) {
        const int i = values[k];
        const NaiveSplat s = splats[i];
        float u, v;
        const float a = naive_alpha(s, p.px - s.x, p.py - s.y, u, v);
        if (a < 1.0F / 255) continue;
        t /= 1 - a;
        float along = 0;
        for (int c = 0; c < C; ++c) {
            along += g[c] * features[i * C + c];
            atomicAdd(g_feature + i * C + c, a * t * g[c]);
        }
        const float m = along - behind;
        behind += a * m;
        if (a >= 0.999F) continue;
        const float h = a * t * m;
        atomicAdd(g_splat + 8 * i, h * u);
        atomicAdd(g_splat + 8 * i + 1, h * v);
        atomicAdd(g_splat + 8 * i + 2, h * u * u);
        atomicAdd(g_splat + 8 * i + 3, h * u * v);
        atomicAdd(g_splat + 8 * i + 4, h * v * v);
        atomicAdd(g_splat + 8 * i + 5, h);
    }
}

static __global__ void naive_pull_back(DeviceGaussians<const float> g,
                                       DeviceLens<NoDistortion> lens, const NaiveSplat* splats,
                                       const float* g_splat, DeviceGaussians<float> out,
                                       const int* counts) {
    const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (i >= g.count()) return;
    Shape<float> d{Vec3<float>(0, 0, 0), Quat<float>(0, 0, 0, 0), Vec3<float>(0, 0, 0)};
    if (counts[i] > 0) {
        Splat<float> s{};
        s.ux = splats[i].ux, s.vx = splats[i].vx, s.vy = splats[i].vy;
        const float* const m = g_splat + 8 * i;
        DeviceLens<NoDistortion>::Held held;
        lens.put(held);
        d = project_vjp(naive_shape(g, i), held.projector,
                        rye::detail::screen_cotangent(
                            s, SplatCotangent<float>{m[0], m[1], m[2], m[3], m[4], m[5], 0}));
    }
    for (int k = 0; k < 3; ++k) out.mean.data[3 * i + k] = d.mean[k];
    for (int k = 0; k < 4; ++k) out.rotation.data[4 * i + k] = d.rotation[k];
    for (int k = 0; k < 3; ++k) out.scale.data[3 * i + k] = d.scale[k];
    out.opacity.data[i] = counts[i] > 0 ? g_splat[8 * i + 5] / g.opacity.data[i] : 0;
}

/// Memory for n Gaussians and `most` pairs; run draws and differentiates.
class Naive {
  public:
    Naive(Index n, int channels, int width, int height, std::size_t most)
        : n_(static_cast<int>(n)),
          channels_(channels),
          most_(most) {
        const std::size_t pixels = std::size_t(width) * std::size_t(height),
                          count = std::size_t(n_);
        get(splats_, count), get(counts_, count), get(ends_, count);
        get(keys_, 2 * most), get(values_, 2 * most), get(ranges_, pixels / 16 + 4096);
        get(end_, pixels), get(last_, pixels), get(g_splat_, 8 * count);
        cub::DeviceRadixSort::SortPairs(nullptr, sort_bytes_, keys_, keys_, values_, values_,
                                        static_cast<int>(most));
        cub::DeviceScan::InclusiveSum(nullptr, scan_bytes_, counts_, ends_, n_);
        get(scratch_, std::max(sort_bytes_, scan_bytes_));
    }
    Naive(const Naive&) = delete;
    Naive& operator=(const Naive&) = delete;
    ~Naive() {
        for (void* p : held_) static_cast<void>(cudaFree(p));
    }

    void run(cudaStream_t stream, const DeviceGaussians<const float>& g,
             const Pinhole<float>& camera, float* image, const float* g_image,
             const DeviceGaussians<float>& out) {
        if (channels_ == 3) go<3>(stream, g, camera, image, g_image, out);
        if (channels_ == 32) go<32>(stream, g, camera, image, g_image, out);
    }

  private:
    template <int C>
    void go(cudaStream_t stream, const DeviceGaussians<const float>& g,
            const Pinhole<float>& camera, float* image, const float* g_image,
            const DeviceGaussians<float>& out) {
        const DeviceLens<NoDistortion> lens(
            Projector<float>(camera, Fast().frustum_margin, Fast().dilation));
        const int w = camera.width, h = camera.height, columns = (w + 15) / 16,
                  rows = (h + 15) / 16;
        const int blocks = (n_ + 127) / 128;
        naive_project<<<blocks, 128, 0, stream>>>(g, lens, camera.cx, camera.cy, columns, rows,
                                                  splats_, counts_);
        cub::DeviceScan::InclusiveSum(scratch_, scan_bytes_, counts_, ends_, n_, stream);
        int total = 0;
        check_cuda(cudaMemcpyAsync(&total, ends_ + n_ - 1, 4, cudaMemcpyDeviceToHost, stream),
                   "naive");
        check_cuda(cudaStreamSynchronize(stream), "naive");
        if (std::size_t(total) > most_) throw Error("naive: too many pairs");
        naive_emit<<<blocks, 128, 0, stream>>>(n_, columns, splats_, counts_, ends_, keys_,
                                               values_);
        cub::DeviceRadixSort::SortPairs(scratch_, sort_bytes_, keys_, keys_ + most_, values_,
                                        values_ + most_, total, 0, 46, stream);
        check_cuda(cudaMemsetAsync(ranges_, 0, std::size_t(columns * rows) * 8, stream), "naive");
        naive_ranges<<<(total + 255) / 256, 256, 0, stream>>>(total, keys_ + most_, ranges_);
        const dim3 grid(static_cast<unsigned>(columns), static_cast<unsigned>(rows)), block(16, 16);
        naive_forward<C><<<grid, block, 0, stream>>>(w, h, camera.cx, camera.cy, splats_,
                                                     g.feature.data, ranges_, values_ + most_,
                                                     image, end_, last_);
        check_cuda(cudaMemsetAsync(g_splat_, 0, std::size_t(n_) * 32, stream), "naive");
        check_cuda(cudaMemsetAsync(out.feature.data, 0, std::size_t(n_) * C * 4, stream), "naive");
        naive_reverse<C><<<grid, block, 0, stream>>>(
            w, h, camera.cx, camera.cy, splats_, g.feature.data, ranges_, values_ + most_, g_image,
            end_, last_, g_splat_, out.feature.data);
        naive_pull_back<<<blocks, 128, 0, stream>>>(g, lens, splats_, g_splat_, out, counts_);
        check_cuda(cudaPeekAtLastError(), "naive");
    }

    template <class T>
    void get(T*& p, std::size_t n) {
        check_cuda(cudaMalloc(&p, n * sizeof(T) + 16), "naive");
        held_.push_back(p);
    }

    int n_, channels_;
    std::size_t most_, sort_bytes_ = 0, scan_bytes_ = 0;
    NaiveSplat* splats_ = nullptr;
    int *counts_ = nullptr, *ends_ = nullptr, *values_ = nullptr, *last_ = nullptr;
    std::uint64_t* keys_ = nullptr;
    int2* ranges_ = nullptr;
    float *end_ = nullptr, *g_splat_ = nullptr;
    unsigned char* scratch_ = nullptr;
    std::vector<void*> held_;
};

} // namespace rye::bench
