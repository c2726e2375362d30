// SPDX-License-Identifier: Apache-2.0
// stereo HEAD.avatar [SIZE [FRAMES]]: a trained head for both eyes of a viewer on this device, two
// pictures of SIZE x SIZE (2048), driven once; networks and super-resolution by one and by three
// planes. Milliseconds from new drivers in host memory to both pictures in device memory, as a
// program waits that draws again and again: median, 99th percentile and most of FRAMES (1000), of a
// new gaze, a new expression, a new camera; by single launches, and by graphs (frame_into). Then
// whether both have the same bits, and the pictures of one plane against those of three, in dB.
// Highlights are those that the middle between the eyes sees.
#include <rye/backend/cuda/device.hpp>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include <rye/avatar/cuda/drawer.hpp>
#include <rye/avatar/hold.hpp>
#include <rye/avatar/playable.hpp>
#include <rye/io/avatar_file.hpp>
#include <rye/loss/photometric.hpp>

namespace {

using namespace rye;
using E = TrainedEffects;

/// Distance between a person's pupils over the radius of a head.
constexpr float pupils_over_head = 0.063F / 0.11F;
constexpr int warm_up = 20;
int frames = 1000;

/// Returns the cameras of a left and a right eye, `apart` from one another.
std::array<Pinhole<float>, 2> stereo_cameras(const Pinhole<float>& middle, float apart) {
    std::array<Pinhole<float>, 2> eyes{middle, middle};
    eyes[0].camera_from_world.translation.x() += apart / 2;
    eyes[1].camera_from_world.translation.x() -= apart / 2;
    return eyes;
}

/// Returns a number in [-1, 1] that moves with the frame, at a pace of its own for each k.
float wave(int frame, Index k) {
    return std::sin(0.05F * static_cast<float>(frame) * (1 + 0.13F * static_cast<float>(k)));
}

/// Return neutral drivers with another gaze, or expression, within the ranges of training.
Drivers<float> moved_gaze(const PlayableAvatar<float>& p, int frame) {
    Drivers<float> d = p.neutral;
    for (Index e = 0; e < 2; ++e) {
        Vec2<float> angles;
        for (Index k = 0; k < 2; ++k)
            angles[k] = std::lerp(p.ranges.gaze_low(k, e), p.ranges.gaze_high(k, e),
                                  0.5F + 0.5F * wave(frame, k));
        d.gaze[static_cast<std::size_t>(e)] = gaze_vector(angles[0], angles[1]);
    }
    return d;
}
Drivers<float> moved_expression(const PlayableAvatar<float>& p, int frame) {
    Drivers<float> d = p.neutral;
    for (Index k = 0; k < d.expression.size(); ++k)
        d.expression[k] = std::lerp(p.ranges.expression_low(k), p.ranges.expression_high(k),
                                    0.5F + 0.5F * wave(frame, k));
    return d;
}

/// Prints the milliseconds of f(frame) by the clock.
template <class F>
void print_times(const char* how, const char* name, int planes, const F& f) {
    using Clock = std::chrono::steady_clock;
    std::vector<double> ms;
    for (int k = -warm_up; k < frames; ++k) {
        const Clock::time_point begin = Clock::now();
        f(k + warm_up);
        if (k >= 0)
            ms.push_back(std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
    }
    std::sort(ms.begin(), ms.end());
    std::printf("%d plane%s, %s, new %-10s  median %6.2f ms, 99 %% %6.2f, most %6.2f\n", planes,
                planes == 1 ? " " : "s", how, name, ms[ms.size() / 2], ms[ms.size() * 99 / 100],
                ms.back());
    std::fflush(stdout);
}

/// Prints the times of N planes; returns both pictures of the neutral frame.
template <int N>
std::array<Image<float>, 2> rows(const CudaQueue& queue, const PlayableAvatar<float>& p, int size) {
    using Policy = DeviceDrawingPolicy<DeviceNetworks<N>, KernelChannels<3, 16, 32>, Balanced, N>;
    DeviceAvatarDrawer<E, CudaDevice, Policy> drawer(CudaDevice(), queue,
                                                     {p.avatar, p.config, p.roles});
    const float larger = static_cast<float>(size) / static_cast<float>(p.camera.width);
    Pinhole<float> whole = scaled(p.camera, larger);
    whole.width = whole.height = size;
    const Pinhole<float> small = render_camera(whole, drawer.factor());
    const TrainedSize<float> trained(box_middle(p.avatar.face.position), p.neutral,
                                     render_camera(p.camera, drawer.factor()));
    drawer.set_dilation(trained.dilation(Balanced{}.dilation, p.neutral, small));
    const float apart = pupils_over_head * head_place(p).radius;

    const auto turned = [&](Pinhole<float> c, int frame) {
        c.camera_from_world.translation.x() += 0.5F * apart * wave(frame, 0);
        return c;
    };

    const Index pixels = Index(size) * size;
    DeviceBuffer<float> numbers;
    numbers.reserve(queue, static_cast<std::size_t>(6 * pixels));
    const auto draw = [&](const Pinhole<float>& middle) {
        const std::array<Pinhole<float>, 2> cameras = stereo_cameras(middle, apart);
        for (std::size_t eye = 0; eye < 2; ++eye)
            drawer.draw_into(queue, cameras[eye],
                             {{numbers.data() + 3 * pixels * Index(eye), 3, pixels}, size, size},
                             eye);
    };
    const auto set = [&](const Drivers<float>& drivers) {
        drawer.set_drivers(queue, seen_from(restricted<E>(drivers), small));
    };
    const auto whole_frame = [&](const Drivers<float>& drivers) {
        set(drivers);
        do {
            drawer.drive_into(queue);
            draw(small);
        } while (!drawer.finish(queue));
    };
    whole_frame(p.neutral);
    print_times("launches", "gaze", N, [&](int frame) {
        set(moved_gaze(p, frame));
        bool again = false;
        do {
            if (again)
                drawer.drive_into(queue);
            else
                drawer.regaze_into(queue);
            draw(small);
            again = true;
        } while (!drawer.finish(queue));
    });
    print_times("launches", "expression", N,
                [&](int frame) { whole_frame(moved_expression(p, frame)); });
    whole_frame(p.neutral);
    print_times("launches", "camera", N, [&](int frame) {
        do draw(turned(small, frame));
        while (!drawer.finish(queue));
    });
    const auto fetched = [&] {
        std::array<Image<float>, 2> r{Image<float>(size, size, 3), Image<float>(size, size, 3)};
        for (std::size_t eye = 0; eye < 2; ++eye)
            CudaDevice().fetch(queue, r[eye].pixels.data(),
                               numbers.data() + 3 * pixels * Index(eye),
                               static_cast<std::size_t>(3 * pixels) * sizeof(float));
        return r;
    };
    whole_frame(p.neutral);
    const std::array<Image<float>, 2> pictures = fetched();

    const auto kept_frame = [&](const Drivers<float>& drivers, const Pinhole<float>& middle) {
        const std::array<Pinhole<float>, 2> cameras = stereo_cameras(middle, apart);
        std::array<DeviceView, 2> views{};
        for (std::size_t eye = 0; eye < 2; ++eye)
            views[eye] = {cameras[eye],
                          {{numbers.data() + 3 * pixels * Index(eye), 3, pixels}, size, size}};
        do drawer.frame_into(queue, seen_from(restricted<E>(drivers), small), views);
        while (!drawer.finish(queue));
    };
    print_times("graphs", "gaze", N, [&](int frame) { kept_frame(moved_gaze(p, frame), small); });
    print_times("graphs", "expression", N,
                [&](int frame) { kept_frame(moved_expression(p, frame), small); });
    print_times("graphs", "camera", N,
                [&](int frame) { kept_frame(p.neutral, turned(small, frame)); });
    kept_frame(p.neutral, small);
    const std::array<Image<float>, 2> again = fetched();
    std::printf("graphs and launches: %s, %d graphs\n",
                again[0].pixels == pictures[0].pixels && again[1].pixels == pictures[1].pixels
                    ? "the same bits"
                    : "DIFFERENT BITS",
                static_cast<int>(drawer.graphs()));
    std::printf("%d Gaussians, %.0f MB of device memory\n",
                static_cast<int>(drawer.avatar().face_count() + drawer.avatar().eye_count()),
                static_cast<double>(drawer.bytes()) / 1e6);
    return pictures;
}

} // namespace

int main(int argc, char** argv) {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("cuda_stereo: skipped, no device is there");
        return 0;
    }
    if (argc < 2 || argc > 4) {
        std::puts("cuda_stereo: expected HEAD.avatar, then the pictures' size, then frames");
        return 2;
    }
    try {
        const PlayableAvatar<float> p = read_avatar<float>(argv[1]);
        const int size = argc > 2 ? std::atoi(argv[2]) : 2048;
        if (argc > 3) frames = std::max(std::atoi(argv[3]), 1);
        const int factor = 1 << p.avatar.upsampler.shape.doublings;
        require(size > 0 && size % factor == 0, "cuda_stereo", "got the size ", size,
                ", expected a multiple of ", factor);
        cudaStream_t stream;
        check_cuda(cudaStreamCreate(&stream), "stream");
        StreamMemory memory;
        const CudaQueue queue{stream, memory};
        const auto by_one = rows<1>(queue, p, size), by_three = rows<3>(queue, p, size);
        for (std::size_t eye = 0; eye < 2; ++eye)
            std::printf("%s eye: one plane against three, %.1f dB\n", eye == 0 ? "left" : "right",
                        psnr<float>(by_one[eye].pixels, by_three[eye].pixels, {}));
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
    return 0;
}
