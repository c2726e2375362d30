// SPDX-License-Identifier: Apache-2.0
// drive [--json FILE]: an avatar on this device: 100,000 points of the face and 4,096 of the eyes,
// 32 channels, the paper's effects and networks, a picture of 512 x 512; by 1, 2 and 3 planes.
// Milliseconds of a CUDA graph, median of 100 [least-most], of a frame with new parameters, of one
// with other drivers alone, of one with another gaze alone, of a frame and its vjp, and of these
// with the picture; of a picture as programs draw it, super-resolved from 128 x 128, in device
// memory, and in the host's with drivers that come from there; then the parts of a frame and its
// vjp, kernel by kernel, launched one after the other with an event between, and the memory that is
// held.
#include <rye/backend/cuda/device.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <map>
#include <string>
#include <vector>

#include <rye/avatar/cuda/drawer.hpp>

#include "subject.hpp"
#include "timing.hpp"

namespace {

using namespace rye;
using E = PaperEffects;
using Subject = bench::DeviceSubject<E>;

std::string json;

/// The times of each kernel's launches.
struct Parts {
    struct Part {
        std::string name;
        cudaEvent_t begin, end;
    };
    std::vector<Part> parts;
    bool on = false;
};

/// A device that puts events around what it launches, while it is asked to.
struct TimedDevice {
    Parts* timed = nullptr;
    CudaDevice device = {};

    template <class Kernel>
    void launch(const CudaQueue& queue, Index blocks, const Kernel& kernel) const {
        if (timed == nullptr || !timed->on) return device.launch(queue, blocks, kernel);
        Parts::Part part{Kernel::name, nullptr, nullptr};
        check_cuda(cudaEventCreate(&part.begin), "event");
        check_cuda(cudaEventCreate(&part.end), "event");
        check_cuda(cudaEventRecord(part.begin, queue.stream), "event");
        device.launch(queue, blocks, kernel);
        check_cuda(cudaEventRecord(part.end, queue.stream), "event");
        timed->parts.push_back(part);
    }
    void fill(const CudaQueue& q, void* p, int byte, std::size_t bytes) const {
        device.fill(q, p, byte, bytes);
    }
    void send(const CudaQueue& q, void* to, const void* from, std::size_t bytes) const {
        device.send(q, to, from, bytes);
    }
    void fetch(const CudaQueue& q, void* to, const void* from, std::size_t bytes) const {
        device.fetch(q, to, from, bytes);
    }
};

using bench::Times, bench::graph_times;

void print_parts(Parts& timed) {
    struct Sum {
        double ms = 0;
        int launches = 0;
    };
    std::map<std::string, Sum> sums;
    double all = 0;
    for (const Parts::Part& p : timed.parts) {
        float ms = 0;
        check_cuda(cudaEventElapsedTime(&ms, p.begin, p.end), "event");
        check_cuda(cudaEventDestroy(p.begin), "event");
        check_cuda(cudaEventDestroy(p.end), "event");
        sums[p.name].ms += double(ms);
        ++sums[p.name].launches;
        all += double(ms);
    }
    timed.parts.clear();
    std::vector<std::pair<std::string, Sum>> order(sums.begin(), sums.end());
    std::sort(order.begin(), order.end(),
              [](const auto& a, const auto& b) { return a.second.ms > b.second.ms; });
    std::printf("  %-38s %9s %9s %7s\n", "kernel", "launches", "ms", "share");
    for (const auto& [name, sum] : order)
        std::printf("  %-38s %9d %9.4f %6.1f%%\n", name.c_str(), sum.launches, sum.ms,
                    100 * sum.ms / all);
    std::printf("  %-38s %9s %9.4f\n", "all, one after the other", "", all);
}

void print_row(const char* name, int planes, const Times& s) {
    std::printf("  %-38s %.3f ms [%.3f-%.3f]\n", name, double(s.median), double(s.least),
                double(s.most));
    char text[192];
    std::snprintf(text, sizeof text, "%s  {\"name\": \"cuda_drive/%s/planes:%d\", \"ms\": %.5g}",
                  json.empty() ? "" : ",\n", name, planes, double(s.median));
    json += text;
    std::fflush(stdout);
}

/// Milliseconds by the clock, of 100 calls after 5.
template <class F>
Times clock_times(const F& f) {
    using Clock = std::chrono::steady_clock;
    std::vector<float> ms;
    for (int k = 0; k < 105; ++k) {
        const Clock::time_point begin = Clock::now();
        f();
        if (k >= 5)
            ms.push_back(std::chrono::duration<float, std::milli>(Clock::now() - begin).count());
    }
    std::sort(ms.begin(), ms.end());
    return {ms[ms.size() / 2], ms.front(), ms.back()};
}

/// Pictures as programs draw them.
template <int N>
void picture_rows(const CudaQueue& queue, const Subject& subject) {
    using Policy = DeviceDrawingPolicy<DeviceNetworks<N>, KernelChannels<3, 32>, Balanced, N>;
    DeviceAvatarDrawer<E, CudaDevice, Policy> drawer(
        CudaDevice(), queue, {subject.avatar, subject.config, subject.roles});
    const Pinhole<float> camera = bench::head(2000, 3).cameras.front();
    Pinhole<float> small = camera;
    small.width /= drawer.factor(), small.height /= drawer.factor();
    for (float* const number : {&small.fx, &small.fy, &small.cx, &small.cy})
        *number /= static_cast<float>(drawer.factor());
    const Index pixels = Index(camera.width) * camera.height;
    DeviceBuffer<float> images;
    images.reserve(queue, static_cast<std::size_t>(5 * pixels));
    const DevicePicture<float> picture{{images.data(), 3, pixels}, camera.width, camera.height};
    const DeviceColumns<float> shares{images.data() + 3 * pixels, 2, pixels};
    drawer.set_drivers(queue, subject.drivers);
    do {
        drawer.drive_into(queue);
        drawer.draw_into(queue, small, picture);
        drawer.eyes_into(queue, camera, shares);
    } while (!drawer.finish(queue));
    const auto draw = [&] {
        drawer.drive_into(queue);
        drawer.draw_into(queue, small, picture);
    };
    print_row("picture by other drivers", N, graph_times(queue.stream, draw));
    print_row("picture by another gaze alone", N, graph_times(queue.stream, [&] {
                  drawer.regaze_into(queue);
                  drawer.draw_into(queue, small, picture);
              }));
    print_row("the eyes' shares of a driven avatar", N,
              graph_times(queue.stream, [&] { drawer.eyes_into(queue, camera, shares); }));
    Drivers<float, E> drivers = subject.drivers;
    const auto shown = [&] {
        drawer.drive(queue, drivers);
        static_cast<void>(drawer.picture(queue, small));
    };
    print_row("picture in host memory, new expression", N, clock_times([&] {
                  drivers.expression *= -1;
                  shown();
              }));
    print_row("picture in host memory, new gaze", N, clock_times([&] {
                  std::swap(drivers.gaze[0], drivers.gaze[1]);
                  shown();
              }));
    std::printf("  memory of a drawer %.0f MB\n", double(drawer.bytes()) / 1e6);
}

template <int N>
void rows(const CudaQueue& queue, const Subject& subject) {
    using Networks = DeviceNetworks<N>;
    Parts timed;
    const TimedDevice device{&timed};
    DeviceTwoStream<E, TimedDevice, Networks> avatar(
        device, queue, {subject.avatar, subject.config, subject.roles});
    avatar.set_drivers(queue, subject.drivers, 0);
    Resident<TwoStream<float, E>, TimedDevice> gradient(device, queue, avatar.layout());
    const Pinhole<float> camera =
        bench::head(2000, 3).cameras.front(); // 512 x 512, in front of the face
    const Index channels = subject.config.channels, pixels = Index(camera.width) * camera.height;
    DeviceBuffer<float> images, weights;
    images.reserve(queue, static_cast<std::size_t>((channels + 1) * pixels + channels));
    weights.reserve(queue, static_cast<std::size_t>(channels * pixels));
    device.fill(queue, images.data(), 0, images.bytes());
    device.fill(queue, weights.data(), 0x3C, weights.bytes()); // 0.0115 everywhere
    const DeviceColumns<float> feature{images.data(), channels, pixels},
        alpha{images.data() + channels * pixels, 1, pixels};
    const float* const background = images.data() + (channels + 1) * pixels;
    const DeviceRasterizer<FeaturesOnly<Fast>, TimedDevice, KernelChannels<32>> rasterizer{};
    DeviceFrame<TimedDevice> frame(device);
    const auto draw = [&] {
        rasterizer.forward_into(queue, avatar.cloud(), camera, background, {feature, alpha}, frame);
    };
    const auto pull = [&] {
        rasterizer.vjp_into(queue, avatar.cloud(), camera, background,
                            {DeviceColumns<const float>{weights.data(), channels, pixels}},
                            avatar.g_cloud(queue), frame);
        avatar.vjp_into(queue, gradient);
    };
    do {
        avatar.drive_into(queue);
        draw();
    } while (!avatar.finish(queue) || !frame.finish(queue));
    pull();
    check_cuda(cudaStreamSynchronize(queue.stream), "first");
    std::printf("%d planes: points that drivers move:", N);
    for (const std::uint32_t n : avatar.listed(queue)) std::printf(" %u", n);
    std::printf("; memory %.0f MB, of a frame's picture %.0f MB\n", double(avatar.bytes()) / 1e6,
                double(frame.bytes()) / 1e6);
    const auto row = [&](const char* name, const auto& f) {
        print_row(name, N, graph_times(queue.stream, f));
    };
    row("drive", [&] { avatar.drive_into(queue); });
    row("drive, not for a vjp", [&] { avatar.drive_into(queue, false); });
    row("drive by other drivers", [&] { avatar.redrive_into(queue); });
    row("drive by other drivers and draw", [&] { avatar.redrive_into(queue), draw(); });
    row("drive by another gaze alone", [&] { avatar.regaze_into(queue); });
    row("drive by another gaze alone and draw", [&] { avatar.regaze_into(queue), draw(); });
    row("drive and vjp", [&] { avatar.drive_into(queue), avatar.vjp_into(queue, gradient); });
    row("drive, draw, and vjp of both", [&] { avatar.drive_into(queue), draw(), pull(); });
    for (const bool warm : {true, false}) {
        timed.on = !warm;
        avatar.drive_into(queue), draw(), pull();
        check_cuda(cudaStreamSynchronize(queue.stream), "parts");
    }
    timed.on = false;
    print_parts(timed);
    picture_rows<N>(queue, subject);
}

} // namespace

int main(int argc, char** argv) {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("cuda_drive: skipped, no device is there");
        return 0;
    }
    try {
        cudaStream_t stream;
        check_cuda(cudaStreamCreate(&stream), "stream");
        StreamMemory memory;
        const CudaQueue queue{stream, memory};
        bench::DeviceSubjectSizes sizes;
        sizes.config.expression = 64;
        const Subject subject(sizes);
        rows<1>(queue, subject);
        rows<2>(queue, subject);
        rows<3>(queue, subject);
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
    return bench::write_rows(argc, argv, json);
}
