// SPDX-License-Identifier: Apache-2.0
// A researcher's own influence and own gaze mechanism: an avatar with both learns from pictures how
// far its eyes turn, and is redirected to a gaze that it was not shown.
#include <rye/rye.hpp>

#include <cmath>
#include <cstdio>

using namespace rye;

/// A smooth fall-off: 1 - 3 t^2 + 2 t^3 of the squared distance, t from near to far.
struct SmoothDistance {
    template <Scalar T>
    T value(const Ramp<T>& ramp, const T& squared) const {
        const T t = clamp_value(T((squared - ramp.near) / (ramp.far - ramp.near)), T(0), T(1));
        return T(1) - t * t * (T(3) - T(2) * t);
    }
    template <Scalar T>
    T slope(const Ramp<T>& ramp, const T& squared) const {
        const T t = clamp_value(T((squared - ramp.near) / (ramp.far - ramp.near)), T(0), T(1));
        return T(-6) * t * (T(1) - t) / (ramp.far - ramp.near);
    }
};
/// Both eyes turn a learned share of the way from +z to the gaze.
struct SharedTurn : ExplicitRotation {
    template <class T>
    struct Parameters {
        Columns<T> share;  // 1 x 1
        static void fields(auto&& f, auto&&... p) { f("share", p.share...); }
    };
    template <class P>
    static P init(int, const Random&) {
        return {decltype(P::share)::Constant(1, 1, 0.4F)};
    }
    template <class T>
    static Quat<T> turned(const T& share, const Vec3<T>& gaze) {
        const Vec3<T> ahead(T(0), T(0), T(1));
        return shortest_arc(ahead, normalized(Vec3<T>(ahead + share * (gaze - ahead))));
    }
    template <class P, class T>
    static Quat<T> turn(const P& p, std::size_t, const Vec3<T>& gaze) {
        return turned(p.share(0), gaze);
    }
    template <class P, class T>
    static Vec3<T> turn_vjp(const P& p, std::size_t, const Vec3<T>& x, const Quat<T>& g, P& grad) {
        using D = Dual<T, 4>;  // in the directions of the share and of the gaze
        const Vec3<D> gaze(D::variable(x[0], 1), D::variable(x[1], 2), D::variable(x[2], 3));
        const Quat<D> q = turned(D::variable(p.share(0), 0), gaze);
        Vec4<T> sum = Vec4<T>::Zero();
        for (int i = 0; i < 4; ++i)
            for (std::size_t k = 0; k < 4; ++k) sum[Index(k)] += g[i] * q[i].d[k];
        grad.share(0) += sum[0];
        return sum.template tail<3>();
    }
};
using Mine = More<PaperEffects, ExpressionInfluence<SmoothDistance>, GazeBy<SharedTurn>>;
using Avatar = TwoStream<float, Mine>;
struct ShareAlone { // the learning rate of a field
    double operator()(const std::string& name) const { return name == "eyes.share" ? 0.02 : 0; }
};

int main() {
    const XsimdBackend backend{Serial{}};
    AvatarConfig config{.expression = 2, .feature = 4, .channels = 3};
    config.networks = {{8}, {8}, {8}, {8}, {8}, {8}, {8}, {8}, {8}, {8}};
    LandmarkRoles roles;
    for (Index k = 0; k < 66; ++k)
        (k < 36 || k > 47 ? roles.expression : roles.eye[k < 42 ? 1 : 0]).push_back(k);
    const Vec3<float> middle(0, 0, 0), corner(1.3F, 1.3F, 1.3F), up(0, 1, 0);
    const Columns<float> landmarks = Columns<float>::Random(3, 66);
    auto mesh = GuidanceMesh<float, Mine>::init(config, landmarks, Random{1, 0});
    pretrain_sphere<float>(backend, mesh, config, {middle, 1.3F, 60, 1e-2}, Random{2, 0});
    AvatarInit<float, Mine> init{.grid = bcc_grid<float>(-corner, corner, 0.3F), .mouth_points = 9};
    init.eye_centre = Columns<float>{{0.4F, -0.4F}, {0.2F, 0.2F}, {1.3F, 1.3F}};
    init.upsampler = {.in_channels = 3, .capacity = 2, .doublings = 0, .skip = true};
    Avatar avatar = initialize_avatar<float>(backend, mesh, config, init, Random{3, 0});
    for (Index i = 0; i < avatar.eyes.feature.cols(); ++i)  // a black iris shows the turn
        avatar.eyes.feature.col(i).fill(avatar.eyes.position(2, i) < 0.1F ? 1.F : 0.F);
    Avatar truth = avatar;
    truth.eyes.share.setConstant(1);
    const auto camera = look_at<float>(Vec3<float>(0, 0, 6), middle, up, 0.3F, {64, 64});
    auto drivers = neutral_drivers<float, Mine>(config);
    const auto picture = [&](const Avatar& of, float yaw) {
        drivers.gaze.fill(Vec3<float>(std::sin(yaw), 0, std::cos(yaw)));
        TwoStreamTrace<float, Mine> trace;
        drive(backend, of, {config, roles, drivers}, trace);
        return Rasterizer<>().forward(backend, trace.gaussians, camera, VecX<float>(up)).feature;
    };
    const Columns<float> unseen = picture(truth, 0.2F).pixels, first = picture(avatar, 0.2F).pixels;
    Adam<Avatar> adam(avatar);
    const AvatarTraining<Balanced, PyramidGradientLoss, ShareAlone> training{config, roles};
    AvatarTrainer trainer{backend, avatar, adam, training};
    for (int step = 0; step < 60; ++step) {
        const Image<float> shown = picture(truth, step % 2 == 0 ? -0.4F : 0.4F);
        trainer.step(drivers, detail::whole_picture<float>(shown, camera, up));
    }
    const float off = (picture(avatar, 0.2F).pixels - unseen).norm() / (first - unseen).norm();
    std::printf("share %.2f, redirected: %.2f of the error\n", avatar.eyes.share(0), off);
    return off < 0.3F ? 0 : 1;
}
