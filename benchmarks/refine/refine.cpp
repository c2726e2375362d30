// SPDX-License-Identifier: Apache-2.0
// What it takes to find a frame's gazes and head pose by its pictures: Gauss-Newton steps with
// derivatives by forward mode (rye/train/refine_labels.hpp), and Adam with gradients by reverse
// mode, with the same unknowns, pictures and cost. The pictures are the avatar's own, of three
// cameras, so the truth is known; the labels are off as a tracker's are. Prints a table.
//     bench_refine [--run RUN --capture CAPTURE] [--threads N] [--steps N]
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include <rye/core/thread_pool.hpp>
#include <rye/nn/adam.hpp>
#include <rye/rig/gaze.hpp>
#include <rye/splat/lanes.hpp>
#include <rye/train/host_label_drawing.hpp>
#include <rye/train/refine_labels.hpp>

#include "../effects/subject.hpp"
#include "../roofline/clock.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

using B = XsimdBackend<DefaultArch, ThreadPool::Handle>;
using Labels = Drivers<float, TrainedEffects>;
using Policy = FeaturesOnly<Balanced>;
constexpr double degree = 0.017453292519943295;

/// Where a method may have arrived.
struct Goal {
    double gaze, turn; ///< [degrees]
};
constexpr Goal goals[] = {{0.1, 0.02}, {0.01, 0.002}};
constexpr std::size_t goal_count = 2;
/// Seconds until a method came to each; below 0: never.
using Arrivals = std::array<double, goal_count>;

/// Distance of labels from the truth.
struct Distance {
    double gaze = 0;  ///< mean of both eyes [degrees]
    double turn = 0;  ///< of the head [degrees]
    double shift = 0; ///< of the head [world units]
};

/// Notes the time of goals that are reached for the first time; returns true if one was.
bool arrive(const Distance& d, double seconds, Arrivals& at) {
    bool fresh = false;
    for (std::size_t k = 0; k < goal_count; ++k)
        if (at[k] < 0 && d.gaze <= goals[k].gaze && d.turn <= goals[k].turn)
            at[k] = seconds, fresh = true;
    return fresh;
}

Distance distance(const Labels& a, const Labels& b) {
    Distance d;
    for (std::size_t e = 0; e < 2; ++e)
        d.gaze += 0.5 / degree *
                  angular_error(Vec3<double>(a.gaze[e].cast<double>()),
                                Vec3<double>(b.gaze[e].cast<double>()));
    const Vec<double, 6> p = (a.pose - b.pose).cast<double>();
    d.turn = p.head<3>().norm() / degree;
    d.shift = p.tail<3>().norm();
    return d;
}

void print(const char* method, int steps, double seconds, const Distance& d) {
    std::printf("| %s | %d | %.3f | %.3f | %.4f | %.5f |\n", method, steps, seconds, d.gaze, d.turn,
                d.shift);
}

/// The avatar, what its frame truly is, and the pictures.
struct Task {
    B backend;
    TrainedAvatar<float> avatar;
    AvatarConfig config;
    LandmarkRoles roles;
    Labels truth, label;
    LabelUnknowns unknowns;
    std::vector<LabelView<float>> views;
};

Gaussians<float> driven(const Task& t, const Labels& at,
                        TwoStreamTrace<float, TrainedEffects>& trace) {
    drive(t.backend, t.avatar, {t.config, t.roles, at}, trace);
    Gaussians<float> g = trace.gaussians;
    g.feature = Columns<float>(g.feature.topRows(3));
    return g;
}

/// The camera, turned about the vertical through a point.
Pinhole<float> turned(const Pinhole<float>& camera, const Vec3<float>& middle, float yaw) {
    const Vec3<float> away = camera.centre() - middle;
    const Vec3<float> to(std::cos(yaw) * away.x() + std::sin(yaw) * away.z(), away.y(),
                         std::cos(yaw) * away.z() - std::sin(yaw) * away.x());
    const float up = 2 * std::atan(0.5f * static_cast<float>(camera.height) / camera.fy);
    return look_at<float>(Vec3<float>(middle + to), middle, Vec3<float>(0, 1, 0), up,
                          {camera.width, camera.height});
}

Task make_task(const B& backend) {
    const Subject& s = subject();
    Task t{backend, s.avatar, s.config, s.roles, s.drivers, {}, {}, {}};
    t.avatar.eyes.optics = {}; // views of one moment see highlights elsewhere
    if (t.avatar.eyes.kappa.size() == 0) t.avatar.eyes.kappa = Columns<float>::Zero(2, 2);
    TwoStreamTrace<float, TrainedEffects> trace;
    const Gaussians<float> g = driven(t, t.truth, trace);
    const Vec3<float> middle =
        trace.gaussians.mean.rightCols(trace.eye_columns().count).rowwise().mean();
    for (const float yaw : {-0.5f, 0.0f, 0.5f}) {
        LabelView<float> v;
        v.camera = turned(s.camera, middle, yaw);
        const VecX<float> background = v.background;
        v.truth = Rasterizer<Policy>{}.forward(backend, g, v.camera, background).feature.pixels;
        v.weight = Columns<float>::Ones(1, v.truth.cols());
        t.views.push_back(std::move(v));
    }
    VecX<double> off(10); // gazes 4 degrees, the head 0.6 degrees and 1.2 hundredths
    off << 4 * degree, 0, -2.5 * degree, 3 * degree, 0.4 * degree, -0.4 * degree, 0.2 * degree,
        0.01, -0.006, 0.004;
    t.label = moved_drivers(t.truth, t.unknowns, off);
    return t;
}

Arrivals gauss_newton(const Task& t, int most) {
    Arrivals at{-1, -1};
    for (int steps = 1; steps <= most && at.back() < 0; ++steps) {
        RefineSettings settings;
        settings.rounds = 1;
        settings.levenberg.steps = steps;
        settings.levenberg.tolerance = 0;
        HostLabelDrawing drawing(t.backend, t.avatar, t.config, t.roles);
        LabelRefiner refiner(t.backend.threads, drawing, t.unknowns, settings);
        const double begin = wall_seconds();
        const RefinedLabels r = refiner.refine(t.label, t.views);
        const double seconds = wall_seconds() - begin;
        const Distance d = distance(moved_drivers(t.label, t.unknowns, r.change), t.truth);
        print("Gauss-Newton", steps, seconds, d);
        arrive(d, seconds, at);
        if (r.steps < steps) break; // no step makes the cost smaller
    }
    return at;
}

/// The cost's value and gradient by reverse mode: Huber's of the pixels, and the priors.
class ReverseCost {
  public:
    explicit ReverseCost(const Task& t) : t_(t), sigma_(t.unknowns.sigma()) {
        TwoStreamTrace<float, TrainedEffects> trace;
        const Gaussians<float> g = driven(t, t.label, trace);
        std::vector<float> sizes;
        for (const LabelView<float>& v : t.views) {
            const Columns<float> r = residual(g, v);
            for (Index i = 0; i < r.size(); ++i) sizes.push_back(std::abs(r(i)));
        }
        const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
        std::nth_element(sizes.begin(), middle, sizes.end());
        noise_ = std::max(settings_.least_noise, 1.4826 * static_cast<double>(*middle));
    }
    Labels labels(const VecX<double>& x) const {
        return moved_drivers(t_.label, t_.unknowns, x.cwiseProduct(sigma_));
    }
    VecX<double> gradient(const VecX<double>& x) {
        const Labels at = labels(x);
        TwoStreamTrace<float, TrainedEffects> trace;
        const Gaussians<float> g = driven(t_, at, trace);
        Gaussians<float> sum = zeros_like(trace.gaussians);
        for (const LabelView<float>& v : t_.views) {
            const VecX<float> background = v.background;
            const auto raster = rasterizer_.forward(t_.backend, g, v.camera, background);
            const Columns<float> slope = (raster.feature.pixels - v.truth).unaryExpr([&](float r) {
                const double scaled = static_cast<double>(r) / noise_;
                const double bent = std::clamp(scaled, -settings_.huber, settings_.huber);
                return static_cast<float>(2 * bent / (noise_ * settings_.alike));
            });
            const Gaussians<float> part =
                rasterizer_.vjp(t_.backend, g, v.camera, background, raster, slope);
            sum.mean += part.mean, sum.rotation += part.rotation, sum.scale += part.scale;
            sum.opacity += part.opacity;
            sum.feature.topRows(3) += part.feature;
        }
        TrainedAvatar<float> grad = zeros_like(t_.avatar);
        const Vec<float, 6> pose =
            drive_vjp(t_.backend, t_.avatar, {t_.config, t_.roles, at}, trace, {sum, grad});
        VecX<double> all(10); // a kappa is added to the angles of its eye's gaze
        all << grad.eyes.kappa.reshaped().cast<double>(), pose.cast<double>();
        return 2 * x + all.cwiseProduct(sigma_);
    }

  private:
    Columns<float> residual(const Gaussians<float>& g, const LabelView<float>& v) const {
        const VecX<float> background = v.background;
        return rasterizer_.forward(t_.backend, g, v.camera, background).feature.pixels - v.truth;
    }

    const Task& t_;
    VecX<double> sigma_;
    RefineSettings settings_;
    Rasterizer<Policy> rasterizer_;
    double noise_ = 1;
};

Arrivals adam(const Task& t, double rate, int most) {
    Arrivals at{-1, -1};
    ReverseCost cost(t);
    const AdamConfig config;
    const AdamFormula<double> formula(config);
    VecX<double> x = VecX<double>::Zero(10), m = x, v = x;
    const std::string name = "Adam, rate " + std::to_string(rate).substr(0, 4);
    const double begin = wall_seconds();
    for (int step = 1; step <= most && at.back() < 0; ++step) {
        const VecX<double> g = cost.gradient(x);
        const AdamStep<double> size(config, rate, step);
        for (Index k = 0; k < x.size(); ++k) {
            m[k] = formula.mean(m[k], g[k]);
            v[k] = formula.square(v[k], g[k]);
            x[k] = formula.moved(x[k], m[k], v[k], size.size, size.root);
        }
        const double seconds = wall_seconds() - begin;
        const Distance d = distance(cost.labels(x), t.truth);
        const bool fresh = arrive(d, seconds, at);
        if (fresh || step == most || (step & (step - 1)) == 0)
            print(name.c_str(), step, seconds, d);
    }
    return at;
}

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
    const Task t = make_task(B{pool.threads()});
    std::printf("%s, %d threads; 3 pictures of %d x %d pixels, 10 unknowns\n\n",
                subject().name.c_str(), pool.size(), t.views[0].camera.width,
                t.views[0].camera.height);
    std::printf(
        "| method | steps | seconds | gazes off [deg] | head off [deg] | [units] |\n"
        "|---|---|---|---|---|---|\n");
    print("the labels", 0, 0, distance(t.label, t.truth));
    const Arrivals newton = gauss_newton(t, 20);
    Arrivals best{-1, -1};
    for (const double rate : {0.03, 0.1, 0.3}) {
        const Arrivals a = adam(t, rate, most);
        for (std::size_t k = 0; k < goal_count; ++k)
            if (a[k] > 0 && (best[k] < 0 || a[k] < best[k])) best[k] = a[k];
    }
    const auto say = [](const char* name, double seconds) {
        if (seconds > 0)
            std::printf("%s %.2f s", name, seconds);
        else
            std::printf("%s never", name);
    };
    std::printf("\n");
    for (std::size_t k = 0; k < goal_count; ++k) {
        std::printf("to %g degrees of the gazes and %g of the head: ", goals[k].gaze,
                    goals[k].turn);
        say("Gauss-Newton", newton[k]);
        say(", Adam at its best rate", best[k]);
        if (newton[k] > 0 && best[k] > 0) std::printf(", %.1f times as long", best[k] / newton[k]);
        std::printf("\n");
    }
    return newton.front() > 0 ? 0 : 1;
}
