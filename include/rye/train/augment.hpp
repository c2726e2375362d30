// SPDX-License-Identifier: Apache-2.0
/// rye/train/augment.hpp: random scale between the feature render and super-resolution: the map is
/// resized (nearest neighbour) by 0.8 to 1.25 and cut or padded back to its size, as are picture
/// and visibility, so that the upsampler sees many sizes of the same head. Padding is 1.
/// Source: GHA, training of stage 2.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/core/random.hpp>
#include <rye/geometry/camera.hpp>

namespace rye {

/// Source pixel of each pixel, -1 for none. Empty maps change nothing.
struct Augmentation {
    std::vector<Index> small;  ///< of the feature map
    std::vector<Index> full;   ///< of the picture
    bool active() const { return !small.empty(); }
};

namespace detail {

/// Returns the pixel of the source nearest to (x - offset) / scale, which pixel x of `size` shows;
/// -1 for none.
RYE_HD inline Index resized_source(int x, int offset, int resized, int size) {
    const int at = x - offset;
    if (at < 0 || at >= resized) return -1;
    return static_cast<Index>(at) * size / resized;
}

/// Range of pixels that show one pixel of the source.
struct ShownPixels {
    int begin, end;
};
/// Returns the pixels that show pixel `from`: the inverse of resized_source.
RYE_HD inline ShownPixels resized_range(int from, int offset, int resized, int size) {
    const auto first = [&](int k) { // the least `at` with at * size / resized >= k
        return static_cast<int>((static_cast<std::int64_t>(k) * resized + size - 1) / size);
    };
    const int begin = offset + first(from), end = offset + first(from + 1);
    return {begin < 0 ? 0 : begin, end > size ? size : end};
}

/// A picture's size, the size it is resized to, and its shift (dx, dy) [px].
struct Resizing {
    ImageSize size, resized;
    int dx, dy;

    Resizing operator*(int factor) const {
        return {{size.width * factor, size.height * factor},
                {resized.width * factor, resized.height * factor},
                dx * factor,
                dy * factor};
    }
};

inline std::vector<Index> resized_map(const Resizing& r) {
    const auto [width, height] = r.size;
    std::vector<Index> map;
    map.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const Index sx = resized_source(x, r.dx, r.resized.width, width);
            const Index sy = resized_source(y, r.dy, r.resized.height, height);
            map.push_back(sx < 0 || sy < 0 ? -1 : sy * width + sx);
        }
    return map;
}

/// Draws a resizing of a map.
inline Resizing random_resizing(int width, int height, const Random& random) {
    const double scale = 0.8 + 0.45 * random.uniform(0);
    const int w = std::max(1, static_cast<int>(width * scale));
    const int h = std::max(1, static_cast<int>(height * scale));
    // Smaller: placed anywhere inside; larger: any window of it.
    const auto offset = [&](int size, int resized, std::uint64_t index) {
        const Index room = std::abs(size - resized) + 1;
        const int k = static_cast<int>(random.below(index, room));
        return resized <= size ? k : -k;
    };
    const int dx = offset(width, w, 1), dy = offset(height, h, 2);
    return {{width, height}, {w, h}, dx, dy};
}

} // namespace detail

/// Draws the random scale of a feature map of width x height and of a picture `factor` times as
/// large.
inline Augmentation random_scale(int width, int height, int factor, const Random& random) {
    const detail::Resizing resizing = detail::random_resizing(width, height, random);
    return {detail::resized_map(resizing), detail::resized_map(resizing * factor)};
}

namespace detail {

/// Returns the columns of the source that the map names; 1 for none.
template <class T>
Columns<T> gathered(const Columns<T>& source, const std::vector<Index>& map) {
    if (map.empty()) return source;
    Columns<T> out(source.rows(), static_cast<Index>(map.size()));
    for (Index i = 0; i < out.cols(); ++i) {
        const Index from = map[static_cast<std::size_t>(i)];
        if (from < 0) out.col(i).setOnes();
        else out.col(i) = source.col(from);
    }
    return out;
}

/// Accumulates the transpose of gathered into `g_source`.
template <class T>
void gathered_vjp(const Columns<T>& g, const std::vector<Index>& map, Columns<T>& g_source) {
    if (map.empty()) {
        g_source += g;
        return;
    }
    for (Index i = 0; i < g.cols(); ++i) {
        const Index from = map[static_cast<std::size_t>(i)];
        if (from >= 0) g_source.col(from) += g.col(i);
    }
}

} // namespace detail

} // namespace rye
