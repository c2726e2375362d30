// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/head_lids.hpp"

#include <algorithm>
#include <cmath>

#include <rye/core/parallel.hpp>

#include "data/degrees.hpp"
#include "data/threads.hpp"
#include "synthetic_capture/noise.hpp"

namespace rye::trainer {
namespace {

/// Range of the lids' motion above and below their line.
constexpr double reach_up = 54 * degree, reach_down = 44 * degree;
/// Thickness of a lid.
constexpr double lid_thickness = 0.020;
/// Depth of the end of the rim inside the eyeball, which closes the gap.
constexpr double rim_depth = 0.008;
/// Elevation of the fold of the open upper lid above its margin, and its depth.
constexpr double fold_deg = 10, fold_width_deg = 4, fold_depth = 0.016;

/// Grid of the table of the closed skin.
constexpr double first_azimuth = -100 * degree, first_elevation = -66 * degree,
                 spacing = 2 * degree;
constexpr Index azimuths = 106, elevations = 70;

/// Weight of the lids' motion: 0 on the side of the nose, which is behind the inner corner.
double lid_part(const Vec3<double>& left, double distance) {
    return smooth_step(0.11, 0.17, left.x()) * smooth_step(0.31, 0.23, distance);
}

/// Relative height of a lid's margin between the corners, at most 1, its peak at `peak`.
double arch(double along, double peak) {
    if (along <= 0 || along >= 1) return 0;
    const double u = std::pow(along, std::log(0.5) / std::log(peak));
    return std::pow(4 * u * (1 - u), 0.75);
}

} // namespace

LidState lid_state(const LidDrivers& d) {
    LidState s;
    s.upper = 25 + 7 * d.wide - 7 * d.squint + 16 * d.look_up - 23 * d.look_down;
    s.lower = -13 - 4 * d.wide + 7 * d.squint + 4 * d.look_up - 9 * d.look_down;
    constexpr double met = -9;
    s.upper = degree * std::lerp(s.upper, met + 0.4, d.blink);
    s.lower = degree * std::lerp(s.lower, met, d.blink);
    s.upper = std::max(s.upper, s.lower + 0.4 * degree);
    return s;
}

EyeLids::EyeLids(const HeadGrid& grid, int eye, const Eyeball& left_eye, const HeadShape& shape)
    : side_(eye == 0 ? 1 : -1),
      eye_(left_eye),
      corners_(grid.corners) {
    table_.resize(azimuths, elevations);
    for_chunks(program_threads(), elevations, 4, [&](Index begin, Index end, Index) {
        for (Index e = begin; e < end; ++e)
            for (Index a = 0; a < azimuths; ++a) {
                const Vec3<double> d =
                    eye_direction(first_azimuth + spacing * static_cast<double>(a),
                                  first_elevation + spacing * static_cast<double>(e));
                const double r = (head_surface(eye_.centre, d, shape) - eye_.centre).norm();
                // The side of the nose is nearly parallel to these rays: its slope is ignored.
                constexpr double near = 0.19, span = 0.035;
                table_(a, e) = r < near ? r : near + span * (1 - std::exp(-(r - near) / span));
            }
    });
    for (Index i = 0; i < grid.vertices.cols(); ++i) {
        Vec3<double> p = grid.vertices.col(i);
        p.x() *= side_;
        if (p.x() < 0.02) continue;
        const EyeAngles a = eye_angles(p - eye_.centre);
        const double above = a.elevation - corners_.line(a.azimuth);
        const double far = std::hypot((a.azimuth - 8 * degree) / (80 * degree),
                                      above / (above > 0 ? reach_up : reach_down));
        const double part = lid_part(p, a.distance) * smooth_step(1.0, 0.68, far);
        if (part == 0 || a.azimuth < -80 * degree || a.azimuth > 95 * degree || above > reach_up ||
            above < -reach_down)
            continue;
        const bool upper = grid.row_of[static_cast<std::size_t>(i)] <= grid.eyes[0].row;
        skin_.push_back(
            {i, a.azimuth, a.elevation, a.distance - table(a.azimuth, a.elevation), part, upper});
    }
    for (const Index i : grid.eyes[static_cast<std::size_t>(eye)].upper) {
        Vec3<double> p = grid.vertices.col(i);
        p.x() *= side_;
        rim_.push_back(eye_angles(p - eye_.centre).azimuth);
    }
}

double EyeLids::table(double azimuth, double elevation) const {
    const double x = std::clamp((azimuth - first_azimuth) / spacing, 0.0, azimuths - 1.001);
    const double y = std::clamp((elevation - first_elevation) / spacing, 0.0, elevations - 1.001);
    const auto i = static_cast<Index>(x), j = static_cast<Index>(y);
    const double a = x - static_cast<double>(i), b = y - static_cast<double>(j);
    return std::lerp(std::lerp(table_(i, j), table_(i + 1, j), a),
                     std::lerp(table_(i, j + 1), table_(i + 1, j + 1), a), b);
}

double EyeLids::hold(const Vec3<double>& closed) const {
    const Vec3<double> left(side_ * closed.x(), closed.y(), closed.z());
    const EyeAngles a = eye_angles(left - eye_.centre);
    const double x = (a.azimuth - 8 * degree) / (54 * degree);
    const double y = (a.elevation + 3 * degree) / (34 * degree);
    return lid_part(left, a.distance) * (1 - smooth_step(0.8, 1.3, std::hypot(x, y)));
}

Vec3<double> EyeLids::placed(double azimuth, double elevation, double distance) const {
    Vec3<double> p = eye_.centre + distance * eye_direction(azimuth, elevation);
    p.x() *= side_;
    return p;
}

double EyeLids::slide(const LidVertex& v, const LidState& state, double look_out) const {
    const double above = v.elevation - corners_.line(v.azimuth);
    const double t = std::clamp(v.upper ? above / reach_up : -above / reach_down, 0.0, 1.0);
    const double u = corners_.along(v.azimuth);
    // The arch follows the cornea sideways and widens with distance from the margin.
    const double peak = v.upper ? std::clamp(0.46 + 0.35 * look_out, 0.3, 0.65)
                                : std::clamp(0.58 + 0.2 * look_out, 0.4, 0.7);
    const double wide = std::exp(-4 * (u - 0.5) * (u - 0.5));
    const double height = std::lerp(arch(u, peak), wide, smooth_step(0, 0.35, t));
    return v.part * (v.upper ? state.upper : state.lower) * height * std::pow(1 - t, 1.3);
}

void EyeLids::open(Points& vertices, const LidState& state, double look_out,
                   Index first_rim) const {
    for (const LidVertex& v : skin_) {
        const double elevation = v.elevation + slide(v, state, look_out);
        const double closed = table(v.azimuth, elevation) + v.above_table;
        const Vec3<double> there = eye_.centre + closed * eye_direction(v.azimuth, elevation);
        const double held = hold(Vec3<double>(side_ * there.x(), there.y(), there.z()));
        double distance = std::lerp(closed, eye_.radius + lid_thickness, held);
        if (v.upper) {
            const double u = corners_.along(v.azimuth), high = arch(u, 0.48);
            const double margin = corners_.line(v.azimuth) + state.upper * high;
            const double open = smooth_step(-8 * degree, 12 * degree, state.upper);
            const double fold = std::max(margin + fold_deg * degree, 24 * degree * high);
            const double off = (elevation - fold) / (fold_width_deg * degree);
            distance -= v.part * fold_depth * high * (0.35 + 0.65 * open) * std::exp(-off * off);
        }
        const Vec3<double> p = placed(v.azimuth, elevation, distance);
        vertices.col(v.index) = p;
    }
    const Index n = static_cast<Index>(rim_.size());
    for (Index i = 0; i < n; ++i) {
        const double azimuth = rim_[static_cast<std::size_t>(i)], line = corners_.line(azimuth);
        for (const bool upper : {true, false}) {
            const LidVertex margin{0, azimuth, line, 0, 1, upper};
            const Vec3<double> p =
                placed(azimuth, line + slide(margin, state, look_out), eye_.radius - rim_depth);
            vertices.col(first_rim + (upper ? 0 : n) + i) = p;
        }
    }
}

} // namespace rye::trainer
