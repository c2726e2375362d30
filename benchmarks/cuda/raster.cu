// SPDX-License-Identifier: Apache-2.0
// raster [SCENE...] [--json FILE]: how long the shared scenes take on this device, forward and
// reverse, launched one by one and as a CUDA graph; and kernel by kernel. Sixteen cameras and as
// many copies of the Gaussians as do not fit the cache, 20 renders before, 200 timed; median
// [least, most]. Rules of Fast, features and alpha alone.
#include <rye/backend/cuda/device.hpp>
#include <rye/splat/cuda/sh_color.hpp>

#include <algorithm>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>

#include "naive.cuh"
#include "scenes.hpp"

namespace {

using namespace rye;

/// A device that records an event before and after each kernel.
struct TimedDevice : CudaDevice {
    struct Times {
        std::map<std::string, std::vector<std::pair<cudaEvent_t, cudaEvent_t>>> of;
    };
    Times* times = nullptr;

    template <class Kernel>
    void launch(const CudaQueue& queue, Index blocks, const Kernel& kernel) const {
        if (times == nullptr) return CudaDevice::launch(queue, blocks, kernel);
        cudaEvent_t before, after;
        check_cuda(cudaEventCreate(&before), "event");
        check_cuda(cudaEventCreate(&after), "event");
        check_cuda(cudaEventRecord(before, queue.stream), "event");
        CudaDevice::launch(queue, blocks, kernel);
        check_cuda(cudaEventRecord(after, queue.stream), "event");
        times->of[Kernel::name].push_back({before, after});
    }
};

float* upload(const Columns<float>& a) {
    float* p = nullptr;
    check_cuda(cudaMalloc(&p, std::size_t(a.size()) * 4 + 16), "upload");
    check_cuda(cudaMemcpy(p, a.data(), std::size_t(a.size()) * 4, cudaMemcpyHostToDevice),
               "upload");
    return p;
}
float* room(Index n) {
    float* p = nullptr;
    check_cuda(cudaMalloc(&p, std::size_t(n) * 4 + 16), "room");
    check_cuda(cudaMemset(p, 0xFF, std::size_t(n) * 4), "room");
    return p;
}
DeviceColumns<float> columns(float* p, Index rows, Index cols) { return {p, rows, cols}; }

struct Stats {
    float median, least, most;
};
Stats stats(std::vector<float> x) {
    std::sort(x.begin(), x.end());
    return {x[x.size() / 2], x.front(), x.back()};
}

/// Times of 200 calls of f(k), from event to event.
Stats timed(cudaStream_t stream, const std::function<void(int)>& f, int count = 200) {
    std::vector<cudaEvent_t> events(std::size_t(count) + 1);
    for (auto& e : events) check_cuda(cudaEventCreate(&e), "event");
    for (int k = 0; k < 20; ++k) f(k);
    check_cuda(cudaStreamSynchronize(stream), "warm-up");
    check_cuda(cudaEventRecord(events[0], stream), "event");
    for (int k = 0; k < count; ++k) {
        f(k);
        check_cuda(cudaEventRecord(events[std::size_t(k) + 1], stream), "event");
    }
    check_cuda(cudaStreamSynchronize(stream), "timed");
    std::vector<float> ms(static_cast<std::size_t>(count));
    for (std::size_t k = 0; k < ms.size(); ++k)
        check_cuda(cudaEventElapsedTime(&ms[k], events[k], events[k + 1]), "event");
    for (auto& e : events) check_cuda(cudaEventDestroy(e), "event");
    return stats(ms);
}

struct Json {
    std::string rows;
    void add(const std::string& name, const std::vector<std::pair<std::string, double>>& numbers) {
        rows += (rows.empty() ? "" : ",\n") + std::string("  {\"name\": \"") + name + "\"";
        for (const auto& [key, x] : numbers) {
            char text[64];
            std::snprintf(text, sizeof text, ", \"%s\": %.6g", key.c_str(), x);
            rows += text;
        }
        rows += "}";
    }
};

template <class Kernels>
void run(const bench::DeviceScenery& scene, Json& json) {
    using A = FeaturesOnly<Fast>;
    const DeviceRasterizer<A, TimedDevice, Kernels> rasterizer{};
    const Gaussians<float>& g = scene.gaussians;
    const bool harmonics = scene.sh_rest.size() > 0;
    const Index n = g.count(), channels = g.channels();
    const Pinhole<float>& first = scene.cameras.front();
    const Index pixels = Index(first.width) * first.height;
    const double one = 4.0 * double(n) * double(11 + (harmonics ? 48 : channels));
    const int copies = std::clamp(int(130e6 / one) + 1, 2, 16);
    struct Set {
        DeviceGaussians<float> in, out;
        DeviceHarmonics<float> sh, g_sh;
    };
    std::vector<Set> sets;
    for (int k = 0; k < copies; ++k) {
        Set s;
        s.in = {columns(upload(g.mean), 3, n), columns(upload(g.rotation), 4, n),
                columns(upload(g.scale), 3, n), columns(upload(g.opacity), 1, n),
                columns(upload(g.feature), channels, n)};
        s.out = {columns(room(3 * n), 3, n), columns(room(4 * n), 4, n), columns(room(3 * n), 3, n),
                 columns(room(n), 1, n), columns(room(channels * n), channels, n)};
        if (harmonics) {
            s.sh = {s.in.mean, columns(upload(scene.sh_constant), 3, n),
                    columns(upload(scene.sh_rest), 45, n)};
            s.g_sh = {s.out.mean, columns(room(3 * n), 3, n), columns(room(45 * n), 45, n)};
        }
        sets.push_back(s);
    }
    Columns<float> noise(channels, pixels);
    const bench::Numbers random{4004};
    for (Index i = 0; i < noise.size(); ++i)
        noise.data()[i] = float(2 * random.uniform(7, std::uint64_t(i)) - 1);
    const DeviceCotangent cotangent{columns(upload(noise), channels, pixels)};
    const float* const background = upload(Columns<float>::Zero(channels, 1));
    const DeviceImages images{columns(room(channels * pixels), channels, pixels),
                              columns(room(pixels), 1, pixels)};
    cudaStream_t stream;
    check_cuda(cudaStreamCreate(&stream), "stream");
    StreamMemory pool;
    const CudaQueue queue{stream, pool};
    DeviceFrame<TimedDevice> frame;

    const auto forward = [&](int k) {
        const Set& s = sets[std::size_t(k) % sets.size()];
        const std::size_t camera = std::size_t(k) % 16;
        if (harmonics)
            sh_colors_into(queue, frame.device, s.sh, scene.eyes[camera], s.in.feature.data);
        rasterizer.forward_into(queue, s.in, scene.cameras[camera], background, images, frame);
    };
    const auto reverse = [&](int k) {
        const Set& s = sets[std::size_t(k) % sets.size()];
        const std::size_t camera = std::size_t(k) % 16;
        rasterizer.vjp_into(queue, s.in, scene.cameras[camera], background, cotangent, s.out,
                            frame);
        if (harmonics)
            sh_colors_vjp_into(queue, frame.device, s.sh, scene.eyes[camera], s.out.feature.data,
                               s.g_sh, &frame.m);
    };
    // Derivatives in directions in which all Gaussians' numbers move, by as much as they are.
    DeviceBuffer<detail::SplatRecord> splats;
    std::vector<detail::DeviceDirection<NoDistortion>> directions(2);
    for (auto& d : directions)
        d.images = {columns(room(channels * pixels), channels, pixels),
                    columns(room(pixels), 1, pixels)};
    const auto along = [&](int k, std::size_t count) {
        const Set& s = sets[std::size_t(k) % sets.size()];
        for (auto& d : directions) d.gaussians = s.in;
        rasterizer.template jvp_into<NoDistortion>(
            queue, s.in, std::span(directions).first(count), scene.cameras[std::size_t(k) % 16],
            background, splats, frame);
    };
    double entries = 0, groups = 0;
    for (int k = 0; k < 16; ++k) {
        do forward(k);
        while (!frame.finish(queue));
        entries += double(frame.cost.entries) / 16;
        groups += double(frame.cost.groups) / 16;
        // Room for every camera before anything is captured.
        frame.entry_capacity = std::max(frame.entry_capacity, frame.cost.entries * 5 / 4);
        frame.group_capacity = std::max(frame.group_capacity, frame.cost.groups * 5 / 4);
    }
    forward(0);
    reverse(0);
    along(0, 2);
    check_cuda(cudaStreamSynchronize(stream), "first");

    const auto captured = [&](const auto& f) {
        auto graphs = std::make_shared<std::vector<cudaGraphExec_t>>();
        for (int k = 0; k < 16; ++k) {
            cudaGraph_t graph;
            cudaGraphExec_t exec;
            check_cuda(cudaStreamBeginCapture(stream, cudaStreamCaptureModeThreadLocal), "graph");
            f(k);
            check_cuda(cudaStreamEndCapture(stream, &graph), "graph");
            check_cuda(cudaGraphInstantiate(&exec, graph, 0), "graph");
            graphs->push_back(exec);
        }
        return [graphs, stream](int k) {
            check_cuda(cudaGraphLaunch((*graphs)[std::size_t(k) % 16], stream), "graph");
        };
    };
    frame.for_vjp = false;
    const Stats alone = timed(stream, captured(forward));
    const DeviceRasterizer<WithHalves<A>, TimedDevice, Kernels> by_halves{};
    const Stats halves = timed(
        stream, captured([&](int k) {
            const Set& s = sets[std::size_t(k) % sets.size()];
            const std::size_t camera = std::size_t(k) % 16;
            if (harmonics)
                sh_colors_into(queue, frame.device, s.sh, scene.eyes[camera], s.in.feature.data);
            by_halves.forward_into(queue, s.in, scene.cameras[camera], background, images, frame);
        }));
    frame.for_vjp = true;
    const Stats fwd = timed(stream, captured(forward));
    const Stats both = timed(stream, captured([&](int k) { forward(k), reverse(k); }));
    const auto with_directions = [&](std::size_t count) {
        return timed(stream, captured([&](int k) { forward(k), along(k, count); }));
    };
    const Stats one_way = with_directions(1), two_ways = with_directions(2);
    const Stats eager = timed(stream, [&](int k) { forward(k), reverse(k); });
    if (!frame.finish(queue)) throw Error("raster: a camera did not fit");
    std::printf(
        "%-14s %016llx | forward %.3f [%.3f-%.3f] | for vjp %.3f | both, graph %.3f "
        "[%.3f-%.3f] | both, eager %.3f [%.3f-%.3f] | entries %.0f groups %.0f | "
        "frame %.1f MB\n",
        scene.name.c_str(), static_cast<unsigned long long>(bench::checksum(scene)), alone.median,
        alone.least, alone.most, fwd.median, both.median, both.least, both.most, eager.median,
        eager.least, eager.most, entries, groups, double(frame.bytes()) / 1e6);

    std::printf("    forward with features as halves %.3f [%.3f-%.3f]\n", halves.median,
                halves.least, halves.most);
    std::printf("    with its derivative in one direction %.3f, in two %.3f\n", one_way.median,
                two_ways.median);

    // Kernel by kernel, launched one by one.
    TimedDevice::Times times;
    frame.device.times = &times;
    for (int k = 0; k < 48; ++k) forward(k), reverse(k), along(k, 1);
    check_cuda(cudaStreamSynchronize(stream), "stages");
    frame.device.times = nullptr;
    std::vector<std::pair<std::string, double>> numbers{{"forward_ms", alone.median},
                                                        {"forward_halves_ms", halves.median},
                                                        {"forward_for_vjp_ms", fwd.median},
                                                        {"graph_ms", both.median},
                                                        {"eager_ms", eager.median},
                                                        {"jvp_ms", one_way.median},
                                                        {"jvp_of_two_ms", two_ways.median},
                                                        {"entries", entries},
                                                        {"frame_MB", double(frame.bytes()) / 1e6}};
    for (const auto& [name, events] : times.of) {
        std::vector<float> ms;
        for (const auto& [a, b] : events) {
            float t = 0;
            check_cuda(cudaEventElapsedTime(&t, a, b), "event");
            ms.push_back(t);
        }
        const Stats s = stats(ms);
        std::printf("    %-22s %.4f [%.4f-%.4f]\n", name.c_str(), s.median, s.least, s.most);
        std::string key = name;
        std::replace(key.begin(), key.end(), ' ', '_');
        numbers.push_back({key + "_ms", s.median});
    }
    if (!harmonics) {
        bench::Naive naive(n, int(channels), first.width, first.height,
                           std::size_t(entries * 3) + 1000000);
        const Stats t = timed(
            stream,
            [&](int k) {
                const Set& s = sets[std::size_t(k) % sets.size()];
                naive.run(stream, s.in, scene.cameras[std::size_t(k) % 16], images.feature.data,
                          cotangent.feature.data, s.out);
            },
            40);
        std::printf("    %-22s %.3f: %.1f times the graph's\n", "naive, both", t.median,
                    t.median / both.median);
        numbers.push_back({"naive_ms", t.median});
        numbers.push_back({"naive_ratio", t.median / both.median});
    }
    json.add("cuda_raster/" + scene.name, numbers);
    std::fflush(stdout);
    for (const Set& s : sets)
        for (float* p : {s.in.mean.data, s.in.rotation.data, s.in.scale.data, s.in.opacity.data,
                         s.in.feature.data, s.out.mean.data, s.out.rotation.data, s.out.scale.data,
                         s.out.opacity.data, s.out.feature.data, s.sh.constant.data, s.sh.rest.data,
                         s.g_sh.constant.data, s.g_sh.rest.data})
            static_cast<void>(cudaFree(p));
}

} // namespace

int main(int argc, char** argv) {
    try {
        int devices = 0;
        if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
            std::puts("cuda_raster: skipped, no device is there");
            return 0;
        }
        cudaDeviceProp device{};
        check_cuda(cudaGetDeviceProperties(&device, 0), "device");
        std::printf("%s, %d SMs; rules of Fast; ms, median of 200 [least-most]\n", device.name,
                    device.multiProcessorCount);
        std::vector<std::string> wanted;
        std::string file;
        for (int i = 1; i < argc; ++i)
            if (std::string(argv[i]) == "--json" && i + 1 < argc)
                file = argv[++i];
            else
                wanted.push_back(argv[i]);
        if (wanted.empty()) wanted = {"head100k_c3", "head100k_c32", "head300k_c32", "scene1m"};
        Json json;
        for (const std::string& name : wanted) {
            if (name == "head100k_c3") run<KernelChannels<3>>(bench::head(100000, 3), json);
            if (name == "head300k_c3") run<KernelChannels<3>>(bench::head(300000, 3), json);
            if (name == "head100k_c32") run<KernelChannels<32>>(bench::head(100000, 32), json);
            if (name == "head300k_c32") run<KernelChannels<32>>(bench::head(300000, 32), json);
            if (name == "scene1m") run<KernelChannels<3>>(bench::frustum(1000000), json);
        }
        if (!file.empty()) {
            std::FILE* const f = std::fopen(file.c_str(), "w");
            std::fprintf(f, "{\"benchmarks\": [\n%s\n]}\n", json.rows.c_str());
            std::fclose(f);
        }
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
    return 0;
}
