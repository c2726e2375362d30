// SPDX-License-Identifier: Apache-2.0
/// rye/rig/eye_dynamics.hpp: how fast eyes and lids move: saccades of the main sequence, blinks,
/// and the turn of eyes against that of the head. Angles [rad], times [s]. Every formula is smooth
/// and for every scalar.
/// Source: the main sequence, peak speed = V (1 - exp(-A / c)): Bahill, Clark, Stark, "The main
/// sequence, a tool for studying human eye movements", 1975; a course of a saccade that has it:
/// Dai, Selesnick, Rizzo, Rucker, Hudson, "A parametric model for saccadic eye movement", 2016; V
/// and c: fitted to the mean peak speeds of Hopf et al., "Age dependent normative data of vertical
/// and horizontal reflexive saccades", 2018 (5 to 30 degrees), within 7 percent of each.
#pragma once

#include <cmath>
#include <type_traits>

#include <rye/geometry/rigid.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

namespace rye {

/// Constants of the main sequence.
template <Scalar T>
struct MainSequence {
    T fastest = constant<T>(7.574729); ///< V, the speed of long saccades [rad/s] (434 degrees/s)
    T bend = constant<T>(0.13613568);  ///< c, where the speed begins to level off [rad] (7.8 deg)
};

/// Returns the peak speed [rad/s] of a saccade of an amplitude >= 0 [rad].
template <Scalar T>
RYE_HD T saccade_peak_speed(const T& amplitude, const MainSequence<T>& m = {}) {
    using std::exp;
    return m.fastest * (T(1) - exp(-(amplitude / m.bend)));
}

/// Returns the time [s] from when an eye has 1/1600 of `bend` behind it to when it has as much
/// ahead of it: (A + 6 c) / V.
template <Scalar T>
RYE_HD T saccade_duration(const T& amplitude, const MainSequence<T>& m = {}) {
    return (amplitude + T(6) * m.bend) / m.fastest;
}

namespace detail {

/// Returns a smooth max(x, 0), whose slope goes from 0 to 1.
template <Scalar T>
RYE_HD T smooth_ramp(const T& x) {
    using std::abs, std::exp;
    return max(x, T(0)) + constant<T>(0.25) * exp(T(-2) * abs(x));
}

/// Returns 0 to 0, 1 from 1 on, and 10 u^3 - 15 u^4 + 6 u^5 between.
template <Scalar T>
RYE_HD T smooth_rise(const T& x) {
    const T u = clamp_value(x, T(0), T(1));
    return u * u * u * (T(10) + u * (T(6) * u - T(15)));
}

/// Returns the angle [rad] that a saccade has covered t [s] after its middle, where it is fastest:
/// from 0 long before to the amplitude long after; of an amplitude of 0, 0.
template <Scalar T>
RYE_HD T saccade_travel(const T& amplitude, const T& t, const MainSequence<T>& m = {}) {
    const T half = constant<T>(0.5) * amplitude / m.bend, x = m.fastest * t / m.bend;
    return m.bend * (detail::smooth_ramp(T(x + half)) - detail::smooth_ramp(T(x - half)));
}

} // namespace detail

/// Phases of a blink. The default, 0.26 s, is a brief one of the 0.1 to 0.5 s of spontaneous
/// blinks; the lid closes faster than it opens. Source: VanderWerf et al., "Eyelid movements:
/// behavioral studies of blinking in humans under different stimulus conditions", 2003.
template <Scalar T>
struct BlinkPhases {
    T closing = constant<T>(0.08); ///< > 0 [s]
    T closed = constant<T>(0.02);  ///< >= 0 [s]
    T opening = constant<T>(0.16); ///< > 0 [s]

    RYE_HD T duration() const { return closing + closed + opening; }
};

namespace detail {

/// Returns how far lids are closed t [s] after a blink's beginning: 0 open, 1 closed; 0 before and
/// after it. Speed and acceleration are continuous (minimum jerk: 10 u^3 - 15 u^4 + 6 u^5).
template <Scalar T>
RYE_HD T blink_closure(const T& t, const BlinkPhases<T>& p = {}) {
    return detail::smooth_rise(T(t / p.closing)) -
           detail::smooth_rise(T((t - p.closing - p.closed) / p.opening));
}

} // namespace detail

/// Returns the gaze, in the head's frame now, that keeps the direction which `gaze` had in the
/// world while the head was turned as `before`: the vestibulo-ocular reflex. `gain` 1 keeps it
/// exactly, 0 keeps the eye in the head. Both rotations are world from head.
template <Scalar T>
RYE_HD Vec3<T> steadied_gaze(const Mat3<T>& before, const Mat3<T>& now, const Vec3<T>& gaze,
                             const std::type_identity_t<T>& gain = T(1)) {
    Mat3<T> back; // the head of before as seen from the head of now
    for (int i = 0; i < 3; ++i) {
        const Vec3<T> column = before.col(i);
        const Vec3<T> seen = gaze_in_head(now, column);
        for (int k = 0; k < 3; ++k) back(k, i) = seen[k];
    }
    const Vec3<T> turn = so3_log(back);
    const Vec3<T> part(gain * turn[0], gain * turn[1], gain * turn[2]);
    return gaze_in_world(so3_exp(part), gaze);
}

} // namespace rye
