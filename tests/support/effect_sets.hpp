// SPDX-License-Identifier: Apache-2.0
/// tests/support/effect_sets.hpp: a tiny avatar with every effect, and its drivers.
#pragma once

#include <rye/avatar/hold.hpp>
#include <rye/avatar/neutral.hpp>

#include "tiny_avatar.hpp"

namespace rye::test {

using AllEffects = More<PaperEffects, Kappa>;

/// An avatar of every effect, none of them neutral.
inline TwoStream<double, AllEffects> avatar_of_all(std::uint64_t seed = 7) {
    Draw draw{{seed, 1}};
    TwoStream<double, AllEffects> a = restricted<AllEffects>(tiny_avatar(tiny_config(), draw));
    a.eyes.kappa = draw.columns(2, 2, 0.1);
    return a;
}

inline Drivers<double, AllEffects> drivers_of_all() {
    return restricted<AllEffects>(tiny_drivers<double>());
}

/// Corneas that some of the tiny eyes' points lie behind, which refract, and two lights.
template <class T, EffectSet E>
void set_tiny_lights(EyeOptics<T, E>& o) {
    const Cornea<T> left{Vec3<T>(T(0), T(0), T(0.04)), T(0.11), Vec3<T>(T(0), T(0), T(1)), T(0.02)};
    Cornea<T> right = left;
    right.centre = Vec3<T>(T(0.01), T(-0.005), T(0.05));
    right.axis = right.centre.normalized();
    set_corneas(o, left, right);
    if constexpr (has_effect<E, CornealRefraction>) {
        set_refraction(o);
        o.index << T(1.35), T(1.4);
    }
    if constexpr (has_effect<E, Glint>) {
        resize_lights(o, 2);
        o.light_position << 1, -2, 3, 1, 7, 5;
        o.light_intensity << T(0.9), T(0.3), T(0.7), T(0.5), T(0.4), T(0.8);
        o.light_width << T(0.5), T(0.8);
    }
}

/// Gives the tiny eyes points as a template has them: of each the back pole, the middle of the
/// iris, two on the limbus, and the others on the iris.
template <class T, EffectSet E>
void set_tiny_irises(EyeStream<T, E>& eyes) {
    EyeballShape shape = EyeballShape{}.with_limbus(0.05);
    shape.iris_plane = 0.1;
    for (Index eye = 0; eye < 2; ++eye) {
        const Index first = eyes.first_point(eye), n = eyes.points_of(eye);
        for (Index k = 0; k < n; ++k) {
            const double angle = 2.4 * double(k) + double(eye);
            const double share = k < 2 ? 0 : k < 4 ? 1 : double(k - 3) / double(n - 3);
            const double r = share * shape.limbus_radius,
                         z = k == 0 ? -shape.sclera_radius
                             : k < 4 ? (k == 1 ? 0.1 : shape.limbus_plane())
                                     : shape.iris(r);
            eyes.position.col(first + k) << T(r * std::cos(angle)), T(r * std::sin(angle)), T(z);
        }
    }
}

/// Gives the tiny avatar upper lids of five points each, some of them before the eyes, whose
/// shadows some of the eyes' points lie in.
template <class T, EffectSet E>
void set_tiny_lids(TwoStream<T, E>& avatar) {
    avatar.eyes.lid_shadow.resize(3, 2);
    avatar.eyes.lid_shadow << T(0.4), T(-0.3), T(-0.8), T(-0.4), T(0.1), T(-0.2);
    avatar.eyes.lid_line.resize(3, 10);
    avatar.eyes.lid_line.row(0) << T(3), T(9), T(21), T(22), T(40), T(5), T(9), T(30), T(31), T(59);
    for (Index k = 0; k < 10; ++k) // about the eye, higher in the middle
        avatar.eyes.lid_line.col(k).template tail<2>() =
            avatar.eyes.centre.col(k / 5).template head<2>() +
            Vec2<T>(T(0.06) * T(k % 5 - 2), T(0.06) - T(0.015) * T((k % 5 - 2) * (k % 5 - 2)));
}

/// Gives the tiny avatar colours that depend on the view.
template <class T, EffectSet E>
void set_tiny_view_colors(TwoStream<T, E>& avatar, int degree = 3) {
    Draw draw{{5, 11}};
    const Index rows = view_color_numbers(degree);
    avatar.view_color = {draw.columns(rows, avatar.face.position.cols(), 0.2).template cast<T>(),
                         draw.columns(rows, avatar.eyes.position.cols(), 0.2).template cast<T>()};
}

/// An avatar of the gaze mechanism, the eye appearance and the shading of E, none of them neutral.
template <EffectSet E>
TwoStream<double, E> avatar_with_parts(std::uint64_t seed = 7) {
    TwoStream<double, E> a = restricted<E>(avatar_of_all(seed));
    using Appearance = EyeAppearanceOf<E>;
    if constexpr (!std::same_as<Appearance, FreeFeatures>)
        a.eyes.appearance() = init_eye_appearance<Appearance, double>(
            appearance_sizes<E>(tiny_config(), a.eyes.position.cols()), Random{seed, 8});
    using Mechanism = GazeMechanismOf<E>;
    a.eyes.mechanism() = Mechanism::template init<GazeMechanismParameters<double, E>>(
        tiny_config().channels, Random{seed, 9});
    Draw draw{{seed, 10}};
    if constexpr (requires { a.eyes.networks; })
        for (auto& n : a.eyes.networks)
            for (auto& w : n.weight) w = draw.columns(w.rows(), w.cols(), 0.2);
    if constexpr (has_effect<E, HeadShading>)
        a.shading = {draw.columns(8, 3, 0.5), draw.columns(3, a.face.position.cols()),
                     draw.columns(3, 2)};
    if constexpr (has_effect<E, ViewColor>) set_tiny_view_colors(a);
    if constexpr (has_effect<E, SeesCornea>) set_tiny_lights(a.eyes.optics);
    if constexpr (has_effect<E, Pupil>) set_tiny_irises(a.eyes);
    if constexpr (has_effect<E, LidShadow>) set_tiny_lids(a);
    if constexpr (requires { a.eyes.turn; })
        a.eyes.turn.weight.back() = draw.columns(4, a.eyes.turn.weight.back().cols(), 0.2);
    return a;
}

/// And with what a camera sees through and on the corneas, with some of the points behind them, and
/// shading by the head's rotation.
using OpticsEffects = More<AllEffects, CornealRefraction, Glint, HeadShading>;

inline TwoStream<double, OpticsEffects> avatar_of_optics(std::uint64_t seed = 7) {
    TwoStream<double, OpticsEffects> a = restricted<OpticsEffects>(avatar_of_all(seed));
    set_tiny_lights(a.eyes.optics);
    Draw draw{{seed, 5}};
    a.shading = {draw.columns(8, 3, 0.5), draw.columns(3, a.face.position.cols()),
                 draw.columns(3, 2)};
    return a;
}

/// The drivers with these pupils, left and right, where there are any.
template <class T, EffectSet E>
Drivers<T, E> with_pupils(Drivers<T, E> d, [[maybe_unused]] const std::array<T, 2>& ratio) {
    for_eyes([&]<std::size_t eye>() {
        if constexpr (pupil_moves<E, eye>) of_eye<eye>(d.pupil) = ratio[eye];
    });
    return d;
}
/// The drivers of an avatar with the effects E that the tiny camera looks at, its pupils at rest.
template <EffectSet E, class T, EffectSet F>
Drivers<T, E> seen_drivers(const Drivers<T, F>& drivers) {
    return seen_from(restricted<E>(drivers), tiny_camera(8, 8));
}
inline Drivers<double, OpticsEffects> drivers_of_optics() {
    return seen_drivers<OpticsEffects>(tiny_drivers<double>());
}

template <class T, EffectSet E>
TwoStreamTrace<T, E> driven(const TwoStream<T, E>& avatar, const Drivers<T, E>& drivers) {
    TwoStreamTrace<T, E> trace;
    drive(ScalarBackend<>{}, avatar, {tiny_config(), tiny_roles(), drivers}, trace);
    return trace;
}

} // namespace rye::test
