// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/head_grid.hpp"

#include <algorithm>
#include <cmath>

#include <rye/core/parallel.hpp>

#include "data/degrees.hpp"
#include "data/threads.hpp"
#include "synthetic_capture/noise.hpp"

namespace rye::trainer {
namespace {

/// Origin of the rays; below `lowest` it slides down the neck instead of the rays turning further.
const Vec3<double> middle(0, 0.30, 0.10);
const Vec3<double> down_the_neck(0, -1, -0.16);
constexpr double lowest_deg = -52;
/// Corners of mouth and lids, as longitudes from the middle [deg], and heights of their rows.
constexpr double inner_corner_deg = 12.7, outer_corner_deg = 31.5, mouth_corner_deg = 14.6;
constexpr double eye_row_deg = 2.0, mouth_row_deg = -31.7;
/// Part of the albedo image that the grid fills, from the top.
constexpr double grid_v = 0.9;

/// Appends values from a to b in steps of `step`, without a.
void append(std::vector<double>& list, double a, double b, double step) {
    const int n = std::max(1, static_cast<int>(std::lround(std::abs(b - a) / step)));
    for (int i = 1; i <= n; ++i) list.push_back(a + (b - a) * i / n);
}

struct Layout {
    std::vector<double> latitude_deg;  // of each row, where it does not slide
    std::vector<double> slide;         // down the neck
    std::vector<double> longitude_deg; // of each column, in [-180, 180)
};

Layout layout() {
    Layout l;
    std::vector<double>& rows = l.latitude_deg;
    append(rows, 90, 34, 2.4);
    append(rows, 34, 16, 1.4);
    append(rows, 16, -8, 0.75);
    append(rows, -8, -25, 1.2);
    append(rows, -25, -40, 0.8);
    append(rows, -40, lowest_deg, 1.2);
    l.slide.assign(rows.size(), 0.0);
    append(l.slide, 0, 0.45, 0.045);
    append(l.slide, 0.45, 1.80, 0.06);
    // Rays over the shoulders rise, so that they meet the surface less obliquely.
    for (std::size_t r = rows.size(); r < l.slide.size(); ++r)
        rows.push_back(lowest_deg + 12 * smooth_step(0.7, 1.8, l.slide[r]));

    std::vector<double> half{0.0};
    append(half, 0, 36, 0.85);
    append(half, 36, 72, 1.6);
    append(half, 72, 180, 2.8);
    for (std::size_t i = half.size() - 1; i >= 1; --i) l.longitude_deg.push_back(-half[i]);
    for (std::size_t i = 0; i + 1 < half.size(); ++i) l.longitude_deg.push_back(half[i]);
    return l;
}

Vec3<double> point(double latitude_deg, double slide, double longitude_deg,
                   const HeadShape& shape) {
    const double a = latitude_deg * degree, b = longitude_deg * degree;
    const Vec3<double> direction(std::cos(a) * std::sin(b), std::sin(a), std::cos(a) * std::cos(b));
    return head_surface(middle + slide * down_the_neck, direction, shape);
}

/// The first of the numbers closest to a value.
int nearest(const std::vector<double>& list, double value) {
    const auto closer = [&](double a, double b) {
        return std::abs(a - value) < std::abs(b - value);
    };
    return static_cast<int>(std::min_element(list.begin(), list.end(), closer) - list.begin());
}

/// The latitude near `row_deg` at which `height`, increasing with latitude, changes sign.
template <class F>
double root(double row_deg, const F& height) {
    double low = row_deg - 8, high = row_deg + 8;
    for (int i = 0; i < 30; ++i) {
        const double mid = 0.5 * (low + high);
        (height(mid) < 0 ? low : high) = mid;
    }
    return 0.5 * (low + high);
}

/// Shift of the rows, so that one follows a line between two longitudes.
struct Bend {
    double row_deg = 0, first_deg = 0, last_deg = 0;
    std::vector<double> shift_deg; // at steps of 1 degree from first to last

    double operator()(double latitude_deg, double longitude_deg) const {
        const double x = std::clamp(std::abs(longitude_deg), first_deg, last_deg) - first_deg;
        const auto i = std::min(static_cast<std::size_t>(x), shift_deg.size() - 2);
        const double s = std::lerp(shift_deg[i], shift_deg[i + 1], x - static_cast<double>(i));
        const double beside =
            std::max(first_deg - std::abs(longitude_deg), std::abs(longitude_deg) - last_deg);
        const double reach = std::max(0.0, 1 - std::abs(latitude_deg - row_deg) / 18);
        return s * reach * (1 - smooth_step(0, 14, beside));
    }
};

template <class F>
Bend bend(double row_deg, double first_deg, double last_deg, const F& height) {
    Bend b{row_deg, first_deg, last_deg, {}};
    for (double x = first_deg; x <= last_deg + 1; x += 1)
        b.shift_deg.push_back(root(row_deg, [&](double y) { return height(y, x); }) - row_deg);
    return b;
}

} // namespace

EyeAngles eye_angles(const Vec3<double>& v) {
    const double r = v.norm();
    return {std::atan2(v.x(), v.z()), std::asin(std::clamp(v.y() / r, -1.0, 1.0)), r};
}

Vec3<double> eye_direction(double azimuth, double elevation) {
    return {std::sin(azimuth) * std::cos(elevation), std::sin(elevation),
            std::cos(azimuth) * std::cos(elevation)};
}

double mouth_line(double x) {
    const double t = std::min(std::abs(x) / 0.25, 1.4);
    return -0.318 - 0.016 * t * t + 0.006 * std::exp(-20 * t * t);
}

Vec3<double> head_surface(const Vec3<double>& from, const Vec3<double>& direction,
                          const HeadShape& shape) {
    double t = 0;
    for (int i = 0; i < 200; ++i) {
        const double d = head_distance(from + t * direction, shape);
        t += 0.8 * std::max(-d, -0.02);
        if (std::abs(d) < 1e-7) break;
    }
    return from + t * direction;
}

HeadGrid head_grid(const HeadShape& shape, const Eyeball& eye) {
    const Layout l = layout();
    HeadGrid grid;
    grid.rows = static_cast<int>(l.latitude_deg.size());
    grid.columns = static_cast<int>(l.longitude_deg.size());
    const auto seen = [&](double latitude, double longitude) {
        return eye_angles(point(latitude, 0, longitude, shape) - eye.centre);
    };

    // The line of the closed lids is straight as seen from the eye, at plausible heights; its row
    // is shifted there, and so is that of the mouth.
    const int inner = nearest(l.longitude_deg, inner_corner_deg);
    const int outer = nearest(l.longitude_deg, outer_corner_deg);
    EyeCorners& c = grid.corners;
    c.inner_elevation = -11 * degree;
    c.outer_elevation = -5 * degree;
    c.inner_azimuth = seen(eye_row_deg, l.longitude_deg[static_cast<std::size_t>(inner)]).azimuth;
    c.outer_azimuth = seen(eye_row_deg, l.longitude_deg[static_cast<std::size_t>(outer)]).azimuth;
    const Bend eye_bend = bend(eye_row_deg, 9, 37, [&](double latitude, double longitude) {
        const EyeAngles a = seen(latitude, longitude);
        return a.elevation - c.line(a.azimuth);
    });
    const Bend mouth_bend = bend(mouth_row_deg, 0, 20, [&](double latitude, double longitude) {
        const Vec3<double> p = point(latitude, 0, longitude, shape);
        return p.y() - mouth_line(p.x());
    });

    const Index regular = 1 + static_cast<Index>(grid.rows) * grid.columns;
    grid.vertices.resize(3, regular);
    grid.vertices.col(0) = head_surface(middle, Vec3<double>(0, 1, 0), shape);
    grid.row_of.assign(static_cast<std::size_t>(regular), 0);
    for_chunks(program_threads(), grid.rows, 4, [&](Index begin, Index end, Index) {
        for (Index r = begin; r < end; ++r)
            for (int k = 0; k < grid.columns; ++k) {
                const double latitude = l.latitude_deg[static_cast<std::size_t>(r)];
                const double longitude = l.longitude_deg[static_cast<std::size_t>(k)];
                const double bent =
                    latitude + eye_bend(latitude, longitude) + mouth_bend(latitude, longitude);
                const Index i = grid.at(static_cast<int>(r), k);
                grid.vertices.col(i) =
                    point(bent, l.slide[static_cast<std::size_t>(r)], longitude, shape);
                grid.row_of[static_cast<std::size_t>(i)] = static_cast<int>(r);
            }
    });

    // Slits: duplicated vertices belong to the faces below the row.
    const int zero = nearest(l.longitude_deg, 0.0);
    std::vector<Index> below(static_cast<std::size_t>(regular));
    for (std::size_t i = 0; i < below.size(); ++i) below[i] = static_cast<Index>(i);
    std::vector<Index> doubled;
    const auto cut = [&](Slit& slit, int row, int first, int last) {
        slit.row = row;
        const int step = first < last ? 1 : -1;
        for (int k = first; k != last + step; k += step) {
            const Index i = grid.at(row, k);
            if (k != first && k != last) {
                below[static_cast<std::size_t>(i)] = regular + static_cast<Index>(doubled.size());
                doubled.push_back(i);
                grid.row_of.push_back(row + 1);
            }
            slit.upper.push_back(i);
            slit.lower.push_back(below[static_cast<std::size_t>(i)]);
        }
    };
    const std::vector<double> face_rows(
        l.latitude_deg.begin(),
        std::find(l.latitude_deg.begin(), l.latitude_deg.end(), lowest_deg));
    const int eye_row = nearest(face_rows, eye_row_deg);
    const int corner = nearest(l.longitude_deg, mouth_corner_deg);
    cut(grid.eyes[0], eye_row, inner, outer);
    cut(grid.eyes[1], eye_row, 2 * zero - inner, 2 * zero - outer);
    cut(grid.mouth, nearest(face_rows, mouth_row_deg), 2 * zero - corner, corner);
    const Points whole = grid.vertices;
    grid.vertices.resize(3, regular + static_cast<Index>(doubled.size()));
    grid.vertices.leftCols(regular) = whole;
    for (std::size_t i = 0; i < doubled.size(); ++i)
        grid.vertices.col(regular + static_cast<Index>(i)) = whole.col(doubled[i]);

    // Faces, and texture coordinates, uniform in rows and columns.
    grid.uv.resize(2, 1 + static_cast<Index>(grid.rows) * (grid.columns + 1));
    grid.uv.col(0) << 0.5, 0;
    const auto uv_at = [&](int r, int k) {
        return 1 + static_cast<Index>(r) * (grid.columns + 1) + k;
    };
    for (int r = 0; r < grid.rows; ++r)
        for (int k = 0; k <= grid.columns; ++k)
            grid.uv.col(uv_at(r, k)) << static_cast<double>(k) / grid.columns,
                grid_v * (r + 1) / grid.rows;
    for (int k = 0; k < grid.columns; ++k) {
        grid.faces.push_back({0, grid.at(0, k), grid.at(0, k + 1)});
        grid.face_uv.push_back({0, uv_at(0, k), uv_at(0, k + 1)});
        for (int r = 0; r + 1 < grid.rows; ++r) {
            const auto top = [&](int column) {
                return below[static_cast<std::size_t>(grid.at(r, column))];
            };
            const Index a = top(k), b = grid.at(r + 1, k), d = grid.at(r + 1, k + 1),
                        e = top(k + 1);
            grid.faces.push_back({a, b, d});
            grid.face_uv.push_back({uv_at(r, k), uv_at(r + 1, k), uv_at(r + 1, k + 1)});
            grid.faces.push_back({a, d, e});
            grid.face_uv.push_back({uv_at(r, k), uv_at(r + 1, k + 1), uv_at(r, k + 1)});
        }
    }
    return grid;
}

} // namespace rye::trainer
