// SPDX-License-Identifier: Apache-2.0
// step [--kernels] [--json FILE]: a training step of stage 2 on this device, part by part, with the
// sizes of the presets cpu, gpu (of 91,000 Gaussians, and of as many as a head of 512 x 512 has)
// and paper-literal, by the tiles that rye takes for their networks, and nothing trained. Each part
// is a CUDA graph of its own, launched in turn with an event between; below, the whole as one
// graph. Milliseconds are medians of 50; launches are nodes of the graph; products are those of
// networks and convolutions, beside what this device was measured to do (limits), as the
// optimiser's bytes are. --kernels: a step's kernels, launched one after the other with events
// around each.
#include <rye/backend/cuda/device.hpp>

#include <algorithm>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <rye/backend/scalar.hpp>
#include <rye/train/cuda/avatar_trainer.hpp>

#include "rates.hpp"
#include "subject.hpp"
#include "timing.hpp"
#include "work.hpp"

namespace {

using namespace rye;

std::string json;

/// Replay of a trainer's graph.
enum class Cut { whole, parts, kernels };

/// A part of a graph.
struct Piece {
    std::string name;
    std::size_t launches;
    std::shared_ptr<CUgraphExec_st> exec;
};
using Events = std::vector<cudaEvent_t>;
struct KernelRun {
    const char* name;
    cudaEvent_t begin, end;
};

cudaEvent_t recorded(cudaStream_t stream) {
    cudaEvent_t e;
    check_cuda(cudaEventCreate(&e), "event");
    check_cuda(cudaEventRecord(e, stream), "event");
    return e;
}

/// Measurements of the one trainer that runs at a time.
struct Recorder {
    Cut cut = Cut::whole;
    bool capturing = false, timing = false;
    std::vector<Piece> pieces;
    std::vector<Events> launches;   ///< before, between and after the pieces
    std::vector<KernelRun> kernels; ///< of one step

    void begin(cudaStream_t stream) const {
        check_cuda(cudaStreamBeginCapture(stream, cudaStreamCaptureModeThreadLocal), "graph");
    }
    void end(cudaStream_t stream, const char* name) {
        cudaGraph_t graph = nullptr;
        check_cuda(cudaStreamEndCapture(stream, &graph), "graph");
        std::size_t nodes = 0;
        check_cuda(cudaGraphGetNodes(graph, nullptr, &nodes), "graph");
        cudaGraphExec_t exec = nullptr;
        if (nodes > 0) {
            check_cuda(cudaGraphInstantiate(&exec, graph, 0), "graph");
            pieces.push_back(
                {name, nodes, {exec, [](cudaGraphExec_t e) { cudaGraphExecDestroy(e); }}});
        }
        check_cuda(cudaGraphDestroy(graph), "graph");
    }
    /// Times of the pieces and of all of them together, without the first launches.
    std::vector<bench::Times> times() {
        std::vector<std::vector<float>> ms(pieces.size() + 1);
        for (std::size_t l = 0; l < launches.size(); ++l) {
            const Events& e = launches[l];
            const auto between = [&](std::size_t a, std::size_t b) {
                float t = 0;
                check_cuda(cudaEventElapsedTime(&t, e[a], e[b]), "event");
                return t;
            };
            if (l >= 10) {
                for (std::size_t k = 0; k < pieces.size(); ++k) ms[k].push_back(between(k, k + 1));
                ms.back().push_back(between(0, pieces.size()));
            }
        }
        for (const Events& e : launches)
            for (const cudaEvent_t own : e) check_cuda(cudaEventDestroy(own), "event");
        launches.clear();
        std::vector<bench::Times> r;
        for (auto& m : ms) {
            std::sort(m.begin(), m.end());
            r.push_back({m[m.size() / 2], m.front(), m.back()});
        }
        return r;
    }
};
Recorder recorder;

__global__ void wait(long long cycles) {
    const long long begin = clock64();
    while (clock64() - begin < cycles) {}
}

/// A step as graphs of its parts.
struct PartGraphs {
    template <class F>
    static PartGraphs of(const CudaQueue& queue, const F& f) {
        if (recorder.cut == Cut::kernels) { // once, as it is, while the device waits for the host
            wait<<<1, 1, 0, queue.stream>>>(40'000'000);
            recorder.timing = true;
            f();
            recorder.timing = false;
            return {};
        }
        recorder.pieces.clear();
        recorder.begin(queue.stream);
        recorder.capturing = true;
        f();
        recorder.capturing = false;
        recorder.end(queue.stream, "whole");
        return {};
    }
    void launch(const CudaQueue& queue) const {
        if (recorder.cut == Cut::kernels) return;
        Events e{recorded(queue.stream)};
        for (const Piece& p : recorder.pieces) {
            check_cuda(cudaGraphLaunch(p.exec.get(), queue.stream), "graph");
            e.push_back(recorded(queue.stream));
        }
        recorder.launches.push_back(e);
    }
};

/// A branch, but where kernels are timed one after the other.
struct TimedBranch {
    CudaBranch own;

    CudaQueue begin(const CudaQueue& queue) { return recorder.timing ? queue : own.begin(queue); }
    void end(const CudaQueue& queue) const {
        if (!recorder.timing) own.end(queue);
    }
};

/// A device that is told where a step's parts end.
struct PartsDevice : CudaDevice {
    using Graph = PartGraphs;
    using Branch = TimedBranch;

    void probe(const CudaQueue& queue, const char* part) const {
        if (!recorder.capturing || recorder.cut != Cut::parts) return;
        recorder.end(queue.stream, part);
        recorder.begin(queue.stream);
    }
    template <class Kernel>
    void launch(const CudaQueue& queue, Index blocks, const Kernel& kernel) const {
        if (blocks > 0)
            timed(queue, Kernel::name, [&] { CudaDevice::launch(queue, blocks, kernel); });
    }
    void fill(const CudaQueue& queue, void* p, int byte, std::size_t bytes) const {
        if (bytes > 0) timed(queue, "fill", [&] { CudaDevice::fill(queue, p, byte, bytes); });
    }

  private:
    template <class F>
    static void timed(const CudaQueue& queue, const char* name, const F& f) {
        if (!recorder.timing) return f();
        const cudaEvent_t begin = recorded(queue.stream);
        f();
        recorder.kernels.push_back({name, begin, recorded(queue.stream)});
    }
};

/// A preset of `rye train`, as far as times depend on it.
struct StepSizes {
    const char* name;
    bench::DeviceSubjectSizes subject;
    int side; ///< of the picture [px]
    bool scaled;
    AvatarLossConfig weights;
    EyeballBounds bounds;
};

StepSizes narrow(const char* name, int side, int feature, int channels, int wide) {
    StepSizes s{name, {}, side, false, {}, {0.7, 0.1}};
    AvatarConfig& c = s.subject.config;
    c.expression = 64;
    c.feature = feature;
    c.channels = channels;
    c.pose_frequencies = c.gaze_frequencies = 1;
    NetworkConfig& n = c.networks;
    n.exp_color = n.exp_attributes = {wide, wide};
    n.gaze_color = {wide};
    n.pose_color = n.pose_attributes = {64};
    n.exp_deform = {128, 128, 128, 128};
    n.pose_deform = {128, 128};
    n.gaze_deform = {128, 128, 128};
    n.eye_offset = {64, 64};
    s.subject.upsampler = {channels, channels, 0, Normalization::none, true};
    AvatarLossConfig& w = s.weights;
    w.dssim = w.eye_smooth = 0.2;
    w.face_alone = 1;
    return s;
}
StepSizes cpu() {
    StepSizes s = narrow("cpu", 256, 32, 8, 64);
    s.subject.points = 55000, s.subject.of_an_eye = 2500;
    s.weights.eye_high_every = 3;
    return s;
}
StepSizes gpu() {
    StepSizes s = narrow("gpu", 512, 64, 16, 128);
    s.subject.points = 83000, s.subject.of_an_eye = 4000;
    return s;
}
StepSizes gpu_large() {
    StepSizes s = gpu();
    s.name = "gpu, large";
    s.subject.points = 266000, s.subject.of_an_eye = 4500;
    return s;
}
StepSizes paper() {
    StepSizes s{"paper-literal", {}, 512, true, {}, {}};
    s.subject.config.expression = 64;
    s.subject.points = 107000, s.subject.of_an_eye = 1500;
    return s;
}

/// A picture of a head in front: an ellipse, with both eyes.
TrainingView view_of(const StepSizes& s) {
    TrainingView v;
    const int factor = 1 << s.subject.upsampler.doublings, render = s.side / factor;
    v.camera = bench::head(2000, 3, render, 860.0 * render / 512).cameras.front();
    v.frame = 0;
    v.width = v.height = s.side;
    for (int y = 0; y < s.side; ++y)
        for (int x = 0; x < s.side; ++x) {
            const auto within = [&](double at_x, double at_y, double rx, double ry) {
                const double a = (x / double(s.side) - at_x) / rx,
                             b = (y / double(s.side) - at_y) / ry;
                return static_cast<std::uint8_t>(a * a + b * b < 1 ? 255 : 0);
            };
            const std::uint8_t inside = within(0.5, 0.5, 0.42, 0.48);
            v.mask.push_back(inside);
            v.visible.push_back(255);
            v.eyes.push_back(within(0.36, 0.38, 0.05, 0.03) | within(0.64, 0.38, 0.05, 0.03));
            for (int c = 0; c < 3; ++c)
                v.rgb.push_back(inside == 0 ? std::uint8_t(0)
                                            : static_cast<std::uint8_t>(90 + (x + y * c) % 130));
        }
    return v;
}

/// Products of two numbers of the networks over points, forward.
template <EffectSet E>
double network_products(const bench::DeviceSubject<E>& s) {
    const FaceStream<float, E>& f = s.avatar.face;
    WeightsTrace<float, E> nearest;
    const Weights<float, E> w =
        face_weights<float>(ScalarBackend<>{}, {s.config, f.seen(), f.landmarks}, s.roles, nearest);
    double sum = 0;
    const auto add = [&](const MlpShape& shape, const Columns<float>& lambda) {
        sum += bench::products(shape) * static_cast<double>((lambda.array() > 0).count());
    };
    for_face_fields<E>([&](auto by) {
        add(by.color(f.networks).shape, by.influence(w));
        add(by.deform(f.networks).shape, by.influence(w));
    });
    for_attribute_fields<E>([&](auto by) { add(by.attribute(f).shape, by.influence(w)); });
    if constexpr (std::same_as<EyeAppearanceOf<E>, DrivenFeatures>)
        for (Index eye = 0; eye < 2; ++eye)
            sum += bench::products(s.avatar.eyes.networks[std::size_t(eye)].shape) *
                   static_cast<double>(s.avatar.eyes.points_of(eye));
    return sum;
}

/// Measured rates of the device, a second.
struct Rates {
    double flops, bytes;
};

/// Work of a part.
struct PartWork {
    double flops = 0, bytes = 0;
};

void print_row(const StepSizes& s, const Piece& p, const bench::Times& times, float step,
               const PartWork& work, const Rates& rates) {
    const float ms = times.median;
    std::printf("  %-24s %8.3f [%.3f-%.3f] %6.1f%% %9zu", p.name.c_str(), double(ms),
                double(times.least), double(times.most), 100 * double(ms) / double(step),
                p.launches);
    const double flops = work.flops / double(ms) * 1e3, bytes = work.bytes / double(ms) * 1e3;
    if (flops > 0) std::printf(" %8.1f TFLOP/s %5.1f%%", flops * 1e-12, 100 * flops / rates.flops);
    if (bytes > 0) std::printf(" %8.2f TB/s    %5.1f%%", bytes * 1e-12, 100 * bytes / rates.bytes);
    std::printf("\n");
    char text[256];
    std::snprintf(
        text, sizeof text,
        "%s  {\"name\": \"cuda_step/%s/%s\", \"ms\": %.5g, \"least_ms\": %.5g, \"launches\": %zu, "
        "\"tflops\": %.5g, \"terabytes\": %.5g}",
        json.empty() ? "" : ",\n", s.name, p.name.c_str(), double(ms), double(times.least),
        p.launches, flops * 1e-12, bytes * 1e-12);
    json += text;
}

void print_kernels() {
    struct Sum {
        double ms = 0;
        int launches = 0;
    };
    std::map<std::string, Sum> sums;
    double all = 0;
    for (const KernelRun& k : recorder.kernels) {
        float ms = 0;
        check_cuda(cudaEventElapsedTime(&ms, k.begin, k.end), "event");
        check_cuda(cudaEventDestroy(k.begin), "event");
        check_cuda(cudaEventDestroy(k.end), "event");
        Sum& s = sums[k.name];
        s.ms += double(ms), ++s.launches, all += double(ms);
    }
    recorder.kernels.clear();
    std::vector<std::pair<std::string, Sum>> order(sums.begin(), sums.end());
    std::sort(order.begin(), order.end(),
              [](const auto& a, const auto& b) { return a.second.ms > b.second.ms; });
    for (const auto& [name, sum] : order)
        std::printf("    %-40s %5d x %8.4f ms %6.1f%%\n", name.c_str(), sum.launches, sum.ms,
                    100 * sum.ms / all);
    std::printf("    %-40s %5s   %8.4f ms\n", "all, one after the other", "", all);
}

template <EffectSet E, class Networks>
void table(const CudaQueue& queue, const StepSizes& s, const Rates& rates, bool kernels) {
    using Policy = DeviceTrainerPolicy<Networks, KernelChannels<3, 16, 32>>;
    const bench::DeviceSubject<E> subject(s.subject);
    const Adam<TwoStream<float, E>> adam(subject.avatar);
    AvatarTraining<> training{subject.config, subject.roles, {}, {}, s.bounds};
    training.objective.weights = s.weights;
    const PartsDevice device;
    DevicePyramidLoss<PartsDevice> perceptual(device);
    DeviceAvatarTrainer<E, PartsDevice, Policy> trainer(device, queue, {subject.avatar, adam},
                                                        training, perceptual);
    const TrainingView view = view_of(s);
    trainer.add(queue, view, subject.drivers);
    StepDraw draw;
    draw.scaled = s.scaled;
    if (s.scaled)
        draw.scale = rye::detail::random_resizing(view.camera.width, view.camera.height, Random(4));
    draw.blank = {0.2F, 0.7F, 0.4F};
    draw.rate = 0.01;
    // Another number of steps is another graph.
    const auto run = [&](Cut cut, std::size_t steps) {
        recorder.cut = cut;
        const DeviceStepsReport r = trainer.run(queue, std::vector<StepDraw>(steps, draw));
        require(r.refused_in_a_row == 0, s.name, "gradient of " + r.bad_field + " is not finite");
    };
    run(Cut::whole, 3);
    recorder.launches.clear();
    run(Cut::parts, 61);
    const std::vector<Piece> parts = recorder.pieces;
    const std::vector<bench::Times> ms = recorder.times();
    run(Cut::whole, 62);
    std::vector<Piece> whole = recorder.pieces;
    std::vector<bench::Times> whole_ms{recorder.times().front()};
    whole.front().name = "one graph";
    if (s.weights.eye_high_every > 1) {
        draw.eyes_high = false;
        run(Cut::whole, 3); // takes its memory
        recorder.launches.clear();
        run(Cut::whole, 63);
        whole.push_back(recorder.pieces.front());
        whole_ms.push_back(recorder.times().front());
        whole.back().name = "... without the eyes' high";
        draw.eyes_high = true;
    }

    double parameters = 0;
    TwoStream<float, E>::fields(
        [&](const std::string&, const auto& a) { parameters += static_cast<double>(a.size()); },
        subject.avatar);
    const double of_networks = 2 * network_products(subject);
    const double pixels = double(view.camera.width) * view.camera.height;
    const double of_images = 2 * 2 * bench::products(subject.avatar.upsampler.shape, pixels);
    std::map<std::string, PartWork> work;
    work["drive"].flops = of_networks, work["drive, back"].flops = 2 * of_networks;
    work["super-resolution"].flops = of_images;
    work["super-resolution, back"].flops = 2 * of_images;
    // The gradient is read twice, parameters and moments once; these are written.
    work["optimiser"].bytes = 32 * parameters;
    work["one graph"].flops = 3 * (of_networks + of_images);
    std::printf(
        "%s: %lld points of the face, %lld of the eyes, %d x %d from %d x %d, %.3g million "
        "parameters, %.0f MB\n  %-24s %8s [least-most] %9s %9s\n",
        s.name, static_cast<long long>(s.subject.points),
        static_cast<long long>(2 * s.subject.of_an_eye), view.width, view.height, view.camera.width,
        view.camera.height, parameters * 1e-6, double(trainer.memory().sum()) / 1e6, "part", "ms", "share",
        "launches");
    const float step = ms.back().median;
    for (std::size_t k = 0; k < parts.size(); ++k)
        print_row(s, parts[k], ms[k], step, work[parts[k].name], rates);
    std::size_t launches = 0;
    for (const Piece& p : parts) launches += p.launches;
    print_row(s, {"all parts", launches, nullptr}, ms.back(), step, {}, rates);
    for (std::size_t k = 0; k < whole.size(); ++k)
        print_row(s, whole[k], whole_ms[k], step, work[whole[k].name], rates);
    if (kernels) {
        run(Cut::kernels, 2); // the first takes its memory, if that was of another kind
        print_kernels();
    }
    std::fflush(stdout);
}

} // namespace

int main(int argc, char** argv) {
    const bool kernels = argc > 1 && std::string(argv[1]) == "--kernels";
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("cuda_step: skipped, no device is there");
        return 0;
    }
    try {
        float* memory = nullptr;
        check_cuda(cudaMalloc(&memory, bench::copied_memory), "memory");
        // A product of matrices is 16 x 8 x 16 multiply-adds.
        const Rates rates{4096 * bench::instructions<bench::Work::product>(memory),
                          bench::copied_bytes(memory)};
        check_cuda(cudaFree(memory), "memory");
        std::printf("this device: products of bf16 %.0f TFLOP/s, copies %.2f TB/s\n",
                    rates.flops * 1e-12, rates.bytes * 1e-12);
        cudaStream_t stream;
        check_cuda(cudaStreamCreate(&stream), "stream");
        StreamMemory arena;
        const CudaQueue queue{stream, arena};
        using Lit = More<PaperEffects, HeadShading, EyesBy<DrivenFeatures>>;
        using Narrow = DeviceNetworks<1, 128, 64, 32>;
        table<Lit, Narrow>(queue, cpu(), rates, kernels);
        table<Lit, Narrow>(queue, gpu(), rates, kernels);
        table<Lit, Narrow>(queue, gpu_large(), rates, kernels);
        table<PaperEffects, DeviceNetworks<1>>(queue, paper(), rates, kernels);
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
    return bench::write_rows(argc - (kernels ? 1 : 0), argv + (kernels ? 1 : 0), json);
}
