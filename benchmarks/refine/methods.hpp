// SPDX-License-Identifier: Apache-2.0
/// benchmarks/refine/methods.hpp: Gauss-Newton steps and Adam's towards a frame's labels, with a
/// table of when each arrives.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <string>
#include <vector>

#include <rye/nn/adam.hpp>
#include <rye/train/refine_labels.hpp>

#include "../roofline/clock.hpp"

namespace rye::bench {

inline constexpr double degree = 0.017453292519943295;

/// A goal that a method may reach.
struct Goal {
    double gaze, turn; ///< [degrees]
};
inline constexpr Goal goals[] = {{0.1, 0.02}, {0.01, 0.002}};
inline constexpr std::size_t goal_count = 2;
/// Seconds until a method came to each; below 0: never.
using Arrivals = std::array<double, goal_count>;

/// Distance of labels from the truth.
struct Distance {
    double gaze = 0;  ///< mean of both eyes [degrees]
    double turn = 0;  ///< of the head [degrees]
    double shift = 0; ///< of the head [world units]
};

/// Notes the time of goals that are reached for the first time; returns true if one was.
inline bool arrive(const Distance& d, double seconds, Arrivals& at) {
    bool fresh = false;
    for (std::size_t k = 0; k < goal_count; ++k)
        if (at[k] < 0 && d.gaze <= goals[k].gaze && d.turn <= goals[k].turn)
            at[k] = seconds, fresh = true;
    return fresh;
}

/// A frame: what it truly is, labels that are off, and its pictures.
template <class Labels_>
struct LabelTask {
    using Labels = Labels_;
    Labels truth, label;
    LabelUnknowns unknowns = {};
    std::vector<LabelView<float>> views = {};

    /// Puts the labels off as a tracker does: gazes 4 degrees, the head 0.6 degrees and 1.2
    /// hundredths of a unit.
    void mislabel() {
        VecX<double> off(10);
        off << 4 * degree, 0, -2.5 * degree, 3 * degree, 0.4 * degree, -0.4 * degree, 0.2 * degree,
            0.01, -0.006, 0.004;
        label = moved_drivers(truth, unknowns, off);
    }
    Distance left(const Labels& at) const {
        Distance d;
        for (std::size_t e = 0; e < 2; ++e)
            d.gaze += 0.5 / degree *
                      angular_error(Vec3<double>(at.gaze[e].template cast<double>()),
                                    Vec3<double>(truth.gaze[e].template cast<double>()));
        const Vec<double, 6> p = (at.pose - truth.pose).template cast<double>();
        d.turn = p.head<3>().norm() / degree;
        d.shift = p.tail<3>().norm();
        return d;
    }
    /// Returns the labels after a change in units of the priors.
    Labels moved(const VecX<double>& x) const {
        return moved_drivers(label, unknowns, x.cwiseProduct(unknowns.sigma()));
    }
};

/// Returns the camera, turned about the vertical through a point.
inline Pinhole<float> turned(const Pinhole<float>& camera, const Vec3<float>& middle, float yaw) {
    const Vec3<float> away = camera.centre() - middle;
    const Vec3<float> to(std::cos(yaw) * away.x() + std::sin(yaw) * away.z(), away.y(),
                         std::cos(yaw) * away.z() - std::sin(yaw) * away.x());
    const float up = 2 * std::atan(0.5F * static_cast<float>(camera.height) / camera.fy);
    return look_at<float>(Vec3<float>(middle + to), middle, Vec3<float>(0, 1, 0), up,
                          {camera.width, camera.height});
}

/// Takes the task's pictures of the avatar that is driven by its truth: from the camera and from
/// both sides, turned about `middle`.
template <LabelDrawing D>
void photograph(D& drawing, const Pinhole<float>& camera, const Vec3<float>& middle,
                LabelTask<typename D::Labels>& task) {
    for (const float yaw : {-0.5F, 0.0F, 0.5F}) {
        LabelView<float> v;
        v.camera = turned(camera, middle, yaw);
        v.truth = drawing.picture(v);
        v.weight = Columns<float>::Ones(1, v.truth.cols());
        task.views.push_back(std::move(v));
    }
}

inline void print(const char* method, int steps, double seconds, const Distance& d) {
    std::printf("| %s | %d | %.3f | %.3f | %.4f | %.5f |\n", method, steps, seconds, d.gaze, d.turn,
                d.shift);
    std::fflush(stdout);
}

template <class P, LabelDrawing D>
Arrivals gauss_newton(const P& threads, D& drawing, const LabelTask<typename D::Labels>& task,
                      int most) {
    Arrivals at{-1, -1};
    for (int steps = 1; steps <= most && at.back() < 0; ++steps) {
        RefineSettings settings;
        settings.rounds = 1;
        settings.levenberg.steps = steps;
        settings.levenberg.tolerance = 0;
        LabelRefiner refiner(threads, drawing, task.unknowns, settings);
        const double begin = wall_seconds();
        const RefinedLabels r = refiner.refine(task.label, task.views);
        const double seconds = wall_seconds() - begin;
        const Distance d = task.left(moved_drivers(task.label, task.unknowns, r.change));
        print("Gauss-Newton", steps, seconds, d);
        arrive(d, seconds, at);
        if (r.steps < steps) break; // no step makes the cost smaller
    }
    return at;
}

/// A drawing that notes how long its verbs take.
template <LabelDrawing D>
class TimedDrawing {
  public:
    using Number = typename D::Number;
    using Labels = typename D::Labels;

    explicit TimedDrawing(D& of) : of_(&of) {}
    void drive(const Labels& labels) {
        timed("drive", [&] { of_->drive(labels); });
    }
    void differentiate(const Labels& labels, const std::vector<Labels>& moved, double apart) {
        timed("differentiate", [&] { of_->differentiate(labels, moved, apart); });
    }
    const Columns<Number>& picture(const LabelView<Number>& view) {
        const Columns<Number>* r = nullptr;
        timed("picture", [&] { r = &of_->picture(view); });
        return *r;
    }
    Columns<Number> jacobian(const LabelView<Number>& view, const std::vector<Index>& pixels) {
        return of_->jacobian(view, pixels);
    }
    Columns<double> sums(const LabelView<Number>& view, const WeighedColours& colours) {
        Columns<double> r;
        timed("sums", [&] { r = of_->sums(view, colours); });
        return r;
    }
    Index expression_width() const { return of_->expression_width(); }

    /// Prints the verbs' milliseconds a call, and what of `all` seconds they leave.
    void print(double all) const {
        for (const auto& [name, t] : times_) {
            std::printf("%s %d x %.2f ms, ", name.c_str(), t.calls, 1e3 * t.seconds / t.calls);
            all -= t.seconds;
        }
        std::printf("the rest %.1f ms\n\n", 1e3 * all);
    }

  private:
    struct Time {
        int calls = 0;
        double seconds = 0;
    };
    template <class F>
    void timed(const char* name, const F& f) {
        const double begin = wall_seconds();
        f();
        Time& t = times_[name];
        ++t.calls;
        t.seconds += wall_seconds() - begin;
    }
    D* of_;
    std::map<std::string, Time> times_;
};

/// Returns the residuals' standard deviation as LabelRefiner estimates it, at the task's labels.
template <LabelDrawing D>
double noise_at_labels(D& drawing, const LabelTask<typename D::Labels>& task) {
    drawing.drive(task.label);
    std::vector<float> sizes;
    for (const LabelView<float>& v : task.views) {
        const Columns<float> r = drawing.picture(v) - v.truth;
        for (Index i = 0; i < r.size(); ++i) sizes.push_back(std::abs(r(i)));
    }
    const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
    std::nth_element(sizes.begin(), middle, sizes.end());
    return std::max(RefineSettings{}.least_noise, 1.4826 * static_cast<double>(*middle));
}

/// Adam's steps. cost(labels): the gradient of the pixels' cost by the unknowns, 10.
template <class Labels, class Cost>
Arrivals adam(Cost& cost, const LabelTask<Labels>& task, double rate, int most) {
    Arrivals at{-1, -1};
    const VecX<double> sigma = task.unknowns.sigma();
    const AdamConfig config;
    const AdamFormula<double> formula(config);
    VecX<double> x = VecX<double>::Zero(sigma.size()), m = x, v = x;
    const std::string name = "Adam, rate " + std::to_string(rate).substr(0, 4);
    const double begin = wall_seconds();
    for (int step = 1; step <= most && at.back() < 0; ++step) {
        const VecX<double> g = 2 * x + cost(task.moved(x)).cwiseProduct(sigma);
        const AdamStep<double> size(config, rate, step);
        for (Index k = 0; k < x.size(); ++k) {
            m[k] = formula.mean(m[k], g[k]);
            v[k] = formula.square(v[k], g[k]);
            x[k] = formula.moved(x[k], m[k], v[k], size.size, size.root);
        }
        const double seconds = wall_seconds() - begin;
        const Distance d = task.left(task.moved(x));
        const bool fresh = arrive(d, seconds, at);
        if (fresh || step == most || (step & (step - 1)) == 0)
            print(name.c_str(), step, seconds, d);
    }
    return at;
}

/// Prints where the time of a refinement goes, with so many coefficients of the expression.
template <class P, LabelDrawing D>
void print_parts(const P& threads, D& drawing, const LabelTask<typename D::Labels>& task,
                 Index coefficients) {
    LabelUnknowns unknowns = task.unknowns;
    for (Index i = 0; i < std::min(coefficients, drawing.expression_width()); ++i)
        unknowns.expression.push_back(i);
    TimedDrawing timed(drawing);
    LabelRefiner refiner(threads, timed, unknowns);
    const double begin = wall_seconds();
    const int steps = refiner.refine(task.label, task.views).steps;
    const double seconds = wall_seconds() - begin;
    std::printf("\n%d unknowns, %d steps, %.3f s: ", static_cast<int>(unknowns.count()), steps,
                seconds);
    timed.print(seconds);
}

/// Runs both and prints the table and when each arrived; returns whether Gauss-Newton did.
template <class P, LabelDrawing D, class Cost>
bool compare_methods(const P& threads, D& drawing, Cost& cost,
                     const LabelTask<typename D::Labels>& task, int most) {
    std::printf(
        "| method | steps | seconds | gazes off [deg] | head off [deg] | [units] |\n"
        "|---|---|---|---|---|---|\n");
    print("the labels", 0, 0, task.left(task.label));
    const Arrivals newton = gauss_newton(threads, drawing, task, 20);
    print_parts(threads, drawing, task, 0);
    print_parts(threads, drawing, task, 40);
    Arrivals best{-1, -1};
    for (const double rate : {0.03, 0.1, 0.3}) {
        const Arrivals a = adam(cost, task, rate, most);
        for (std::size_t k = 0; k < goal_count; ++k)
            if (a[k] > 0 && (best[k] < 0 || a[k] < best[k])) best[k] = a[k];
    }
    const auto say = [](const char* name, double seconds) {
        if (seconds > 0)
            std::printf("%s %.3f s", name, seconds);
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
    return newton.front() > 0;
}

} // namespace rye::bench
