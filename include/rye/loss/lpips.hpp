// SPDX-License-Identifier: Apache-2.0
/// rye/loss/lpips.hpp: the learned perceptual distance LPIPS 0.1.4, net = 'vgg', with the user's
/// weights; cmake/convert_lpips_weights.py writes them. Images hold RGB in 0..1 (normalize = True).
/// Per slice: features scaled to unit length per pixel, squared difference, weighted sum over
/// channels, mean over pixels; summed over slices.
/// Source: Zhang et al., "The Unreasonable Effectiveness of Deep Features", 2018, eq. 1.
#pragma once

#include <array>
#include <cmath>
#include <string>
#include <tuple>

#include <rye/loss/perceptual.hpp>
#include <rye/nn/features.hpp>

namespace rye {

namespace detail {

/// Shift of red, green and blue: an image in -1..1 is normalised to (x - shift) / scale.
inline constexpr std::array<double, 3> lpips_shift{-0.030, -0.088, -0.188};
/// Divisors of red, green and blue after lpips_shift.
inline constexpr std::array<double, 3> lpips_scale{0.458, 0.448, 0.450};
/// Number added to the norm of a feature vector.
inline constexpr double lpips_eps = 1e-10;

} // namespace detail

/// Network, and weights of its slices (channels x 1, not negative).
template <class T>
struct LpipsWeights {
    Vgg<T> net;
    std::array<Columns<T>, vgg_slices> linear;

    explicit LpipsWeights(const VggShape& shape = {}) : net(shape) {
        for (std::size_t s = 0; s < vgg_slices; ++s)
            linear[s] = Columns<T>::Zero(shape.channels[s], 1);
    }
    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        Vgg<T>::fields(f, p.net...);
        for (std::size_t s = 0; s < vgg_slices; ++s)
            f("lin" + std::to_string(s) + ".weight", p.linear[s]...);
    }
};

namespace detail {

/// Returns a feature, or a vector of them, divided by s, the feature vector's norm plus lpips_eps.
template <class X, class S>
RYE_HD auto of_unit_length(const X& f, const S& s) {
    return f / s;
}
/// Returns the cotangent of f, given g, that of f / s, and dot = <f, g>; s = r + lpips_eps, r =
/// |f|.
template <class X, class G, class S>
RYE_HD auto unit_length_vjp(const X& f, const G& g, const S& dot, const S& r, const S& s) {
    return g / s - f * (dot / (r * s * s));
}

/// Returns the contribution of one slice: the value, and the cotangent of the first features.
template <class T, Backend B>
LossGradient<T> lpips_slice(const B& backend, const Columns<T>& fa, const Columns<T>& fb,
                            const Columns<T>& weight) {
    using std::sqrt;
    LossGradient<T> loss{T(0), Columns<T>(fa.rows(), fa.cols())};
    const T eps(static_cast<real_t<T>>(lpips_eps));
    const T share(static_cast<real_t<T>>(1.0 / static_cast<double>(fa.cols())));
    const T sum = sum_chunks(backend.threads, fa.cols(), 256, T(0), [&](Index first, Index last) {
        T total(0);
        for (Index j = first; j < last; ++j) {
            const T ra = sqrt(fa.col(j).squaredNorm()), rb = sqrt(fb.col(j).squaredNorm());
            const VecX<T> d =
                of_unit_length(fa.col(j), ra + eps) - of_unit_length(fb.col(j), rb + eps);
            const VecX<T> wd = weight.col(0).cwiseProduct(d);
            total += d.dot(wd);
            // Features of norm 0 come from a ReLU whose slope is 0.
            const T s = ra + eps;
            const VecX<T> g = T(2 * share) * wd;
            if (ra > T(0))
                loss.gradient.col(j) = unit_length_vjp(fa.col(j), g, fa.col(j).dot(g), ra, s);
            else
                loss.gradient.col(j).setZero();
        }
        return total;
    });
    loss.value = sum * share;
    return loss;
}

/// Maps an image in 0..1 to the range of the network's training.
template <class T>
Image<T> lpips_input(const Image<T>& image) {
    Image<T> out = image;
    for (Index c = 0; c < 3; ++c) {
        const std::size_t i = static_cast<std::size_t>(c);
        const T gain(static_cast<real_t<T>>(2.0 / lpips_scale[i]));
        const T offset(static_cast<real_t<T>>((-1.0 - lpips_shift[i]) / lpips_scale[i]));
        out.pixels.row(c) = (out.pixels.row(c).array() * gain + offset).matrix();
    }
    return out;
}

} // namespace detail

/// LPIPS as a PerceptualLoss, with the gradient of the first image.
template <class T>
struct LpipsVgg {
    LpipsWeights<T> weights;

    /// Returns the distance alone, without its gradient.
    template <Backend B>
    T value(const B& backend, const Image<T>& a, const Image<T>& b) const {
        const auto [ta, tb] = traces(backend, a, b);
        T sum(0);
        for (std::size_t s = 0; s < vgg_slices; ++s) {
            const int slice = static_cast<int>(s);
            sum += detail::lpips_slice<T>(backend, ta.feature(slice).pixels,
                                          tb.feature(slice).pixels, weights.linear[s])
                       .value;
        }
        return sum;
    }
    template <Backend B>
    LossGradient<T> operator()(const B& backend, const Image<T>& a, const Image<T>& b) const {
        const auto [ta, tb] = traces(backend, a, b);
        LossGradient<T> loss;
        std::array<Columns<T>, vgg_slices> g;
        for (std::size_t s = 0; s < vgg_slices; ++s) {
            const int slice = static_cast<int>(s);
            LossGradient<T> part = detail::lpips_slice<T>(
                backend, ta.feature(slice).pixels, tb.feature(slice).pixels, weights.linear[s]);
            loss.value += part.value;
            g[s] = std::move(part.gradient);
        }
        loss.gradient = vgg_vjp_input(backend, weights.net, ta, g);
        for (std::size_t c = 0; c < 3; ++c)
            loss.gradient.row(static_cast<Index>(c)) *=
                T(static_cast<real_t<T>>(2.0 / detail::lpips_scale[c]));
        return loss;
    }

  private:
    template <Backend B>
    std::array<VggTrace<T>, 2> traces(const B& backend, const Image<T>& a,
                                      const Image<T>& b) const {
        detail::require_same_shape<T>("LpipsVgg", a.pixels, b.pixels, Columns<T>());
        require(a.channels() == 3, "LpipsVgg", "got ", a.channels(), " channels, expected 3");
        return {vgg_forward(backend, weights.net, detail::lpips_input(a)),
                vgg_forward(backend, weights.net, detail::lpips_input(b))};
    }
};

} // namespace rye
