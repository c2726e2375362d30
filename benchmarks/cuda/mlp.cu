// SPDX-License-Identifier: Apache-2.0
// mlp [--json FILE]: a network over points on this device: the colour network of the method,
// 192 (64 of them of the frame) -> 256 -> 256 with the input again -> 32, and its deformation
// network, over 100,000, 50,000 and 10,000 points, by 1, 2 and 3 planes; and those of the preset
// gpu over 266,000, by tiles of 256 and of 128 columns: milliseconds of a CUDA graph, median of 100
// [least-most], and TFLOP/s of the network's own products, which more planes take several times.
#include <rye/backend/cuda/device.hpp>

#include <algorithm>
#include <cstdio>

#include "../../tests/cuda/mlp_arrays.hpp"
#include "timing.hpp"
#include "work.hpp"

namespace {

using namespace rye;
using namespace rye::test;

std::string json;

using bench::Times, bench::graph_times, bench::products;

template <class Tiles>
void row(const char* name, const CudaQueue& queue, const MlpShape& s, Index n) {
    const CudaDevice device;
    const Mlp<float> m = Mlp<float>::init(s, Random(3));
    const DeviceParameters<CudaDevice> parameters(device, queue, m),
        gradient(device, queue, Mlp<float>(s));
    const DeviceArray<CudaDevice> in(device, queue, noise<float>(s.point_inputs(), n, 1)),
        cotangent(device, queue, noise<float>(s.outputs(), n, 2)),
        frame(device, queue, noise<float>(s.frame_inputs, 1, 3)),
        out(device, queue, s.outputs(), n), to_points(device, queue, s.point_inputs(), n),
        to_frame(device, queue, s.frame_inputs, 1);
    DeviceMlp<CudaDevice, Tiles> network(device, s);
    const auto prepare = [&] { network.set(queue, parameters.view, frame.buffer.data()); };
    const auto forward = [&] { network.forward_into(queue, in.read(), out.view()); };
    const auto reverse = [&] {
        network.vjp_into(queue, cotangent.read(),
                         {gradient.view, to_points.view(), to_frame.buffer.data()});
    };
    prepare(), forward(), reverse();
    check_cuda(cudaStreamSynchronize(queue.stream), "first");
    const Times setup = graph_times(queue.stream, prepare),
                fwd = graph_times(queue.stream, forward);
    const Times both = graph_times(queue.stream, [&] { prepare(), forward(), reverse(); });
    const double flops = 2 * products(s) * double(n);
    std::printf(
        "%-12s N=%d %6lld points | operands %.3f | forward %.3f [%.3f-%.3f] %.0f TFLOP/s | "
        "all %.3f [%.3f-%.3f] %.0f TFLOP/s | %.0f MB\n",
        name, Tiles::N, static_cast<long long>(n), setup.median, fwd.median, fwd.least, fwd.most,
        flops / fwd.median * 1e-9, both.median, both.least, both.most,
        3 * flops / both.median * 1e-9, double(network.bytes()) / 1e6);
    char text[256];
    std::snprintf(text, sizeof text,
                  "%s  {\"name\": \"cuda_mlp/%s/planes:%d/points:%lld\", \"operands_ms\": %.5g, "
                  "\"forward_ms\": %.5g, \"all_ms\": %.5g}",
                  json.empty() ? "" : ",\n", name, Tiles::N, static_cast<long long>(n),
                  setup.median, fwd.median, both.median);
    json += text;
    std::fflush(stdout);
}

template <int N>
void rows(const CudaQueue& queue) {
    for (const Index n : {100000, 50000, 10000}) {
        row<MlpTiles<N, 256, 128>>("colour", queue, {{192, 256, 256, 32}, 64}, n);
        row<MlpTiles<N, 256, 64>>("deformation", queue, {{91, 256, 256, 256, 256, 256, 3}, 64}, n);
    }
}

} // namespace

int main(int argc, char** argv) {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("cuda_mlp: skipped, no device is there");
        return 0;
    }
    try {
        cudaStream_t stream;
        check_cuda(cudaStreamCreate(&stream), "stream");
        StreamMemory memory;
        const CudaQueue queue{stream, memory};
        rows<1>(queue);
        rows<2>(queue);
        rows<3>(queue);
        const MlpShape colour{{128, 128, 128, 16}, 64},
            deformation{{91, 128, 128, 128, 128, 3}, 64};
        row<MlpTiles<1, 256, 128>>("gpu, colour", queue, colour, 266000);
        row<MlpTiles<1, 128, 64>>("... narrow", queue, colour, 266000);
        row<MlpTiles<1, 256, 64>>("gpu, deform.", queue, deformation, 266000);
        row<MlpTiles<1, 128, 32>>("... narrow", queue, deformation, 266000);
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
    return bench::write_rows(argc, argv, json);
}
