// SPDX-License-Identifier: Apache-2.0
// Training of Gaussians on an image with the renders and gradients of one policy. Initially means
// are off by half a scale, colours grey, opacities a half; the target is the oracle's image. The
// result is measured on renders by the same policy and by Exact32.
#include <cmath>

#include <rye/math/scalar.hpp>
#include <rye/nn/adam.hpp>
#include <rye/splat/oracle.hpp>

#include "errors.hpp"
#include "policy.hpp"
#include "table.hpp"

namespace rye::bench {
namespace {

/// The trained parameters: logarithms of scales, logits of opacities, the rest unchanged.
Gaussians<float> activated(const Gaussians<float>& raw) {
    Gaussians<float> g = raw;
    g.scale = raw.scale.array().exp().matrix();
    g.opacity = raw.opacity.unaryExpr([](float x) { return sigmoid(x); });
    g.rotation = raw.rotation.colwise().normalized();
    return g;
}

Gaussians<float> start_of(const Scenery& s) {
    Gaussians<float> raw = s.gaussians;
    raw.scale = raw.scale.array().log().matrix();
    for (Index i = 0; i < raw.count(); ++i)
        for (int a = 0; a < 3; ++a)
            raw.mean(a, i) += 0.5F * s.gaussians.scale(a, i) *
                              static_cast<float>(Random{77, 2 * std::uint64_t(a)}.normal(
                                  static_cast<std::uint64_t>(i)));
    raw.opacity.setZero();
    raw.feature.setConstant(0.5F);
    return raw;
}

/// PSNR under the policy and under Exact32 after the steps [dB].
std::pair<double, double> train(const Policy& policy, const Policy& judge, const Scenery& s,
                                const Columns<double>& target, int steps) {
    const Columns<float> none = Columns<float>::Zero(3, target.cols()),
                         none_alpha = Columns<float>::Zero(1, target.cols());
    Runner runner = policy.bind(s, none, none_alpha), exact = judge.bind(s, none, none_alpha);
    Gaussians<float> raw = start_of(s), gradient;
    Adam<Gaussians<float>> adam(raw);
    for (int step = 0; step < steps; ++step) {
        const Gaussians<float> g = activated(raw);
        runner.place(g);
        runner.forward();
        const Columns<double> error = runner.feature() - target;
        runner.pull(error.cast<float>());
        runner.backward();
        convert_fields(gradient, runner.gradient(), [](double x) { return static_cast<float>(x); });
        gradient.scale.array() *= g.scale.array();
        gradient.opacity.array() *= g.opacity.array() * (1 - g.opacity.array());
        const double rate = std::pow(0.1, double(step) / steps); // to a tenth at the end
        adam_step(Lanes{}, raw, gradient, adam,
                  [&](const std::string& name) { return rate * (name == "mean" ? 2e-3 : 2e-2); });
    }
    const Gaussians<float> g = activated(raw);
    for (Runner* r : {&runner, &exact}) {
        r->place(g);
        r->forward();
    }
    return {image_error(runner.feature(), target).psnr(),
            image_error(exact.feature(), target).psnr()};
}

} // namespace

void training(int steps) {
    std::vector<Policy> policies;
    for (const auto& some : {exact_policies(), preset_policies(), rule_policies()})
        for (const Policy& p : some)
            if (p.group == "preset") policies.push_back(p);
    std::printf("\nPSNR [dB] after %d steps of training by a policy: its own picture, Exact32's\n",
                steps);
    for (const Scenery& s : accuracy_scenes()) {
        if (s.name != "head" && s.name != "eyes close up" && s.name != "faint fog") continue;
        Gaussians<double> g;
        convert_fields(g, s.gaussians, [](float x) { return static_cast<double>(x); });
        const Columns<double> target =
            oracle(g, s.camera.cast<double>(), s.background.cast<double>(),
                   depth_order(s.gaussians, s.camera))
                .feature.pixels;
        for (const Policy& p : policies) {
            const auto [own, exact] = train(p, policies.front(), s, target, steps);
            std::printf("%-14s %-16s %6.2f %6.2f\n", s.name.c_str(), p.name.c_str(), own, exact);
        }
    }
}

} // namespace rye::bench
