// SPDX-License-Identifier: Apache-2.0
// What it takes to find a frame's gazes and head pose by its pictures: Gauss-Newton steps with
// derivatives by forward mode (rye/train/refine_labels.hpp), and Adam with gradients by reverse
// mode, with the same unknowns, pictures and cost. The pictures are the avatar's own, of three
// cameras, so the truth is known; the labels are off as a tracker's are. Prints a table.
//     bench_refine [--run RUN --capture CAPTURE] [--threads N] [--steps N]
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <string>

#include <rye/core/thread_pool.hpp>
#include <rye/splat/lanes.hpp>
#include <rye/train/host_label_drawing.hpp>

#include "../effects/subject.hpp"
#include "methods.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

using B = XsimdBackend<DefaultArch, ThreadPool::Handle>;
using Labels = Drivers<float, TrainedEffects>;
using Task = LabelTask<Labels>;

/// The gradient of the cost by reverse mode: Huber's of the pixels.
class ReverseCost {
  public:
    ReverseCost(const B& backend, const Subject& of, const Task& task, double noise)
        : backend_(backend),
          of_(of),
          task_(task),
          noise_(noise) {}
    VecX<double> operator()(const Labels& at) {
        TwoStreamTrace<float, TrainedEffects> trace;
        drive(backend_, of_.avatar, {of_.config, of_.roles, at}, trace);
        Gaussians<float> g = trace.gaussians;
        g.feature = Columns<float>(g.feature.topRows(3));
        Gaussians<float> sum = zeros_like(trace.gaussians);
        for (const LabelView<float>& v : task_.views) {
            const VecX<float> background = v.background;
            const auto raster = rasterizer_.forward(backend_, g, v.camera, background);
            const Columns<float> slope = (raster.feature.pixels - v.truth).unaryExpr([&](float r) {
                const double scaled = static_cast<double>(r) / noise_;
                const double bent = std::clamp(scaled, -settings_.huber, settings_.huber);
                return static_cast<float>(2 * bent / (noise_ * settings_.alike));
            });
            const Gaussians<float> part =
                rasterizer_.vjp(backend_, g, v.camera, background, raster, slope);
            sum.mean += part.mean, sum.rotation += part.rotation, sum.scale += part.scale;
            sum.opacity += part.opacity;
            sum.feature.topRows(3) += part.feature;
        }
        TrainedAvatar<float> grad = zeros_like(of_.avatar);
        const Vec<float, 6> pose =
            drive_vjp(backend_, of_.avatar, {of_.config, of_.roles, at}, trace, {sum, grad});
        VecX<double> all(10); // a kappa is added to the angles of its eye's gaze
        all << grad.eyes.kappa.reshaped().cast<double>(), pose.cast<double>();
        return all;
    }

  private:
    B backend_;
    const Subject& of_;
    const Task& task_;
    RefineSettings settings_;
    Rasterizer<FeaturesOnly<Balanced>> rasterizer_;
    double noise_;
};

} // namespace

int main(int argc, char** argv) {
    int threads = 0, most = 400;
    for (int i = 1; i < argc; i += 2) {
        const std::string name = argv[i];
        if (i + 1 == argc ||
            (name != "--run" && name != "--capture" && name != "--threads" && name != "--steps")) {
            std::fprintf(stderr,
                         "bench_refine: got '%s', expected --run RUN, --capture CAPTURE, "
                         "--threads N or --steps N\n",
                         argv[i]);
            return 2;
        }
        if (name == "--run") subject_options().run = argv[i + 1];
        if (name == "--capture") subject_options().capture = argv[i + 1];
        if (name == "--threads") threads = std::atoi(argv[i + 1]);
        if (name == "--steps") most = std::atoi(argv[i + 1]);
    }
    ThreadPool pool(threads);
    const B backend{pool.threads()};
    Subject s = subject();
    s.avatar.eyes.optics = {}; // views of one moment see highlights elsewhere
    if (s.avatar.eyes.kappa.size() == 0) s.avatar.eyes.kappa = Columns<float>::Zero(2, 2);
    HostLabelDrawing drawing(backend, s.avatar, s.config, s.roles);
    Task task{s.drivers, {}};
    TwoStreamTrace<float, TrainedEffects> trace;
    drive(backend, s.avatar, {s.config, s.roles, task.truth}, trace);
    const Vec3<float> middle =
        trace.gaussians.mean.rightCols(trace.eye_columns().count).rowwise().mean();
    drawing.drive(task.truth);
    photograph(drawing, s.camera, middle, task);
    task.mislabel();
    std::printf("%s, %d threads; 3 pictures of %d x %d pixels, 10 unknowns\n\n", s.name.c_str(),
                pool.size(), task.views[0].camera.width, task.views[0].camera.height);
    ReverseCost cost(backend, s, task, noise_at_labels(drawing, task));
    return compare_methods(backend.threads, drawing, cost, task, most) ? 0 : 1;
}
