// SPDX-License-Identifier: Apache-2.0
// Every kind of part (rye/rig/parts.hpp) by a user, as docs/parts.md shows them: influences, gaze
// mechanism, eye appearance, eyeballs, networks, upsampler. The gradient of a whole training step
// agrees with central differences in every parameter struct, and a few steps lower the loss.
#include <rye/rye.hpp>

#include <cmath>
#include <cstdio>

namespace mine {

using namespace rye;

#include "skeletons.hpp" // of docs/parts.md

using Parts = More<PaperEffects, ExpressionInfluence<MyMetric>, PoseInfluence<MyMetric>,
                   GazeInfluence<MyMetric>, GazeBy<MyMechanism>, EyesBy<MyEyes>, EyeballsBy<MyEyeball>,
                   NetworksBy<MyNetworks>, UpsampledBy<MyUpsampler>>;
static_assert(!detail::default_parts<Parts> && detail::default_parts<PaperEffects>);

/// An avatar of a few Gaussians, its trainer and what it is shown, in double.
struct Scene {
    using Avatar = TwoStream<double, Parts>;
    ScalarBackend<Serial> backend;
    AvatarConfig config{.expression = 2, .feature = 4, .channels = 4};
    LandmarkRoles roles;
    Avatar avatar;
    AvatarSample<double, Parts> sample;

    Scene() {
        config.networks = {{5}, {5}, {5}, {5}, {5}, {5}, {5}, {5}, {5}, {5}};
        for (Index k = 0; k < 66; ++k)
            (k < 36 || k > 47 ? roles.expression : roles.eye[k < 42 ? 1 : 0]).push_back(k);
        Columns<double> landmarks(3, 66);
        for (Index i = 0; i < landmarks.size(); ++i)
            landmarks(i) = Random{3, 1}.uniform(std::uint64_t(i)) - 0.5;
        auto mesh = GuidanceMesh<double, Parts>::init(config, landmarks, Random{1, 0});
        pretrain_sphere<double>(backend, mesh, config, {Vec3<double>(0, 0, 0), 1.3, 20, 2e-2},
                                Random{2, 0});
        const Vec3<double> corner(1.3, 1.3, 1.3);
        AvatarInit<double, Parts> init{.grid = bcc_grid<double>(-corner, corner, 0.9),
                                       .mouth_points = 5, .frames = 1};
        init.eye_centre = Columns<double>{{0.4, -0.4}, {0.2, 0.2}, {1.0, 1.0}};
        avatar = initialize_avatar<double>(backend, mesh, config, init, Random{3, 0});
        const auto camera =
            look_at<double>(Vec3<double>(0.1, 0, 6), Vec3<double>(0, 0, 0), Vec3<double>(0, 1, 0),
                            0.5, {12, 12});
        Image<double> truth(12, 12, 3);
        for (Index i = 0; i < truth.pixels.size(); ++i)
            truth.pixels(i) = Random{5, 0}.uniform(std::uint64_t(i));
        static_cast<AvatarImages<double>&>(sample) =
            detail::whole_picture<double>(truth, camera, VecX<double>::Constant(4, 0.8));
        sample.frame = 0;
        sample.drivers = neutral_drivers<double, Parts>(config);
        sample.drivers.expression << 0.5, -0.3;
        sample.drivers.gaze[0] = Vec3<double>(0.3, 0.1, 0.9).normalized();
        sample.drivers.gaze[1] = Vec3<double>(-0.2, 0.1, 0.9).normalized();
    }
    AvatarTraining<Exact64> training() const { return {config, roles}; }
    double loss(const Avatar& at) const {
        Avatar copy = at;
        Adam<Avatar> adam(copy);
        AvatarTrainer trainer{backend, copy, adam, training()};
        return trainer.losses(sample.drivers, sample).total;
    }
};

/// Worst relative difference of the gradient and central differences, a direction a field.
double gradient_error(Scene& s) {
    using Avatar = Scene::Avatar;
    Adam<Avatar> adam(s.avatar);
    AvatarTrainer trainer{s.backend, s.avatar, adam, s.training()};
    trainer.losses(s.sample.drivers, s.sample);
    Avatar gradient = zeros_like(s.avatar);
    trainer.add_gradient(s.sample.drivers, s.sample, gradient);
    double worst = 0;
    std::uint64_t stream = 0;
    Avatar::fields([&](const std::string& name, auto& a, const auto& g) {
        Columns<double> d(a.rows(), a.cols());
        for (Index i = 0; i < d.size(); ++i)
            d(i) = Random{9, stream}.uniform(std::uint64_t(i)) - 0.5;
        ++stream;
        const Columns<double> at = a;
        const double h = 1e-6;
        a = at + h * d;
        const double above = s.loss(s.avatar);
        a = at - h * d;
        const double slope = (above - s.loss(s.avatar)) / (2 * h);
        a = at;
        const double by_vjp = g.cwiseProduct(d).sum(), size = g.cwiseProduct(d).cwiseAbs().sum();
        const double error = std::abs(slope - by_vjp) / (size + 1e-4);
        if (error > 1e-3) std::printf("%s: %g, by differences %g\n", name.c_str(), by_vjp, slope);
        worst = std::max(worst, error);
    }, s.avatar, gradient);
    return worst;
}

} // namespace mine

int main() {
    mine::Scene s;
    const double error = mine::gradient_error(s), before = s.loss(s.avatar);
    rye::Adam<mine::Scene::Avatar> adam(s.avatar);
    rye::AvatarTrainer trainer{s.backend, s.avatar, adam, s.training()};
    for (int step = 0; step < 5; ++step) trainer.step(s.sample, 30);
    const double after = s.loss(s.avatar);
    std::printf("every kind of part: gradient off by %.1e, loss %.4f to %.4f\n", error, before,
                after);
    return error < 1e-3 && after < before ? 0 : 1;
}
