// SPDX-License-Identifier: Apache-2.0
/// tests/support/tiny_avatar.hpp: an avatar and a guidance mesh of a few points and narrow
/// networks, and their conversion to other scalars, for the derivative laws of whole stages.
#pragma once

#include <rye/autodiff/check.hpp>
#include <rye/avatar/guidance_mesh.hpp>
#include <rye/avatar/two_stream.hpp>
#include <rye/core/random.hpp>
#include <rye/geometry/camera.hpp>

namespace rye::test {

inline AvatarConfig tiny_config() {
    AvatarConfig c;
    c.expression = 3;
    c.feature = 4;
    c.channels = 5;
    c.networks = {{7, 7}, {6}, {5}, {6, 6}, {5}, {6}, {5}, {5}, {4}, {5}};
    return c;
}

/// Numbers in [-1, 1), a different stream for every use.
struct Draw {
    Random random{7, 1};
    std::uint64_t next = 0;
    double operator()() { return 2 * random.uniform(next++) - 1; }
    Columns<double> columns(Index rows, Index cols, double size = 1) {
        Columns<double> m(rows, cols);
        for (Index i = 0; i < m.size(); ++i) m(i) = size * (*this)();
        return m;
    }
};

/// Landmarks of a face-like cap: 66 in the order of the capture, 36 to 47 around the eyes.
inline Columns<double> tiny_landmarks(Draw& draw) {
    Columns<double> l = draw.columns(3, 66, 0.6);
    l.row(2).array() += 0.8;
    for (Index k = 36; k < 48; ++k) {
        l(0, k) = (k < 42 ? -0.3 : 0.3) + 0.1 * draw();
        l(1, k) = 0.3 + 0.05 * draw();
        l(2, k) = 0.9;
    }
    return l;
}

inline LandmarkRoles tiny_roles() {
    LandmarkRoles r;
    for (Index k = 0; k < 66; ++k)
        if (k < 36 || k >= 48) r.expression.push_back(k);
    for (Index k = 36; k < 42; ++k) r.eye[1].push_back(k);
    for (Index k = 42; k < 48; ++k) r.eye[0].push_back(k);
    return r;
}

template <class T>
Drivers<T> tiny_drivers() {
    Drivers<double> d;
    d.expression = Vec3<double>(0.3, -0.2, 0.7);
    d.pose << 0.2, -0.15, 0.1, 0.05, -0.08, 0.03;
    d.scale = 1.1;
    d.gaze = {Vec3<double>(0.2, 0.1, 0.95).normalized(), Vec3<double>(-0.3, -0.1, 0.9).normalized()};
    return d.cast<T>();
}

/// A camera in front of the face, principal point off centre.
inline Pinhole<double> tiny_camera(int width, int height) {
    Pinhole<double> c = look_at<double>(Vec3<double>(0.5, 0.3, 6), Vec3<double>(0, 0.2, 0.5),
                                        Vec3<double>(0, 1, 0), 0.45, {width, height});
    c.cx += 1.3;
    c.cy -= 0.7;
    return c;
}

inline TwoStream<double> tiny_avatar(const AvatarConfig& c, Draw& draw) {
    constexpr Index n = 60, eye = 9;  // on average: the left one has 8 points, the right one 10
    TwoStream<double> a;
    FaceStream<double>& f = a.face;
    f.position = draw.columns(3, n, 0.7);
    f.position.row(2).array() += 0.6;
    f.feature = draw.columns(c.feature, n);
    f.log_scale = draw.columns(3, n, 0.4).array() - 2.2;
    f.rotation = draw.columns(4, n);
    f.opacity_logit = draw.columns(1, n);
    f.networks = FaceNetworks<double>::init(c, Random{1, 0});
    f.exp_attributes = Mlp<double>::init(
        mlp_shape(c.feature, c.expression, c.networks.exp_attributes, 8), Random{2, 0});
    f.pose_attributes = Mlp<double>::init(
        mlp_shape(c.feature, c.pose_code(), c.networks.pose_attributes, 8), Random{3, 0});
    f.landmarks = tiny_landmarks(draw);
    EyeStream<double>& e = a.eyes;
    e.feature = draw.columns(c.channels, 2 * eye);
    e.log_scale = draw.columns(3, 2 * eye, 0.3).array() - 3.0;
    e.rotation = draw.columns(4, 2 * eye);
    e.opacity_logit = draw.columns(1, 2 * eye);
    e.offset = EyeOffsetNetwork<double>::init(c, Random{4, 0});
    e.offset.mlp.weight.back() = draw.columns(6, e.offset.mlp.weight.back().cols(), 0.3);
    e.position = draw.columns(3, 2 * eye, 0.12);
    e.left_points = eye - 1;
    e.spacing = Columns<double>::Constant(1, 2 * eye, 0.05);
    e.centre.resize(3, 2);
    e.centre << 0.3, -0.3, 0.3, 0.3, 0.95, 0.95;
    UpsamplerShape shape;
    shape.in_channels = c.channels;
    shape.capacity = 2;
    shape.doublings = 1;
    a.upsampler = Upsampler<double>::init(shape, Random{5, 0});
    a.delta_pose = draw.columns(6, 2, 0.02);
    return a;
}

template <class U, class T>
Mlp<U> shaped(const Mlp<T>& m) {
    return Mlp<U>(m.shape);
}

template <class U, class T>
FaceNetworks<U> shaped(const FaceNetworks<T>& n) {
    return {{shaped<U>(n.exp_color), shaped<U>(n.pose_color), shaped<U>(n.exp_deform),
             shaped<U>(n.pose_deform),
             {shaped<U>(n.gaze_deform[0]), shaped<U>(n.gaze_deform[1])},
             {shaped<U>(n.gaze_color[0]), shaped<U>(n.gaze_color[1])}}};
}

/// The same avatar in another scalar.
template <class U, class T, EffectSet E>
TwoStream<U, E> lifted(const TwoStream<T, E>& a) {
    TwoStream<U, E> b;
    for_face_fields<E>([&](auto by) {
        by.color(b.face.networks) = shaped<U>(by.color(a.face.networks));
        by.deform(b.face.networks) = shaped<U>(by.deform(a.face.networks));
        if constexpr (by.attributes) by.attribute(b.face) = shaped<U>(by.attribute(a.face));
    });
    if constexpr (has_effect<E, EyeOffset>) b.eyes.offset.mlp = shaped<U>(a.eyes.offset.mlp);
    if constexpr (requires { a.eyes.networks; })
        for (std::size_t eye = 0; eye < 2; ++eye)
            if (!a.eyes.networks[eye].weight.empty())
                b.eyes.networks[eye] = shaped<U>(a.eyes.networks[eye]);
    // Of gaze mechanisms.
    if constexpr (requires { a.eyes.map; }) b.eyes.map = shaped<U>(a.eyes.map);
    if constexpr (requires { a.eyes.color; }) b.eyes.color = shaped<U>(a.eyes.color);
    if constexpr (requires { a.eyes.decoder; }) b.eyes.decoder = shaped<U>(a.eyes.decoder);
    if constexpr (requires { a.eyes.turn; }) b.eyes.turn = shaped<U>(a.eyes.turn);
    b.upsampler = Upsampler<U>(a.upsampler.shape);
    const auto convert = [](const T& x) { return U(static_cast<real_t<U>>(x)); };
    convert_fields(b, a, convert);
    TwoStream<U, E>::buffers([&](const std::string&, auto& to, const auto& from) {
        to = from.unaryExpr(convert);
    }, b, a);
    b.eyes.left_points = a.eyes.left_points;
    return b;
}

template <class U, class T>
GuidanceMesh<U> lifted(const GuidanceMesh<T>& a) {
    GuidanceMesh<U> b{shaped<U>(a.geometry), shaped<U>(a.networks), {shaped<U>(a.eye_offset.mlp)}, {}};
    convert_fields(b, a, [](const T& x) { return U(static_cast<real_t<U>>(x)); });
    return b;
}

} // namespace rye::test
