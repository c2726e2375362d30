// SPDX-License-Identifier: Apache-2.0
/// rye/loss/perceptual.hpp: losses that look at structure rather than at single pixels.
/// The default needs no weights of a trained network and is named as what it is: L1 between the
/// finite differences of two image pyramids. It is linear in a - b up to the final |.|, so the
/// pyramid is built of the difference alone. LPIPS with a user's weights is in loss/lpips.hpp.
#pragma once

#include <array>
#include <concepts>
#include <string>
#include <vector>

#include <rye/backend/scalar.hpp>
#include <rye/loss/photometric.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

/// loss(a, b): value, and cotangent of a.
template <class L>
concept PerceptualLoss = requires(const L& loss, const Image<float>& a) {
    { loss(a, a) } -> std::same_as<LossGradient<float>>;
};

/// sum over levels of weight (mean |horizontal difference| + mean |vertical difference|), of a - b.
/// Each level is the 2 x 2 average of the one below; an odd last row or column is left out of it.
struct PyramidGradientLoss {
    /// Of level 0 (the image itself), 1 and 2. Equal: a coarse difference is larger for the same
    /// edge, and a blur moves the fine ones, so neither needs to be raised.
    std::array<double, 3> weight{1.0, 1.0, 1.0};

    template <class T>
    LossGradient<T> operator()(const Image<T>& a, const Image<T>& b) const {
        return run<ScalarBackend<>>(a, b);
    }
    template <Backend B, class T>
    LossGradient<T> run(const Image<T>& a, const Image<T>& b) const;
};
static_assert(PerceptualLoss<PyramidGradientLoss>);

namespace detail {

/// Rows per chunk of the pyramid's passes.
inline constexpr Index pyramid_rows = 16;

template <Backend B, class T>
Image<T> halved(const Image<T>& in) {
    Image<T> out(in.width / 2, in.height / 2, in.channels());
    for_chunks<typename B::threads>(out.height, pyramid_rows, [&](Index b, Index e, Index) {
        for (int y = static_cast<int>(b); y < static_cast<int>(e); ++y)
            for (int x = 0; x < out.width; ++x)
                out.at(x, y) = T(0.25f) * (in.at(2 * x, 2 * y) + in.at(2 * x + 1, 2 * y) +
                                           in.at(2 * x, 2 * y + 1) + in.at(2 * x + 1, 2 * y + 1));
    });
    return out;
}

/// mean |d(i + 1) - d(i)| along both axes, times weight; adds its slope to g.
template <Backend B, class T>
T difference_l1(const Image<T>& d, double weight, Image<T>& g) {
    using std::abs;
    const Index w = d.width, h = d.height, c = d.channels();
    // Mean over the differences that exist; an axis of one pixel has none.
    const auto share = [&](Index n) {
        return T(static_cast<real_t<T>>(n > 0 ? weight / static_cast<double>(n) : 0.0));
    };
    const T across = share((w - 1) * h * c), down = share(w * (h - 1) * c);
    return sum_chunks<typename B::threads>(h, pyramid_rows, T(0), [&](Index first, Index last) {
        T total(0);
        for (Index y = first; y < last; ++y) {
            T row(0);
            for (Index x = 0; x < w; ++x)
                for (Index i = 0; i < c; ++i) {
                    const T* p = d.pixels.data() + (y * w + x) * c + i;
                    T slope(0);
                    if (x + 1 < w) row += across * abs(p[c] - p[0]);
                    if (x + 1 < w) slope += across * sign_of<T>(p[0] - p[c]);
                    if (x > 0) slope += across * sign_of<T>(p[0] - p[-c]);
                    if (y + 1 < h) row += down * abs(p[w * c] - p[0]);
                    if (y + 1 < h) slope += down * sign_of<T>(p[0] - p[w * c]);
                    if (y > 0) slope += down * sign_of<T>(p[0] - p[-w * c]);
                    g.pixels(i, y * w + x) += slope;
                }
            total += row;
        }
        return total;
    });
}

} // namespace detail

template <Backend B, class T>
LossGradient<T> PyramidGradientLoss::run(const Image<T>& a, const Image<T>& b) const {
    detail::require_same_shape<T>("PyramidGradientLoss", a.pixels, b.pixels, Columns<T>());
    std::vector<Image<T>> d(1), g;
    d[0].width = a.width;
    d[0].height = a.height;
    d[0].pixels = a.pixels - b.pixels;
    LossGradient<T> loss;
    for (std::size_t level = 0; level < weight.size(); ++level) {
        if (level > 0) d.push_back(detail::halved<B>(d.back()));
        g.emplace_back(d.back().width, d.back().height, a.channels());
        loss.value += detail::difference_l1<B>(d.back(), weight[level], g.back());
    }
    for (std::size_t level = weight.size() - 1; level > 0; --level) {
        const Image<T>& coarse = g[level];
        Image<T>& fine = g[level - 1];
        for_chunks<typename B::threads>(
            coarse.height, detail::pyramid_rows, [&](Index first, Index last, Index) {
                for (int y = 2 * static_cast<int>(first); y < 2 * static_cast<int>(last); ++y)
                    for (int x = 0; x < 2 * coarse.width; ++x)
                        fine.at(x, y) += T(0.25f) * coarse.at(x / 2, y / 2);
            });
    }
    loss.gradient = std::move(g[0].pixels);
    return loss;
}

} // namespace rye
