// SPDX-License-Identifier: Apache-2.0
// zero_cost.cpp: drives an avatar without one effect (-DWITHOUT_EXPRESSION=1, ...), once by its
// effects as types and once by a hand-written kernel of the same primitives for those effects.
// zero_cost.sh counts the instructions of by_types and by_hand. The program compares their results.
#include <cstdio>
#include <cstring>

#include <rye/avatar/two_stream.hpp>
#include <rye/backend/lanes.hpp>
#include <rye/rig/eyeball.hpp>

#ifndef WITHOUT_EXPRESSION
#define WITHOUT_EXPRESSION 0
#endif
#ifndef WITHOUT_HEAD_POSE
#define WITHOUT_HEAD_POSE 0
#endif
#ifndef WITHOUT_POSE_RESIDUAL
#define WITHOUT_POSE_RESIDUAL 0
#endif
#ifndef WITHOUT_LEFT_GAZE
#define WITHOUT_LEFT_GAZE 0
#endif
#ifndef WITHOUT_RIGHT_GAZE
#define WITHOUT_RIGHT_GAZE 0
#endif
#ifndef WITHOUT_EYE_OFFSET
#define WITHOUT_EYE_OFFSET 0
#endif
#ifndef WITHOUT_KAPPA
#define WITHOUT_KAPPA 0
#endif
#ifndef WITHOUT_PERIOCULAR
#define WITHOUT_PERIOCULAR 0
#endif
#ifndef WITHOUT_CORNEAL_BULGE
#define WITHOUT_CORNEAL_BULGE 0
#endif
#ifndef WITHOUT_CORNEAL_REFRACTION
#define WITHOUT_CORNEAL_REFRACTION 0
#endif
#ifndef WITHOUT_GLINT
#define WITHOUT_GLINT 0
#endif
#ifndef WITHOUT_PUPIL
#define WITHOUT_PUPIL 0
#endif
#ifndef WITHOUT_LID_SHADOW
#define WITHOUT_LID_SHADOW 0
#endif
#ifndef WITHOUT_HEAD_SHADING
#define WITHOUT_HEAD_SHADING 0
#endif
#ifndef WITHOUT_VIEW_COLOR
#define WITHOUT_VIEW_COLOR 0
#endif
#define LEFT_SKIN (!WITHOUT_LEFT_GAZE && !WITHOUT_PERIOCULAR)
#define RIGHT_SKIN (!WITHOUT_RIGHT_GAZE && !WITHOUT_PERIOCULAR)
#define RESTS (WITHOUT_EXPRESSION || WITHOUT_POSE_RESIDUAL || !LEFT_SKIN || !RIGHT_SKIN)

using namespace rye;

namespace {

using T = float;
using B = XsimdBackend<xsimd::avx2, Serial>;

template <class... L>
struct Joined;
template <class... X>
struct Joined<detail::List<X...>> {
    using type = Effects<X...>;
};
template <class... X, class... Y, class... L>
struct Joined<detail::List<X...>, detail::List<Y...>, L...>
    : Joined<detail::List<X..., Y...>, L...> {};

// clang-format off
using E = Joined<detail::List<>
#if !WITHOUT_EXPRESSION
    , detail::List<Expression>
#endif
#if !WITHOUT_HEAD_POSE
    , detail::List<HeadPose>
#endif
#if !WITHOUT_POSE_RESIDUAL
    , detail::List<PoseResidual>
#endif
#if !WITHOUT_LEFT_GAZE
    , detail::List<LeftGaze>
#endif
#if !WITHOUT_RIGHT_GAZE
    , detail::List<RightGaze>
#endif
#if !WITHOUT_EYE_OFFSET
    , detail::List<EyeOffset>
#endif
#if !WITHOUT_KAPPA
    , detail::List<Kappa>
#endif
#if !WITHOUT_PERIOCULAR
    , detail::List<Periocular>
#endif
#if !WITHOUT_CORNEAL_BULGE
    , detail::List<CornealBulge>
#endif
#if !WITHOUT_CORNEAL_REFRACTION
    , detail::List<CornealRefraction>
#endif
#if !WITHOUT_GLINT
    , detail::List<Glint>
#endif
#if !WITHOUT_PUPIL // by hand there is none: pupils are at rest
    , detail::List<Pupil>
#endif
#if !WITHOUT_LID_SHADOW // by hand there is none: lids cast no shadow
    , detail::List<LidShadow>
#endif
#if !WITHOUT_HEAD_SHADING
    , detail::List<HeadShading>
#endif
#if !WITHOUT_VIEW_COLOR
    , detail::List<ViewColor>
#endif
    >::type;
// clang-format on

// ---- by hand ------------------------------------------------------------------------------------

struct HandFace {
#if !WITHOUT_EXPRESSION
    Mlp<T> exp_color, exp_deform, exp_attributes;
#endif
#if !WITHOUT_POSE_RESIDUAL
    Mlp<T> pose_color, pose_deform, pose_attributes;
#endif
#if LEFT_SKIN
    Mlp<T> left_color, left_deform;
#endif
#if RIGHT_SKIN
    Mlp<T> right_color, right_deform;
#endif
    Columns<T> position, feature, log_scale, rotation, opacity_logit, landmarks;
#if RESTS
    Columns<T> rest_color, anchor;
#endif
};

struct HandEyes {
    Columns<T> feature, log_scale, rotation, opacity_logit, position, centre, spacing;
#if !WITHOUT_EYE_OFFSET
    Mlp<T> offset;
#endif
#if !WITHOUT_KAPPA
    Columns<T> kappa;
#endif
    Columns<T> cornea;
#if !WITHOUT_CORNEAL_REFRACTION
    Columns<T> index;
#endif
#if !WITHOUT_GLINT
    Columns<T> light_position, light_intensity, light_width;
#endif
#if !WITHOUT_LID_SHADOW
    Columns<T> lid_shadow, lid_line;
#endif
    Index left_points = -1;
};

static_assert(sizeof(HandFace) == sizeof(FaceStream<T, E>));
static_assert(sizeof(HandEyes) == sizeof(EyeStream<T, E>));

struct HandDrivers {
    VecX<T> expression;
    Vec<T, 6> pose;
#if !WITHOUT_HEAD_POSE
    T scale;
#endif
#if !WITHOUT_LEFT_GAZE
    Vec3<T> left;
#endif
#if !WITHOUT_RIGHT_GAZE
    Vec3<T> right;
#endif
    Vec3<T> camera;
};

struct HandTrace {
    VecX<T> expression, pose;
    Columns<T> code, feature, attributes;
#if !WITHOUT_HEAD_POSE
    HeadTransform<T> head;
#endif
    Columns<T> w_exp, w_pose, w_left, w_right;
    NearestTrace<T> n_exp, n_left, n_right;
    FieldTrace<T> exp_color, exp_deform, exp_attributes, pose_color, pose_deform, pose_attributes;
    FieldTrace<T> left_color, left_deform, right_color, right_deform;
    VecX<T> left_gaze, right_gaze;
#if !WITHOUT_EYE_OFFSET
    EyeOffsetTrace<T> offset;
#endif
    Quat<T> left_turn, right_turn;
    std::array<Columns<T>, 2> seen;
    std::array<std::vector<SeenLight<T>>, 2> lights;
    std::array<EyeTransform<T>, 2> placed;
    Columns<T> scale;
#if !WITHOUT_HEAD_SHADING
    ShadingTrace<T> shading;
#endif
    Gaussians<T> gaussians;
};

// One frame, as hand-written code for just these effects.
__attribute__((noinline)) void hand_face(const HandFace& face, const AvatarConfig& c,
                                         const LandmarkRoles& roles, HandTrace& t) {
    const Index n = face.position.cols();
    const T one = T(1), reach = T(c.deform_scale), step = T(c.attribute_scale);
#if RESTS
    const Columns<T>& seen = face.anchor.size() > 0 ? face.anchor : face.position;
#else
    const Columns<T>& seen = face.position;
#endif
    encode_points(B{}, seen, c.frequencies, t.code);
    detail::tanh_into(B{}, face.feature, t.feature);
    const InfluenceInput<T> in{c, seen, face.landmarks};
#if !(WITHOUT_EXPRESSION && WITHOUT_POSE_RESIDUAL)
    t.w_exp = detail::set_weights(B{}, {in, c.exp_near, c.exp_far}, roles.expression, t.n_exp);
    t.w_pose = Columns<T>::Ones(1, n) - t.w_exp;
#endif
#if LEFT_SKIN
    t.w_left = detail::set_weights(B{}, {in, c.gaze_near, c.gaze_far}, roles.eye[0], t.n_left);
#endif
#if RIGHT_SKIN
    t.w_right = detail::set_weights(B{}, {in, c.gaze_near, c.gaze_far}, roles.eye[1], t.n_right);
#endif
    Gaussians<T>& g = t.gaussians;
#if RESTS
    g.feature.leftCols(n) = face.rest_color;
#else
    g.feature.leftCols(n).setZero();
#endif
#if !WITHOUT_EXPRESSION
    add_field(B{}, Field{face.exp_color, Squash::none, one}, {t.feature, t.w_exp, t.expression},
              g.feature, t.exp_color);
#endif
#if !WITHOUT_POSE_RESIDUAL
    add_field(B{}, Field{face.pose_color, Squash::none, one}, {t.feature, t.w_pose, t.pose},
              g.feature, t.pose_color);
#endif
#if LEFT_SKIN
    add_field(B{}, Field{face.left_color, Squash::none, one}, {t.feature, t.w_left, t.left_gaze},
              g.feature, t.left_color);
#endif
#if RIGHT_SKIN
    add_field(B{}, Field{face.right_color, Squash::none, one}, {t.feature, t.w_right, t.right_gaze},
              g.feature, t.right_color);
#endif
    g.mean.leftCols(n) = face.position;
#if !WITHOUT_EXPRESSION
    add_field(B{}, Field{face.exp_deform, Squash::tanh, reach}, {t.code, t.w_exp, t.expression},
              g.mean, t.exp_deform);
#endif
#if !WITHOUT_POSE_RESIDUAL
    add_field(B{}, Field{face.pose_deform, Squash::tanh, reach}, {t.code, t.w_pose, t.pose}, g.mean,
              t.pose_deform);
#endif
#if LEFT_SKIN
    add_field(B{}, Field{face.left_deform, Squash::tanh, reach}, {t.code, t.w_left, t.left_gaze},
              g.mean, t.left_deform);
#endif
#if RIGHT_SKIN
    add_field(B{}, Field{face.right_deform, Squash::tanh, reach}, {t.code, t.w_right, t.right_gaze},
              g.mean, t.right_deform);
#endif
#if !(WITHOUT_EXPRESSION && WITHOUT_POSE_RESIDUAL)
    t.attributes = Columns<T>::Zero(8, n);
#endif
#if !WITHOUT_EXPRESSION
    add_field(B{}, Field{face.exp_attributes, Squash::none, step},
              {t.feature, t.w_exp, t.expression}, t.attributes, t.exp_attributes);
#endif
#if !WITHOUT_POSE_RESIDUAL
    add_field(B{}, Field{face.pose_attributes, Squash::none, step}, {t.feature, t.w_pose, t.pose},
              t.attributes, t.pose_attributes);
#endif
    const RawAttributes<T> raw{face.log_scale, face.rotation, face.opacity_logit};
#if !WITHOUT_HEAD_POSE
    t.scale.resize(3, n);
    const detail::DrawnAttributes<T> drawn{t.scale, g.rotation, g.opacity};
#else
    const detail::DrawnAttributes<T> drawn{g.scale, g.rotation, g.opacity};
#endif
#if !(WITHOUT_EXPRESSION && WITHOUT_POSE_RESIDUAL)
    detail::activate_into(B{}, raw, drawn, t.attributes);
#else
    detail::activate_into(B{}, raw, drawn);
#endif
}

__attribute__((noinline)) void hand_eyes(const HandEyes& eyes, const AvatarConfig& c,
                                         const HandDrivers& drivers, Index begin, HandTrace& t) {
    const Index all = eyes.position.cols();
    const Index left_count = eyes.left_points < 0 ? all / 2 : eyes.left_points;
    const Index counts[2] = {left_count, all - left_count};
    Columns<T> centre = eyes.centre;
#if !WITHOUT_EYE_OFFSET
    t.offset.input.resize(t.expression.size() + t.pose.size(), 1);
    t.offset.input << t.expression, t.pose;
    t.offset.squashed = mlp_forward<T>(B{}, eyes.offset, t.offset.input, VecX<T>(), &t.offset.mlp);
    detail::squash_in_place(Squash::tanh, t.offset.squashed);
    centre += T(c.deform_scale) * t.offset.squashed.reshaped(3, 2);
#endif
    Gaussians<T>& g = t.gaussians;
    g.feature.middleCols(begin, all) = eyes.feature;
    const auto place = [&](Index first, EyeTransform<T>& eye) {
        const std::size_t at = first == 0 ? 0 : 1;
        const Index n = counts[at];
        const Cornea<T> cornea = cornea_of(eyes.cornea, at);
        const Vec3<T> camera = into_eye(eye, drivers.camera);
        t.placed[at] = eye;
        Columns<T>& seen = t.seen[at] = eyes.position.middleCols(first, n);
        [[maybe_unused]] const T* const from = eyes.position.data() + 3 * first;
        [[maybe_unused]] T* const to = seen.data();
        [[maybe_unused]] const auto point = [](const T* p, Index i) {
            return Eigen::Map<const Vec3<T>>(p + 3 * i);
        };
#if !WITHOUT_CORNEAL_REFRACTION
        const RefractingCornea<T> refracting{cornea, eyes.index(0, Index(at))};
        for (Index i = 0; i < n; ++i)
            Eigen::Map<Vec3<T>>(to + 3 * i) =
                seen_through<T>(refracting, camera, point(from, i));
#endif
#if !WITHOUT_GLINT
        std::vector<SeenLight<T>>& lights = t.lights[at];
        lights.clear();
        for (Index l = 0; l < eyes.light_width.cols(); ++l) {
            SeenLight<T> light;
            light.camera = camera;
            light.from_cornea = into_eye<T>(eye, eyes.light_position.col(l)) - cornea.centre;
            light.to = normalized(light.from_cornea);
            light.width = eyes.light_width(0, l);
            lights.push_back(light);
        }
        const Index stride = g.feature.rows();
        const Vec3<T> ahead = cornea.axis;
        T* colour = g.feature.data() + (begin + first) * stride;
        for (Index i = 0; i < n; ++i, colour += stride) {
            const T* const p = from + 3 * i;
            if (!(p[0] * ahead.x() + p[1] * ahead.y() + p[2] * ahead.z() > T(0))) continue;
            const Mirrored<T> mirror = mirrored<T>(cornea, camera, point(to, i));
            if (!(mirror.strength > T(0))) continue;
            for (std::size_t l = 0; l < lights.size(); ++l) {
                const T value =
                    mirror.strength * light_lobe(mirror.to, lights[l].to, lights[l].width);
                for (Index c = 0; c < detail::light_channels; ++c)
                    colour[c] += eyes.light_intensity(c, Index(l)) * value;
            }
        }
#endif
        const detail::GaussianArrays<T> out =
            detail::columns_from(arrays_of(g), {begin + first, n});
        const T* const log_scale = eyes.log_scale.data() + 3 * first;
        const T* const rotation = eyes.rotation.data() + 4 * first;
        for_chunks(Serial{}, n, 256, [&](Index b, Index e, Index) {
            for (Index i = b; i < e; ++i) {
                detail::put_column<3>(eye.apply(detail::column3(seen.data(), i)), out.mean.data, i);
                detail::put_column<4>(quat_product<T>(eye.quaternion, detail::column4(rotation, i)),
                                      out.rotation.data, i);
                for (Index k = 0; k < 3; ++k) {
                    const T scale = drawn_scale(log_scale[3 * i + k]);
#if !WITHOUT_HEAD_POSE
                    out.scale.data[3 * i + k] = scale * t.head.scale;
#else
                    out.scale.data[3 * i + k] = scale;
#endif
                }
                out.opacity.data[i] = drawn_opacity(eyes.opacity_logit(0, first + i));
            }
        });
    };
    EyeTransform<T> left = detail::eye_at<T>(centre.col(0)),
                    right = detail::eye_at<T>(centre.col(1));
#if !WITHOUT_LEFT_GAZE
    turn_eye<T>(left, drivers.left);
#endif
#if !WITHOUT_RIGHT_GAZE
    turn_eye<T>(right, drivers.right);
#endif
#if !WITHOUT_HEAD_POSE
    const HeadPlacement<T> head{{t.head.rotation, t.head.translation}, t.head.scale};
    detail::carry_eye<T>(left, head);
    detail::carry_eye<T>(right, head);
#endif
#if !WITHOUT_LEFT_GAZE
    t.left_turn = left.quaternion;
#if !WITHOUT_HEAD_POSE
    t.left_turn = quat_product<T>(quat_conjugate<T>(t.head.quaternion), left.quaternion);
#endif
#endif
#if !WITHOUT_RIGHT_GAZE
    t.right_turn = right.quaternion;
#if !WITHOUT_HEAD_POSE
    t.right_turn = quat_product<T>(quat_conjugate<T>(t.head.quaternion), right.quaternion);
#endif
#endif
    place(0, left);
    place(left_count, right);
}

struct Case {
    AvatarConfig config;
    LandmarkRoles roles;
    TwoStream<T, E> avatar;
    Drivers<T, E> drivers;
    TwoStreamTrace<T, E> trace;
    HandFace face;
    HandEyes eyes;
#if !WITHOUT_HEAD_SHADING
    Shading<T> shading;
#endif
#if !WITHOUT_VIEW_COLOR
    ViewColors<T> view_color;
#endif
    HandDrivers hand;
    HandTrace hand_trace;
};

} // namespace

extern "C" __attribute__((noinline)) void by_types(void* with) {
    Case& c = *static_cast<Case*>(with);
    drive(B{}, c.avatar, {c.config, c.roles, c.drivers}, c.trace);
}

extern "C" __attribute__((noinline)) void by_hand(void* with) {
    Case& c = *static_cast<Case*>(with);
    HandTrace& t = c.hand_trace;
#if WITHOUT_KAPPA
    const HandDrivers& d = c.hand;
#else
    HandDrivers d = c.hand;
#if !WITHOUT_LEFT_GAZE
    d.left = apply_kappa<T>(c.hand.left, {c.eyes.kappa(0, 0), c.eyes.kappa(1, 0)});
#endif
#if !WITHOUT_RIGHT_GAZE
    d.right = apply_kappa<T>(c.hand.right, {c.eyes.kappa(0, 1), c.eyes.kappa(1, 1)});
#endif
#endif
    t.expression = d.expression;
    t.pose = positional_encoding(d.pose, c.config.pose_frequencies);
#if LEFT_SKIN
    t.left_gaze = positional_encoding(pitch_yaw(d.left), c.config.gaze_frequencies);
#endif
#if RIGHT_SKIN
    t.right_gaze = positional_encoding(pitch_yaw(d.right), c.config.gaze_frequencies);
#endif
    const Index n = c.face.position.cols();
    t.gaussians.resize(n + c.eyes.position.cols(), c.config.channels);
    hand_face(c.face, c.config, c.roles, t);
#if !WITHOUT_HEAD_POSE
    const Mat3<T> r = so3_exp(Vec3<T>(d.pose.head<3>()));
    t.head = {r, matrix_quat(r), d.pose.tail<3>(), d.scale};
    to_world(B{}, t.head, t.scale, t.gaussians);
#endif
    hand_eyes(c.eyes, c.config, d, n, t);
#if !WITHOUT_VIEW_COLOR
#if !WITHOUT_HEAD_POSE
    add_view_colors(B{}, c.view_color, {d.camera, t.head.rotation}, t.gaussians);
#else
    add_view_colors(B{}, c.view_color, {d.camera, Mat3<T>::Identity()}, t.gaussians);
#endif
#endif
#if !WITHOUT_HEAD_SHADING
    const Index left = c.eyes.left_points < 0 ? c.eyes.position.cols() / 2 : c.eyes.left_points;
    shade(B{}, c.shading, {d.pose.head<3>(), n, left}, t.gaussians.feature, t.shading);
#endif
}

namespace {

Columns<T> numbers(Index rows, Index cols, double size, double middle, std::uint64_t stream) {
    Columns<T> a(rows, cols);
    const Random random{3, stream};
    for (Index i = 0; i < a.size(); ++i)
        a(i) = T(middle + size * (2 * random.uniform(static_cast<std::uint64_t>(i)) - 1));
    return a;
}

void fill(Case& c, Index n, Index per_eye) {
    AvatarConfig& k = c.config;
    k.expression = 4, k.feature = 6, k.channels = 8;
    k.networks = {{8}, {8}, {8}, {8}, {8}, {8}, {8}, {8}, {8}, {8}};
    FaceStream<T, E>& f = c.avatar.face;
    f.networks = FaceNetworks<T, E>::init(k, Random{5, 0});
    f.position = numbers(3, n, 0.7, 0, 1);
    f.feature = numbers(k.feature, n, 1, 0, 2);
    f.log_scale = numbers(3, n, 0.3, -3, 3);
    f.rotation = numbers(4, n, 1, 0, 4);
    f.opacity_logit = numbers(1, n, 1, 0, 5);
    f.landmarks = numbers(3, 66, 0.7, 0, 6);
    for (Index i = 0; i < 66; ++i)
        (i < 54 ? c.roles.expression : c.roles.eye[i < 60 ? 0 : 1]).push_back(i);
    const auto attributes = [&](int frame) {
        return Mlp<T>::init(mlp_shape(k.feature, frame, {8}, 8), Random{6, 0});
    };
#if !WITHOUT_EXPRESSION
    f.exp_attributes = attributes(k.expression);
    c.face.exp_attributes = f.exp_attributes;
    c.face.exp_color = f.networks.exp_color;
    c.face.exp_deform = f.networks.exp_deform;
#endif
#if !WITHOUT_POSE_RESIDUAL
    f.pose_attributes = attributes(k.pose_code());
    c.face.pose_attributes = f.pose_attributes;
    c.face.pose_color = f.networks.pose_color;
    c.face.pose_deform = f.networks.pose_deform;
#endif
#if LEFT_SKIN
    c.face.left_color = of_eye<0>(f.networks.gaze_color);
    c.face.left_deform = of_eye<0>(f.networks.gaze_deform);
#endif
#if RIGHT_SKIN
    c.face.right_color = of_eye<1>(f.networks.gaze_color);
    c.face.right_deform = of_eye<1>(f.networks.gaze_deform);
#endif
#if RESTS
    f.rest_color = c.face.rest_color = numbers(k.channels, n, 1, 0, 7);
#endif
    c.face.position = f.position, c.face.feature = f.feature, c.face.log_scale = f.log_scale;
    c.face.rotation = f.rotation, c.face.opacity_logit = f.opacity_logit;
    c.face.landmarks = f.landmarks;

    EyeStream<T, E>& e = c.avatar.eyes;
    e.feature = c.eyes.feature = numbers(k.channels, 2 * per_eye, 1, 0, 8);
    e.log_scale = c.eyes.log_scale = numbers(3, 2 * per_eye, 0.3, -4, 9);
    e.rotation = c.eyes.rotation = numbers(4, 2 * per_eye, 1, 0, 10);
    e.opacity_logit = c.eyes.opacity_logit = numbers(1, 2 * per_eye, 1, 0, 11);
    e.position = c.eyes.position = numbers(3, 2 * per_eye, 0.1, 0, 12);
    e.centre = c.eyes.centre = numbers(3, 2, 0.3, 0, 13);
    e.spacing = c.eyes.spacing = numbers(1, 2 * per_eye, 0.01, 0.02, 14);
#if !WITHOUT_EYE_OFFSET
    e.offset = EyeOffsetNetwork<T>::init(k, Random{7, 0});
    e.offset.mlp.weight.back() = numbers(6, e.offset.mlp.weight.back().cols(), 0.3, 0, 15);
    c.eyes.offset = e.offset.mlp;
#endif
#if !WITHOUT_KAPPA
    e.kappa = c.eyes.kappa = numbers(2, 2, 0.1, 0, 16);
#endif
    const Cornea<T> cornea{Vec3<T>(0, 0, 0.05f), 0.09f, Vec3<T>(0, 0, 1), 0.02f};
    set_corneas(e.optics, cornea, cornea);
    c.eyes.cornea = e.optics.cornea;
#if !WITHOUT_CORNEAL_REFRACTION
    set_refraction(e.optics);
    c.eyes.index = e.optics.index;
#endif
#if !WITHOUT_GLINT
    e.optics.light_position = c.eyes.light_position = numbers(3, 2, 3, 6, 19);
    e.optics.light_intensity = c.eyes.light_intensity = numbers(3, 2, 0.2, 0.5, 20);
    e.optics.light_width = c.eyes.light_width = Columns<T>::Constant(1, 2, 0.03f);
#endif
#if !WITHOUT_HEAD_SHADING
    c.shading = {numbers(8, 3, 0.5, 0, 21), numbers(3, n, 1, 0, 22), numbers(3, 2, 1, 0, 23)};
    c.avatar.shading = c.shading;
#endif
#if !WITHOUT_VIEW_COLOR
    c.view_color = {numbers(9, n, 0.1, 0, 24), numbers(9, 2 * per_eye, 0.1, 0, 25)};
    c.avatar.view_color = c.view_color;
#endif
    c.drivers.camera = c.hand.camera = Vec3<T>(0.5f, 0.3f, 8.0f);
    c.drivers.expression = c.hand.expression = numbers(k.expression, 1, 1, 0, 17).col(0);
    c.drivers.pose = c.hand.pose = numbers(6, 1, 0.2, 0, 18).col(0);
#if !WITHOUT_HEAD_POSE
    c.drivers.scale = c.hand.scale = 1.1f;
#endif
#if !WITHOUT_LEFT_GAZE
    of_eye<0>(c.drivers.gaze) = c.hand.left = Vec3<T>(0.2f, 0.1f, 0.95f);
#endif
#if !WITHOUT_RIGHT_GAZE
    of_eye<1>(c.drivers.gaze) = c.hand.right = Vec3<T>(-0.1f, 0.2f, 0.9f);
#endif
}

bool equal(const Gaussians<T>& a, const Gaussians<T>& b) {
    bool same = true;
    Gaussians<T>::fields([&](const std::string&, const auto& x, const auto& y) {
        same = same && x.size() > 0 && x == y;
    }, a, b);
    return same;
}

} // namespace

int main(int argc, char** argv) {
    static Case c;
    fill(c, 4000, 1000);
    // A first frame allocates the memory of both, so that the counted ones are steady.
    by_types(&c);
    by_hand(&c);
    if (argc > 1 && std::strcmp(argv[1], "types") == 0) by_types(&c);
    if (argc > 1 && std::strcmp(argv[1], "hand") == 0) by_hand(&c);
    if (!equal(c.trace.gaussians, c.hand_trace.gaussians)) {
        std::puts("by types and by hand differ");
        return 1;
    }
}
