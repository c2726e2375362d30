// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/silhouette.hpp: the soft silhouette of a mesh: 1 in a covered pixel, elsewhere
///     1 - prod_f (1 - exp(-sharpness d_f^2)),
/// d_f being the distance from the pixel centre to the outline of the projected face f, in units
/// of half the image width. Only uncovered pixels have a gradient.
/// Source: Chen et al., "Learning to Predict 3D Objects with an Interpolation-based Differentiable
/// Renderer", 2019, with the settings of kaolin's dibr_soft_mask.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include <rye/geometry/screen_mesh.hpp>

namespace rye {

/// Softness and reach of a silhouette.
struct SilhouetteSettings {
    double sharpness = 7000;  ///< [1 / (half image width)^2]; .652 at one pixel of 256
    double reach = 0.02;      ///< margin around a face's box [half image widths]
    int max_faces = 30;       ///< largest number per pixel, by lowest index; 0: the hard mask alone
    double pixels(int width) const { return 0.5 * reach * width; }                   ///< [px]
};

/// Faces that contribute to the uncovered pixels of one band of rows.
struct SilhouetteTrace {
    /// Point of the outline nearest to the pixel: a + t (b - a), with vertices a and b. By the
    /// envelope theorem t is constant in the derivative of the squared distance.
    struct Nearest {
        std::int32_t a, b;
        double t;
    };
    std::vector<Index> pixel;      ///< index in the image, each once
    std::vector<Index> begin;      ///< nearest[begin[i]] ... belong to pixel[i]
    std::vector<Nearest> nearest;  ///< ordered by face index
};

namespace detail {

/// Returns the point of the outline of face f nearest to q, all in [px], by value.
template <class T>
SilhouetteTrace::Nearest nearest_on_outline(const ScreenMesh<T>& mesh, const Face& f,
                                            const Vec2<double>& q) {
    SilhouetteTrace::Nearest best{0, 0, 0};
    double least = 0;
    std::array<Vec2<double>, 3> corner;
    for (std::size_t k = 0; k < 3; ++k)
        corner[k] = {static_cast<double>(value_of(mesh.image(0, f[k]))),
                     static_cast<double>(value_of(mesh.image(1, f[k])))};
    for (std::size_t k = 0; k < 3; ++k) {
        const std::size_t l = (k + 1) % 3;
        const Vec2<double> ab = corner[l] - corner[k], aq = q - corner[k];
        const double length2 = ab.squaredNorm();
        const double t = length2 > 0 ? std::clamp(aq.dot(ab) / length2, 0.0, 1.0) : 0.0;
        const double d2 = (aq - t * ab).squaredNorm();
        if (k > 0 && d2 >= least) continue;
        least = d2;
        best = {static_cast<std::int32_t>(f[k]), static_cast<std::int32_t>(f[l]), t};
    }
    return best;
}

/// Returns the offset from the pixel centre to the outline's point [half image widths].
template <class T>
Vec2<widened_t<T>> to_outline(const ScreenMesh<T>& mesh, const SilhouetteTrace::Nearest& n,
                              Index pixel, int width) {
    using W = widened_t<T>;
    const double scale = 2.0 / width;
    const auto along = [&](int d, double q) {
        return W(scale) * (W(1 - n.t) * mesh.image(d, n.a) + W(n.t) * mesh.image(d, n.b) - W(q));
    };
    return {along(0, static_cast<double>(pixel % width) + 0.5),
            along(1, static_cast<double>(pixel / width) + 0.5)};
}

} // namespace detail

/// Finds the contributing faces of one band; `covered` has one entry per pixel of the band. The
/// band's faces are ordered by index.
template <class T>
SilhouetteTrace silhouette_trace(const detail::ScreenFaces<T>& screen, const detail::FaceBand& band,
                                 const std::vector<std::uint8_t>& covered, int width,
                                 const SilhouetteSettings& settings) {
    const int row = band.row, rows = band.rows;
    const auto at = [&](int x, int y) { return static_cast<std::size_t>(y * width + x); };
    // open(x, y) = uncovered pixels above and left of the corner (x, y): most faces lie amid
    // covered pixels and are rejected by four look-ups.
    std::vector<int> open(static_cast<std::size_t>((width + 1) * (rows + 1)), 0);
    const auto open_at = [&](int x, int y) -> int& {
        return open[static_cast<std::size_t>(y * (width + 1) + x)];
    };
    for (int y = 0; y < rows; ++y)
        for (int x = 0, run = 0; x < width; ++x) {
            run += covered[at(x, y)] ? 0 : 1;
            open_at(x + 1, y + 1) = open_at(x + 1, y) + run;
        }
    struct Hit {
        std::int32_t pixel;
        SilhouetteTrace::Nearest nearest;
    };
    std::vector<Hit> hits;
    std::vector<int> count(covered.size(), 0);
    const double reach = settings.pixels(width);
    for (const Index* f = band.first; f != band.last; ++f) {
        const detail::ScreenFace& box = screen.boxes[static_cast<std::size_t>(*f)];
        const detail::PixelRange xs =
            detail::pixel_range(box.left - reach, box.right + reach, width);
        const detail::PixelRange ys =
            detail::pixel_range(box.top - reach - row, box.bottom + reach - row, rows);
        if (xs.first > xs.last || ys.first > ys.last) continue;
        if (open_at(xs.last + 1, ys.last + 1) - open_at(xs.first, ys.last + 1) -
                open_at(xs.last + 1, ys.first) + open_at(xs.first, ys.first) == 0)
            continue;
        for (int y = ys.first; y <= ys.last; ++y)
            for (int x = xs.first; x <= xs.last; ++x) {
                int& n = count[at(x, y)];
                if (covered[at(x, y)] || n == settings.max_faces) continue;
                ++n;
                hits.push_back(
                    {static_cast<std::int32_t>(at(x, y)),
                     detail::nearest_on_outline(screen.mesh,
                                                screen.faces[static_cast<std::size_t>(*f)],
                                                {x + 0.5, y + row + 0.5})});
            }
    }
    SilhouetteTrace out;
    std::vector<Index> next(covered.size(), 0);
    Index total = 0;
    for (std::size_t i = 0; i < count.size(); ++i) {
        next[i] = total;
        if (count[i] == 0) continue;
        out.pixel.push_back(static_cast<Index>(row) * width + static_cast<Index>(i));
        out.begin.push_back(total);
        total += count[i];
    }
    out.begin.push_back(total);
    out.nearest.resize(static_cast<std::size_t>(total));
    for (const Hit& h : hits)
        out.nearest[static_cast<std::size_t>(next[static_cast<std::size_t>(h.pixel)]++)] =
            h.nearest;
    return out;
}

namespace detail {

/// Pixel of a trace, and the image's width.
struct SilhouettePixel {
    const SilhouetteTrace& trace;
    std::size_t index;
    int width;         ///< [px]
    double sharpness;  ///< SilhouetteSettings::sharpness
};

} // namespace detail

/// Returns the soft mask of a pixel: s <- s + p (1 - s) keeps a small union accurate.
template <class T>
detail::widened_t<T> silhouette_value(const ScreenMesh<T>& mesh,
                                      const detail::SilhouettePixel& pixel) {
    using W = detail::widened_t<T>;
    using std::exp;
    const SilhouetteTrace& trace = pixel.trace;
    W s(0);
    for (Index k = trace.begin[pixel.index]; k < trace.begin[pixel.index + 1]; ++k) {
        const Vec2<W> d = detail::to_outline(mesh, trace.nearest[static_cast<std::size_t>(k)],
                                             trace.pixel[pixel.index], pixel.width);
        s += exp(W(-pixel.sharpness) * (d[0] * d[0] + d[1] * d[1])) * (W(1) - s);
    }
    return s;
}

/// Calls add(vertex, gradient of its image point) for a pixel whose soft mask has the gradient g.
/// ds/dp_k is the product of the other (1 - p), accumulated from both ends to avoid a division by
/// 1 - p, which may be 0.
template <class T, class Add>
void silhouette_vjp(const ScreenMesh<T>& mesh, const detail::SilhouettePixel& pixel,
                    const detail::widened_t<T>& g, Add&& add) {
    using W = detail::widened_t<T>;
    using std::exp;
    const SilhouetteTrace& trace = pixel.trace;
    const std::size_t begin = static_cast<std::size_t>(trace.begin[pixel.index]);
    const std::size_t n = static_cast<std::size_t>(trace.begin[pixel.index + 1]) - begin;
    std::vector<Vec2<W>> d(n);
    std::vector<W> p(n), after(n + 1, W(1));
    for (std::size_t k = n; k-- > 0;) {
        d[k] = detail::to_outline(mesh, trace.nearest[begin + k], trace.pixel[pixel.index],
                                  pixel.width);
        p[k] = exp(W(-pixel.sharpness) * (d[k][0] * d[k][0] + d[k][1] * d[k][1]));
        after[k] = after[k + 1] * (W(1) - p[k]);
    }
    W before = W(-2 * pixel.sharpness * 2.0 / pixel.width) * g;                     // [1/px]
    for (std::size_t k = 0; k < n; ++k) {
        const SilhouetteTrace::Nearest& near = trace.nearest[begin + k];
        const W slope = before * after[k + 1] * p[k];
        before = before * (W(1) - p[k]);
        const W a = W(1 - near.t) * slope, b = W(near.t) * slope;
        add(Index{near.a}, Vec2<W>(a * d[k][0], a * d[k][1]));
        add(Index{near.b}, Vec2<W>(b * d[k][0], b * d[k][1]));
    }
}

} // namespace rye
