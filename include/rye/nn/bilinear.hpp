// SPDX-License-Identifier: Apache-2.0
/// rye/nn/bilinear.hpp: bilinear upsampling of an image by 2, and its vjp.
/// Output pixel o of 2 n samples the input at o (n - 1) / (2 n - 1): the centres of corner pixels
/// coincide (align_corners = true in PyTorch), as in Gaussian Head Avatar.
#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include <rye/backend/backend.hpp>
#include <rye/core/columns.hpp>
#include <rye/nn/elementwise.hpp>

namespace rye {

namespace detail {

/// Interpolation weights along one axis.
struct Doubling {
    /// A pixel and its weight.
    struct Tap {
        Index at;
        double weight;
    };
    std::vector<std::array<Tap, 2>> from; ///< per output: the two inputs
    std::vector<std::vector<Tap>> to;     ///< per input: the outputs that sample it

    explicit Doubling(Index n)
        : from(static_cast<std::size_t>(2 * n)),
          to(static_cast<std::size_t>(n)) {
        for (Index o = 0; o < 2 * n; ++o) {
            // (n - 1) o / (2 n - 1) in integers, so that the corners are exact.
            const Index span = std::max<Index>(2 * n - 1, 1);
            const Index low = o * (n - 1) / span, high = std::min(low + 1, n - 1);
            const double t = static_cast<double>(o * (n - 1) % span) / static_cast<double>(span);
            from[static_cast<std::size_t>(o)] = {Tap{low, 1.0 - t}, Tap{high, t}};
            for (const Tap& tap : from[static_cast<std::size_t>(o)])
                to[static_cast<std::size_t>(tap.at)].push_back({o, tap.weight});
        }
    }
};

/// Writes the upsampled f(in); `row(y)` points to row y of the output (2 width pixels).
template <class T, class F, class Row, Backend B>
void double_into(const B& backend, const Image<T>& in, const F& f, const Row& row) {
    const Index w = in.width, c = in.channels();
    const Doubling across(w), down(in.height);
    for_chunks(backend.threads, 2 * in.height, 16, [&](Index b, Index e, Index) {
        Columns<T> line(c, w);
        for (Index y = b; y < e; ++y) {
            const auto [top, bottom] = down.from[static_cast<std::size_t>(y)];
            const T wt(static_cast<real_t<T>>(top.weight)),
                wb(static_cast<real_t<T>>(bottom.weight));
            transform_array<B>(
                w * c, line.data(),
                [&](const auto& p, const auto& q) { return wt * f(p) + wb * f(q); },
                in.pixels.data() + top.at * w * c, in.pixels.data() + bottom.at * w * c);
            Eigen::Map<Columns<T>> out(row(y), c, 2 * w);
            for (Index x = 0; x < 2 * w; ++x) {
                const auto [left, right] = across.from[static_cast<std::size_t>(x)];
                out.col(x) = T(static_cast<real_t<T>>(left.weight)) * line.col(left.at) +
                             T(static_cast<real_t<T>>(right.weight)) * line.col(right.at);
            }
        }
    });
}

} // namespace detail

/// The image at twice the size.
template <class T, Backend B>
Image<T> doubled(const B& backend, const Image<T>& in) {
    Image<T> out(2 * in.width, 2 * in.height, in.channels());
    detail::double_into(
        backend, in, [](const auto& x) { return x; },
        [&](Index y) { return out.pixels.data() + y * out.width * out.pixels.rows(); });
    return out;
}

/// The cotangent of the input, gathered per input row from the output rows that sample it.
template <class T, Backend B>
Image<T> doubled_vjp(const B& backend, const Image<T>& g) {
    Image<T> out(g.width / 2, g.height / 2, g.channels());
    const Index w = out.width, c = g.channels();
    const detail::Doubling across(w), down(out.height);
    for_chunks(backend.threads, out.height, 8, [&](Index b, Index e, Index) {
        Columns<T> line(c, 2 * w);
        for (Index y = b; y < e; ++y) {
            line.setZero();
            for (const auto& [at, weight] : down.to[static_cast<std::size_t>(y)])
                line += T(static_cast<real_t<T>>(weight)) * g.pixels.middleCols(at * 2 * w, 2 * w);
            for (Index x = 0; x < w; ++x)
                for (const auto& [at, weight] : across.to[static_cast<std::size_t>(x)])
                    out.pixels.col(y * w + x) += T(static_cast<real_t<T>>(weight)) * line.col(at);
        }
    });
    return out;
}

} // namespace rye
