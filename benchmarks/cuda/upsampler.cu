// SPDX-License-Identifier: Apache-2.0
// upsampler [--layers] [--json FILE]: what a training step does with images on this device, by 1, 2
// and 3 planes: super-resolution 128 -> 512 and 512 -> 2048 (32 channels, capacity 32, two
// doublings), forward and with its vjp, and losses of a picture at 512 x 512; with --layers also
// each convolution of both sizes by 1 plane. Milliseconds of a CUDA graph, median of 100
// [least-most], and TFLOP/s of the convolutions' own products, which more planes take several
// times.
#include <rye/backend/cuda/device.hpp>

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include <rye/loss/cuda/dssim.hpp>
#include <rye/loss/cuda/lpips.hpp>
#include <rye/loss/cuda/pyramid.hpp>
#include <rye/loss/cuda/rgb_term.hpp>
#include <rye/nn/cuda/upsampler.hpp>

#include "timing.hpp"
#include "work.hpp"

namespace {

using namespace rye;

std::string json;

using bench::Times, bench::graph_times;

void report(const std::string& name, const Times& ms, double flops) {
    std::printf("%-36s %8.3f ms [%.3f-%.3f]", name.c_str(), static_cast<double>(ms.median),
                static_cast<double>(ms.least), static_cast<double>(ms.most));
    if (flops > 0) std::printf(" %6.0f TFLOP/s", flops / static_cast<double>(ms.median) * 1e-9);
    std::printf("\n");
    std::fflush(stdout);
    char text[256];
    std::snprintf(text, sizeof text,
                  "%s  {\"name\": \"cuda_images/%s\", \"median_ms\": %.5g, \"tflops\": %.5g}",
                  json.empty() ? "" : ",\n", name.c_str(), static_cast<double>(ms.median),
                  flops / static_cast<double>(ms.median) * 1e-9);
    json += text;
}

/// Numbers in 0..1 in device memory.
struct Numbers {
    DeviceBuffer<float> buffer;
    Index rows, cols;

    Numbers(const CudaQueue& queue, Index r, Index c, std::uint64_t seed) : rows(r), cols(c) {
        std::vector<float> host(static_cast<std::size_t>(r * c));
        std::uint64_t x = seed;
        for (float& h : host) {
            x = x * 6364136223846793005U + 1442695040888963407U;
            h = static_cast<float>(x >> 40U) / 16777216.0F;
        }
        buffer.reserve(queue, host.size() + 1);
        CudaDevice().send(queue, buffer.data(), host.data(), host.size() * sizeof(float));
    }
    DeviceColumns<float> view() const { return {buffer.data(), rows, cols}; }
};

template <int N>
void upsampler_rows(const CudaQueue& queue, int side) {
    const CudaDevice device;
    const UpsamplerShape s;
    const Upsampler<float> host = Upsampler<float>::init(s, Random(1));
    const ResidentLayout<Upsampler<float>> layout(host);
    Resident<Upsampler<float>, CudaDevice> parameters(device, queue, layout),
        gradient(device, queue, layout);
    parameters.send(queue, host);
    const Index small = Index(side) * side, full = 16 * small;
    const Numbers in(queue, 32, small, 1), out(queue, 3, full, 2), g(queue, 3, full, 3),
        g_in(queue, 32, small, 4);
    DeviceUpsampler<CudaDevice, N> network(device, s);
    DeviceUpsamplerTrace trace;
    const auto forward = [&] {
        network.set(queue, device_upsampler(parameters, host));
        network.forward_into(queue, {in.view(), side, side}, {out.view(), 4 * side, 4 * side},
                             trace);
    };
    const auto both = [&] {
        forward();
        network.vjp_into(queue, trace, g.view(), {device_upsampler(gradient, host), g_in.view()});
    };
    const double flops = 2 * bench::products(s, double(side) * side);
    const std::string name = "upsampler/" + std::to_string(side) + "-" + std::to_string(4 * side) +
                             "/planes:" + std::to_string(N);
    report(name + "/forward", graph_times(queue.stream, forward), flops);
    report(name + "/both", graph_times(queue.stream, both), 3 * flops);
    network.keep_planes = true;
    report(name + "/both, planes kept", graph_times(queue.stream, both), 3 * flops);
    std::printf("%-36s %8.0f MB beside %.0f MB of a trace\n", "", double(network.bytes()) / 1e6,
                double(trace.bytes()) / 1e6);
}

/// A convolution, forward with moments of its channels, and its gradients.
template <int N>
void convolution_rows(const CudaQueue& queue, int side, int inputs, int outputs) {
    const CudaDevice device;
    const Index pixels = Index(side) * side;
    const Numbers x(queue, inputs, pixels, 1), y(queue, outputs, pixels, 2),
        weight(queue, outputs, Index(9) * inputs, 3),
        g_weight(queue, outputs, Index(9) * inputs, 4);
    DeviceBuffer<std::uint16_t> memory[2];
    const auto planes_of = [&](const Numbers& from, DeviceBuffer<std::uint16_t>& to) {
        DeviceImagePlanes planes{nullptr, side, side, static_cast<int>(from.rows)};
        to.reserve(queue, planes.halves(N));
        planes.data = to.data();
        image_planes_into<N>(
            device, queue, detail::PlainPixels{from.buffer.data(), side, planes.channels}, planes);
        return planes;
    };
    const DeviceImagePlanes of_x = planes_of(x, memory[0]), of_y = planes_of(y, memory[1]);
    DeviceConvolution<CudaDevice, N> layer(device, inputs, outputs);
    layer.set(queue, weight.view());
    DeviceBuffer<float> partial;
    DeviceBuffer<detail::StripMoments> moments;
    const double flops = 2.0 * 9 * double(pixels) * inputs * outputs;
    const std::string name = "convolution/" + std::to_string(side) + "/" + std::to_string(inputs) +
                             "-" + std::to_string(outputs) + "/planes:" + std::to_string(N);
    const auto row = [&](const char* what, const auto& f) {
        report(name + what, graph_times(queue.stream, f), flops);
    };
    row("/forward", [&] { layer.forward_into(queue, of_x, y.buffer.data(), moments); });
    row("/input", [&] { layer.vjp_input_into(queue, of_y, x.buffer.data()); });
    row("/weights",
        [&] { layer.vjp_weight_into(queue, of_x, of_y, g_weight.buffer.data(), partial); });
}

void loss_rows(const CudaQueue& queue) {
    const CudaDevice device;
    constexpr int side = 512;
    const Index pixels = Index(side) * side;
    const Numbers a(queue, 3, pixels, 1), b(queue, 3, pixels, 2), g(queue, 3, pixels, 3);
    const DevicePicture<const float> picture{a.view(), side, side}, truth{b.view(), side, side};
    const DevicePicture<float> to{g.view(), side, side};
    DeviceDssim<CudaDevice> dssim_of(device);
    DevicePyramidLoss<CudaDevice> pyramid(device);
    DeviceRgbTerm<CudaDevice> rgb(device);
    const detail::PictureTarget<float> target{b.buffer.data(), nullptr};
    report("losses/512/dssim",
           graph_times(queue.stream, [&] { dssim_of.into(queue, picture, truth, 1.0, to); }), 0);
    report("losses/512/pyramid",
           graph_times(queue.stream, [&] { pyramid.into(queue, picture, truth, 1.0, to); }), 0);
    report("losses/512/l1",
           graph_times(queue.stream,
                       [&] { rgb.into(queue, picture.pixels, target, 1.0, to.pixels); }),
           0);
    LpipsWeights<float> weights;
    std::uint64_t k = 0;
    const Random random(5);
    LpipsWeights<float>::fields(
        [&](const std::string&, Columns<float>& w) {
            for (Index i = 0; i < w.size(); ++i)
                w.data()[i] = static_cast<float>(0.06 * (random.uniform(k++) - 0.45));
        },
        weights);
    DeviceLpips<CudaDevice, 1> lpips(device, queue, weights);
    DeviceLpipsTruth kept;
    report("losses/512/lpips, features of a truth",
           graph_times(queue.stream,
                       [&] {
                           lpips.truth_into(queue, truth, {side, side}, kept);
                       }),
           0);
    report("losses/512/lpips",
           graph_times(queue.stream, [&] { lpips.into(queue, picture, kept, 1.0, to); }), 0);
}

} // namespace

int main(int argc, char** argv) {
    const bool layers = argc > 1 && std::string(argv[1]) == "--layers";
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("not run: cuda_upsampler: no device is there");
        return 0;
    }
    try {
        cudaStream_t stream;
        check_cuda(cudaStreamCreate(&stream), "stream");
        StreamMemory memory;
        const CudaQueue queue{stream, memory};
        for (const int side : {128, 512}) {
            upsampler_rows<1>(queue, side);
            upsampler_rows<2>(queue, side);
            if (side == 128) upsampler_rows<3>(queue, side);
        }
        for (const int channels : {32, 64, 128})
            convolution_rows<1>(queue, 512, channels, channels);
        convolution_rows<2>(queue, 512, 128, 128);
        convolution_rows<3>(queue, 512, 128, 128);
        const UpsamplerShape shape;
        for (const int side : {128, 512})
            for (int l = 0; layers && l < shape.layers(); ++l)
                convolution_rows<1>(queue, side << l / 2, shape.layer_in(l),
                                    shape.block_out(l / 2));
        loss_rows(queue);
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
    return bench::write_rows(argc - (layers ? 1 : 0), argv + (layers ? 1 : 0), json);
}
