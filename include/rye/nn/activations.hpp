// SPDX-License-Identifier: Apache-2.0
/// rye/nn/activations.hpp: activation functions and their slopes, element by element.
#pragma once

#include <cmath>
#include <concepts>

#include <rye/core/concepts.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

namespace detail {

/// Slope of LeakyReLU for negative inputs.
inline constexpr double leaky_slope = 0.01;

} // namespace detail

/// x for x > 0, else 0.01 x; NaN for NaN.
template <class T>
RYE_HD T leaky_relu(const T& x) {
    return select(x > T(0), x, T(T(real_t<T>(detail::leaky_slope)) * x));
}

/// The cotangent of the input, from the *output* y, whose sign is that of the input.
template <class T>
RYE_HD T leaky_relu_vjp(const T& y, const T& g) {
    return select(y > T(0), g, T(T(real_t<T>(detail::leaky_slope)) * g));
}

/// Activation after the hidden layers of a network: value of the input, and the cotangent of the
/// input from the output y. Both are templates over numbers and vectors of lanes, without branches.
template <class A>
concept Activation = requires(const float x) {
    { A::value(x) } -> std::same_as<float>;
    { A::vjp(x, x) } -> std::same_as<float>;
};

/// leaky_relu as an Activation.
struct LeakyRelu {
    template <class T>
    RYE_HD static T value(const T& x) {
        return leaky_relu(x);
    }
    template <class T>
    RYE_HD static T vjp(const T& y, const T& g) {
        return leaky_relu_vjp(y, g);
    }
};
static_assert(Activation<LeakyRelu>);

/// x for x > 0, else 0; NaN for NaN, unlike max(0, x), so that NaNs reach the finite checks.
template <class T>
RYE_HD T relu(const T& x) {
    return select(x <= T(0), T(0), x);
}

/// Cotangent of x for relu, in terms of y = relu(x).
template <class T>
RYE_HD T relu_vjp(const T& y, const T& g) {
    return select(y > T(0), g, T(0));
}

/// Function that bounds a network's output.
enum class Squash { none, tanh, sigmoid };

namespace detail {

/// y = squash(v).
template <Scalar T>
RYE_HD T squash_value(Squash squash, const T& v) {
    using std::tanh;
    if (squash == Squash::tanh) return tanh(v);
    return squash == Squash::sigmoid ? sigmoid(v) : v;
}

/// dy / dv of y = tanh(v), in terms of y.
template <Scalar T>
RYE_HD T tanh_slope(const T& y) {
    return (T(1) - y) * (T(1) + y);
}
/// dy / dv of y = sigmoid(v), in terms of y.
template <Scalar T>
RYE_HD T sigmoid_slope(const T& y) {
    return y * (T(1) - y);
}
/// dy / dv of y = squash(v), in terms of y.
template <Scalar T>
RYE_HD T squash_slope(Squash squash, const T& y) {
    if (squash == Squash::tanh) return tanh_slope(y);
    return squash == Squash::sigmoid ? sigmoid_slope(y) : T(1);
}

/// Margin of the clamped skip base: half an 8-bit step is invisible, and z still has a gradient.
inline constexpr double base_margin = 1e-3;

template <class T>
RYE_HD T clamped_base(const T& b) {
    const auto m = static_cast<real_t<T>>(base_margin);
    return clamp_value(b, T(m), T(1 - m));
}

/// Cotangent of b, given that of z + logit(clamped_base(b)); half of it at the ends of the clamp.
template <class T>
RYE_HD T clamped_base_vjp(const T& b, const T& g) {
    using R = real_t<T>;
    const R low = static_cast<R>(base_margin), high = 1 - low, v = value_of(b);
    const R slope = v > low && v < high ? R(1) : v < low || v > high ? R(0) : R(0.5f);
    const T c = clamped_base(b);
    return T(slope) * g / (c * (T(1) - c));
}

/// b e^z / (b e^z + 1 - b), without overflow of the exponential.
template <class T>
RYE_HD T odds_sigmoid(const T& b, const T& z) {
    using std::abs, std::exp;
    const T e = exp(-abs(z));
    const T p = select(z < T(0), T(b * e), b), q = select(z < T(0), T(T(1) - b), T((T(1) - b) * e));
    return p / (p + q);
}

} // namespace detail

} // namespace rye
