// SPDX-License-Identifier: Apache-2.0
// sizes [--json FILE]: how times and memory grow: a head of 10^4 to 10^7 Gaussians, which cover the
// same pixels, at 512 x 512, and one of 100,000 from 256 x 256 to 4096 x 4096; 3 channels, the
// rules of Fast; a CUDA graph, median of 100. `formula`: what DeviceFrameShape::bytes() says;
// `asked`: what was taken from the arena.
#include <rye/backend/cuda/device.hpp>

#include <cmath>
#include <cstdio>

#include "one_view.hpp"

namespace {

using namespace rye;

std::string json;

void row(cudaStream_t stream, Index count, int size) {
    const double scale = 0.01 * std::sqrt(1e5 / static_cast<double>(count));
    const auto scene = bench::head(count, 3, size, 860.0 * size / 512, 1001, scale);
    const bench::OneView v = bench::one_view<FeaturesOnly<Fast>, 3>(stream, scene);
    const double pixels = double(size) * size, n = static_cast<double>(count);
    std::printf(
        "%9.0f Gaussians, %4d x %-4d | forward %.3f ms | both %.3f ms [%.3f-%.3f] | "
        "%.2f ns a Gaussian, %.3f ns a pixel | entries %.0f | memory %.1f MB, formula "
        "%.1f, asked %.1f\n",
        n, size, size, double(v.forward.median), double(v.both.median), double(v.both.least),
        double(v.both.most), 1e6 * double(v.both.median) / n, 1e6 * double(v.both.median) / pixels,
        v.entries, v.held / 1e6, v.formula / 1e6, v.asked / 1e6);
    char text[320];
    std::snprintf(
        text, sizeof text,
        "%s  {\"name\": \"cuda_sizes/n:%.0f/side:%d\", \"forward_ms\": %.5g, "
        "\"graph_ms\": %.5g, \"entries\": %.0f, \"frame_MB\": %.4g, \"formula_MB\": %.4g}",
        json.empty() ? "" : ",\n", n, size, double(v.forward.median), double(v.both.median),
        v.entries, v.held / 1e6, v.formula / 1e6);
    json += text;
    std::fflush(stdout);
}

} // namespace

int main(int argc, char** argv) {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("cuda_sizes: skipped, no device is there");
        return 0;
    }
    try {
        cudaStream_t stream;
        check_cuda(cudaStreamCreate(&stream), "stream");
        for (const Index n : {10000, 30000, 100000, 300000, 1000000, 3000000, 10000000})
            row(stream, n, 512);
        for (const int side : {256, 512, 1024, 2048, 4096}) row(stream, 100000, side);
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
    return bench::write_rows(argc, argv, json);
}
