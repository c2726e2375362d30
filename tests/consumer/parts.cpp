// SPDX-License-Identifier: Apache-2.0
// Every kind of part (rye/rig/parts.hpp) by a user: influences, gaze mechanism, eye appearance,
// eyeballs, networks, upsampler. The gradient of a whole training step agrees with central
// differences in every parameter struct, and a few steps lower the loss.
#include <rye/rye.hpp>

#include <cmath>
#include <cstdio>

namespace mine {

using namespace rye;

/// 1 / (1 + (d2 / near)^2), whatever `far` is.
struct Bell {
    template <Scalar T>
    T value(const Ramp<T>& ramp, const T& squared) const {
        const T x = squared / ramp.near;
        return T(1) / (T(1) + x * x);
    }
    template <Scalar T>
    T slope(const Ramp<T>& ramp, const T& squared) const {
        const T x = squared / ramp.near, v = value(ramp, squared);
        return T(-2) * x * v * v / ramp.near;
    }
};
struct Everywhere {
    template <Scalar T>
    T value(const Ramp<T>&, const T&) const {
        return T(0.25);
    }
    template <Scalar T>
    T slope(const Ramp<T>&, const T&) const {
        return T(0);
    }
};

/// The eyes turn as published; their colours also follow the gaze linearly: f + A gaze.
struct TintedByGaze : ExplicitRotation {
    static constexpr bool changes_features = true;
    template <class T>
    struct Parameters {
        Columns<T> tint;  // C x 3
        static void fields(auto&& f, auto&&... p) { f("tint", p.tint...); }
    };
    template <class P>
    static P init(int channels, const Random& random) {
        P p{decltype(P::tint)(channels, 3)};
        for (Index i = 0; i < p.tint.size(); ++i)
            p.tint(i) = 0.2 * (random.uniform(std::uint64_t(i)) - 0.5);
        return p;
    }
    template <class P, class T>
    static void features(const P& p, std::size_t, const Vec3<T>& gaze, ColumnsSpan<T> feature) {
        feature.colwise() += (p.tint * gaze).eval().col(0);
    }
    template <class P, class T>
    static Vec3<T> features_vjp(const P& p, std::size_t, const Vec3<T>& gaze, const ColumnsView<T>&,
                                ColumnsSpan<T> g, P& grad) {
        const VecX<T> sum = g.rowwise().sum();
        grad.tint += sum * gaze.transpose();
        return p.tint.transpose() * sum;
    }
};

/// Colours of the eyes from the expression: b + W expression, the same for all points of an eye.
struct Blushing {
    static constexpr bool reads_inputs = true;
    template <class T>
    struct Parameters {
        Columns<T> weight, bias;  // C x E, C x 2
        static void fields(auto&& f, auto&&... p) {
            f("blush.weight", p.weight...);
            f("blush.bias", p.bias...);
        }
    };
    template <class P>
    static P init(int channels, Index, const Random& random) {
        using C = decltype(P::bias);
        P p{C(channels, 2), C::Constant(channels, 2, 0.4)};
        for (Index i = 0; i < p.weight.size(); ++i)
            p.weight(i) = 0.2 * (random.uniform(std::uint64_t(i)) - 0.5);
        return p;
    }
    template <class B, class P, class T>
    static void features(const B&, const P& p, const EyeInputs<T>& in, ColumnsSpan<T> feature) {
        const VecX<T> shift = p.weight * in.expression;
        for (Index i = 0; i < feature.cols(); ++i)
            feature.col(i) = p.bias.col(i < in.left_points ? 0 : 1) + shift;
    }
    template <class B, class P, class T>
    static void features_vjp(const B&, const P&, const EyeInputs<T>& in, const ColumnsView<T>& g,
                             P& grad) {
        grad.weight += g.rowwise().sum() * in.expression.transpose();
        grad.bias.col(0) += g.leftCols(in.left_points).rowwise().sum();
        grad.bias.col(1) += g.rightCols(g.cols() - in.left_points).rowwise().sum();
    }
};

/// An eyeball that is a ring of points before a pole.
struct Disc {
    double radius = 0.12;
    int points = 12;
};
template <Real T>
EyeballTemplate<T> eyeball_template(const Disc& disc) {
    EyeballTemplate<T> eye;
    eye.points.resize(3, disc.points);
    for (Index i = 0; i < disc.points; ++i) {
        const double a = 6.2832 * double(i) / disc.points;
        eye.points.col(i) << T(0.5 * disc.radius * std::cos(a)), T(0.5 * disc.radius * std::sin(a)),
            T(disc.radius);
    }
    eye.normals = Vec3<T>(T(0), T(0), T(1)).replicate(1, disc.points);
    eye.spacing = Columns<T>::Constant(1, disc.points, T(0.05));
    return eye;
}

/// x / sqrt(1 + x^2) after hidden layers, no skip, and points by themselves and their squares.
struct SmoothNetworks {
    struct Activation {
        template <class T>
        static T value(const T& x) {
            using std::sqrt;
            return x / sqrt(T(1) + x * x);
        }
        template <class T>
        static T vjp(const T& y, const T& g) {  // slope (1 - y^2)^(3/2)
            using std::sqrt;
            const T c = T(1) - y * y;
            return g * c * sqrt(c);
        }
    };
    struct Encoding {
        static constexpr Index size(Index values, int) { return 2 * values; }
        static auto encode(const auto& x, int) {
            Columns<typename std::remove_cvref_t<decltype(x)>::Scalar> y(2 * x.rows(), x.cols());
            y << x, x.cwiseProduct(x);
            return y;
        }
        static auto vjp(const auto& code, const auto& g, int) {
            using C = Columns<typename std::remove_cvref_t<decltype(code)>::Scalar>;
            const Index n = code.rows() / 2;
            return C(g.topRows(n) + 2 * code.topRows(n).cwiseProduct(g.bottomRows(n)));
        }
    };
    static constexpr int skip_layer(const MlpShape&) { return MlpShape::no_skip; }
};

/// "Super-resolution" of the same size: RGB times a gain of each channel.
template <class T>
struct Gain {
    struct Trace {};
    Columns<T> gain;  // 3 x 1
    static Gain init(const UpsamplerShape&, const Random&) {
        return {Columns<T>::Constant(3, 1, T(0.9))};
    }
    static void fields(auto&& f, auto&&... p) { f("gain", p.gain...); }
};
template <class T, Backend B>
Image<T> upsampler_forward(const B&, const Gain<T>& u, const Image<T>& in,
                           std::type_identity_t<typename Gain<T>::Trace>*) {
    Image<T> out(in.width, in.height, 3);
    out.pixels = u.gain.col(0).asDiagonal() * in.pixels.topRows(3);
    return out;
}
template <class T, Backend B>
void upsampler_vjp(const B&, const Gain<T>& u, const Image<T>& in, const typename Gain<T>::Trace&,
                   const std::type_identity_t<ColumnsView<T>>& g, Gain<T>& grad,
                   std::type_identity_t<Columns<T>>* g_in) {
    grad.gain += g.cwiseProduct(in.pixels.topRows(3)).rowwise().sum();
    g_in->setZero(in.pixels.rows(), in.pixels.cols());
    g_in->topRows(3) = u.gain.col(0).asDiagonal() * g;
}
struct GainUpsampler {
    template <class T>
    using Network = Gain<T>;
};

using Parts = More<PaperEffects, ExpressionInfluence<Bell>, PoseInfluence<Everywhere>,
                   GazeInfluence<Bell>, GazeBy<TintedByGaze>, EyesBy<Blushing>, EyeballsBy<Disc>,
                   NetworksBy<SmoothNetworks>, UpsampledBy<GainUpsampler>>;
static_assert(!default_parts<Parts> && default_parts<PaperEffects>);

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
            whole_picture<double>(truth, camera, VecX<double>::Constant(4, 0.8));
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
