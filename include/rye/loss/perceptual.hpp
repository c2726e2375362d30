// SPDX-License-Identifier: Apache-2.0
/// rye/loss/perceptual.hpp: losses on image structure instead of single pixels. The default, which
/// needs no trained weights, is L1 between the finite differences of two image pyramids. It is
/// linear in a - b up to the final |.|, so the pyramid of the difference suffices. LPIPS with a
/// user's weights is in loss/lpips.hpp.
#pragma once

#include <array>
#include <concepts>
#include <string>
#include <vector>

#include <rye/backend/scalar.hpp>
#include <rye/loss/photometric.hpp>
#include <rye/math/scalar.hpp>
#include <rye/nn/elementwise.hpp>

namespace rye {

/// A loss(backend, a, b) that returns its value and its cotangent of a.
template <class L>
concept PerceptualLoss = requires(const L& loss, const ScalarBackend<>& backend,
                                  const Image<float>& a) {
    { loss(backend, a, a) } -> std::same_as<LossGradient<float>>;
};

/// Sum over the levels of a - b of weight (mean |horizontal difference| + mean |vertical
/// difference|). Each level is the 2 x 2 average of the previous one, without an odd last row or
/// column.
struct PyramidGradientLoss {
    /// Weights of level 0 (the image itself), 1 and 2. They are equal: a coarse difference is
    /// larger for the same edge, and a blur changes the fine ones, so neither needs a larger
    /// weight.
    std::array<double, 3> weight{1.0, 1.0, 1.0};

    template <class T, Backend B>
    LossGradient<T> operator()(const B& backend, const Image<T>& a, const Image<T>& b) const;
};
static_assert(PerceptualLoss<PyramidGradientLoss>);

namespace detail {

/// Number of rows per chunk of the pyramid's passes: few, as coarse levels have few.
inline constexpr Index pyramid_rows = 4;

/// Returns an uninitialised image.
template <class T>
Image<T> unwritten(int width, int height, Index channels) {
    Image<T> image;
    image.width = width;
    image.height = height;
    image.pixels.resize(channels, image.size());
    return image;
}

/// Returns a number of the next level of the pyramid; its slope with respect to each argument is
/// 1/4.
template <class T>
RYE_HD T average_of_four(const T& a, const T& b, const T& c, const T& d) {
    return T(0.25f) * (a + b + c + d);
}

/// Differences of a number from its neighbours: those from the next ones are its share of the loss,
/// all of them its slope.
template <class V>
struct DifferenceSum {
    V value = V(0), slope = V(0);

    RYE_HD void next(const V& here, const V& there, const V& share) {
        using std::abs;
        value += share * abs(there - here);
        slope += share * sign_of<V>(here - there);
    }
    RYE_HD void last(const V& here, const V& there, const V& share) {
        slope += share * sign_of<V>(here - there);
    }
};

template <class T, Backend B>
Image<T> halved(const B& backend, const Image<T>& in) {
    Image<T> out = unwritten<T>(in.width / 2, in.height / 2, in.channels());
    const Index c = in.channels(), below = in.width * c;
    for_chunks(backend.threads, out.height, pyramid_rows, [&](Index b, Index e, Index) {
        for (Index y = b; y < e; ++y) {
            const T* p = in.pixels.data() + 2 * y * below;
            T* to = out.pixels.data() + y * out.width * c;
            for (Index x = 0; x < out.width; ++x, p += 2 * c, to += c)
                for (Index i = 0; i < c; ++i)
                    to[i] = average_of_four<T>(p[i], p[c + i], p[below + i], p[below + c + i]);
        }
    });
    return out;
}

/// Returns weight times mean |d(i + 1) - d(i)| along both axes; sets g to its slope.
template <class T, Backend B>
T difference_l1(const B& backend, const Image<T>& d, double weight, Image<T>& g) {
    const Index w = d.width, h = d.height, c = d.channels(), row = w * c;
    // Mean over the existing differences; an axis of one pixel has none.
    const auto share = [&](Index n) {
        return static_cast<real_t<T>>(n > 0 ? weight / static_cast<double>(n) : 0.0);
    };
    const real_t<T> across = share((w - 1) * h * c), down = share(w * (h - 1) * c);
    return sum_chunks(backend.threads, h, pyramid_rows, T(0), [&](Index first, Index last) {
        T total(0);
        VecX<T> values(row);
        for (Index y = first; y < last; ++y) {
            const T* const p = d.pixels.data() + y * row;
            T* const to = g.pixels.data() + y * row;
            // Processes numbers [begin, end) of the row, which have the same neighbours on each
            // side.
            const auto run = [&](Index begin, Index end, bool left, bool right) {
                each_vector<B, T>(begin, end, [&]<class V>(std::type_identity<V>, Index i) {
                    const V here = load_as<V>(p + i), one(across), other(down);
                    DifferenceSum<V> sum;
                    if (right) sum.next(here, load_as<V>(p + i + c), one);
                    if (left) sum.last(here, load_as<V>(p + i - c), one);
                    if (y + 1 < h) sum.next(here, load_as<V>(p + i + row), other);
                    if (y > 0) sum.last(here, load_as<V>(p + i - row), other);
                    store_as(sum.value, values.data() + i);
                    store_as(sum.slope, to + i);
                });
            };
            if (w > 0) run(0, c, false, w > 1);
            if (w > 1) {
                run(c, row - c, true, true);
                run(row - c, row, true, false);
            }
            total += sum_array<T>(values.data(), row);
        }
        return total;
    });
}

} // namespace detail

template <class T, Backend B>
LossGradient<T> PyramidGradientLoss::operator()(const B& backend, const Image<T>& a,
                                                const Image<T>& b) const {
    detail::require_same_shape<T>("PyramidGradientLoss", a.pixels, b.pixels, Columns<T>());
    std::vector<Image<T>> d, g;
    d.push_back(detail::unwritten<T>(a.width, a.height, a.channels()));
    for_chunks(backend.threads, a.pixels.size(), 16384, [&](Index first, Index last, Index) {
        detail::transform_array<B>(
            last - first, d[0].pixels.data() + first,
            [](const auto& x, const auto& y) { return x - y; }, a.pixels.data() + first,
            b.pixels.data() + first);
    });
    LossGradient<T> loss;
    for (std::size_t level = 0; level < weight.size(); ++level) {
        if (level > 0) d.push_back(detail::halved(backend, d.back()));
        g.push_back(detail::unwritten<T>(d.back().width, d.back().height, a.channels()));
        loss.value += detail::difference_l1(backend, d.back(), weight[level], g.back());
    }
    for (std::size_t level = weight.size() - 1; level > 0; --level) {
        const Image<T>& coarse = g[level];
        Image<T>& fine = g[level - 1];
        for_chunks(backend.threads, coarse.height, detail::pyramid_rows,
                   [&](Index first, Index last, Index) {
                       const Index c = a.channels();
                       for (Index y = 2 * first; y < 2 * last; ++y) {
                           const T* from = coarse.pixels.data() + y / 2 * coarse.width * c;
                           T* to = fine.pixels.data() + y * fine.width * c;
                           for (Index x = 0; x < coarse.width; ++x, from += c)
                               for (Index i = 0; i < 2 * c; ++i, ++to)
                                   *to += T(0.25f) * from[i < c ? i : i - c];
                       }
                   });
    }
    loss.gradient = std::move(g[0].pixels);
    return loss;
}

} // namespace rye
