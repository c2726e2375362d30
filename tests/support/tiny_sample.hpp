// SPDX-License-Identifier: Apache-2.0
/// tests/support/tiny_sample.hpp: a step's pictures for the tiny avatar.
#pragma once

#include <rye/avatar/hold.hpp>
#include <rye/train/augment.hpp>
#include <rye/train/samples.hpp>

#include "tiny_avatar.hpp"

namespace rye::test {

/// Random pictures of a frame, whose correction is the second column, with masks that are not whole.
template <class T, EffectSet E = PaperEffects>
AvatarSample<T, E> tiny_sample(Draw draw) {
    constexpr int w = 18, h = 14;
    const auto image = [&](int width, int height) {
        Image<T> i(width, height, 3);
        i.pixels = draw.columns(3, i.size(), 0.5).unaryExpr([](double x) { return T(x + 0.5); });
        return i;
    };
    AvatarSample<T, E> s;
    s.drivers = restricted<E>(tiny_drivers<T>());
    s.frame = 1;
    s.camera = tiny_camera(w, h).cast<T>();
    s.truth = image(2 * w, 2 * h);
    s.truth_small = image(w, h);
    s.visible = Columns<T>::Ones(1, s.truth.size());
    s.visible_small = Columns<T>::Ones(1, s.truth_small.size());
    s.visible_small(0, 5) = T(0);
    s.eyes = Columns<T>::Zero(1, s.truth.size());
    s.eyes_small = Columns<T>::Zero(1, s.truth_small.size());
    for (Index i = 60; i < 90; ++i) s.eyes_small(0, i) = T(1);
    for (Index i = 300; i < 400; ++i) s.eyes(0, i) = T(1);
    s.mask_small = Columns<T>::Constant(1, s.truth_small.size(), T(0.75));
    s.scale = random_scale(w, h, 2, draw.random.fork(3));
    s.background = VecX<T>::Ones(5);
    s.blank = draw.columns(5, 1, 0.5).unaryExpr([](double x) { return T(x + 0.5); });
    return s;
}

} // namespace rye::test
