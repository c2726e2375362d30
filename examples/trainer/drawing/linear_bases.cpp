// SPDX-License-Identifier: Apache-2.0
#include "drawing/linear_bases.hpp"

#include <algorithm>
#include <cmath>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "drawing/shown.hpp"

namespace rye::trainer {
namespace {

constexpr const char* sides[] = {"left", "right"};
constexpr const char* angle_names[] = {"pitch", "yaw"};

/// One end of a driver's range, and the drivers there.
struct End {
    SplatBasis basis;
    Drivers<float> drivers;
};

/// Adds the ends of a range that count.
template <class Drive>
void add_ends(std::vector<End>& ends, const std::string& driver,
              std::array<double, 3> low_rest_high, double least, Drive&& drive) {
    const auto [low, rest, high] = low_rest_high;
    constexpr double share = 0.1;
    for (const double at : {low, high})
        if (std::abs(at - rest) >= std::max(least, share * (high - low)))
            ends.push_back({{driver, rest, at}, drive(static_cast<float>(at))});
}

std::vector<End> ends_of(const BasesOf& of) {
    std::vector<End> ends;
    const Drivers<float>& rest = of.rest;
    constexpr double least_coefficient = 1e-3, least_angle = 1; // [degrees]
    const auto number = [](float x) { return static_cast<double>(x); };
    for (Index k = 0; k < rest.expression.size(); ++k) {
        const auto s = static_cast<std::size_t>(k);
        const bool named = s < of.names.size() && !of.names[s].empty();
        add_ends(ends, named ? of.names[s] : "expression_" + std::to_string(k),
                 {number(of.ranges.expression_low[k]), number(rest.expression[k]),
                  number(of.ranges.expression_high[k])},
                 least_coefficient, [&](float x) {
                     Drivers<float> d = rest;
                     d.expression[k] = x;
                     return d;
                 });
    }
    for (std::size_t eye = 0; eye < 2; ++eye) {
        const auto e = static_cast<Index>(eye);
        const Vec2<float> from = pitch_yaw(rest.gaze[eye]);
        for (Index k = 0; k < 2; ++k)
            add_ends(ends, std::string("gaze_") + sides[eye] + "_" + angle_names[k],
                     {degrees * number(of.ranges.gaze_low(k, e)), degrees * number(from[k]),
                      degrees * number(of.ranges.gaze_high(k, e))},
                     least_angle, [&](float x) {
                         Vec2<float> to = from;
                         to[k] = x * static_cast<float>(degree);
                         Drivers<float> d = rest;
                         d.gaze[eye] = gaze_vector(to[0], to[1]);
                         return d;
                     });
    }
    return ends;
}

/// Returns the rotations from the eyeballs at rest to those of other drivers, in the world.
std::array<Quat<double>, 2> turns_of(const TrainState& state, const Drivers<float>& rest,
                                     const Drivers<float>& to) {
    const OpticalDrivers<float> a = optical_drivers(state, rest), b = optical_drivers(state, to);
    const Vec3<double> ahead(0, 0, 1);
    const Quat<double> head = so3_exp_quat<double>(rest.pose.head<3>().cast<double>());
    std::array<Quat<double>, 2> turns;
    for (std::size_t e = 0; e < 2; ++e) {
        const auto arc = [&](const OpticalDrivers<float>& o) {
            const Vec3<double> gaze = o.drivers.gaze[e].cast<double>();
            return shortest_arc<double>(ahead, normalized(gaze));
        };
        const Quat<double> in_head = quat_product<double>(arc(b), quat_conjugate<double>(arc(a)));
        turns[e] =
            quat_product<double>(head, quat_product<double>(in_head, quat_conjugate<double>(head)));
    }
    return turns;
}

/// Turns the eyes of driven Gaussians back to rest.
void turn_back(const SplatBases& b, const std::array<Quat<double>, 2>& turns, Gaussians<float>& g) {
    for (std::size_t e = 0; e < 2; ++e) {
        const Quat<double> back = quat_conjugate<double>(turns[e]);
        const Mat3<double> turn = quat_matrix(back);
        const TurningEye& eye = b.eyes[e];
        for (Index i = eye.first; i < eye.first + eye.count; ++i) {
            const Vec3<double> from = g.mean.col(i).cast<double>() - eye.centre;
            g.mean.col(i) = (eye.centre + turn * from).cast<float>();
            g.rotation.col(i) =
                quat_product<double>(back, g.rotation.col(i).cast<double>()).cast<float>();
        }
    }
}

/// Appends the entries of a basis: changes beyond the bounds between two states of the Gaussians.
void add_entries(SplatBases& b, const Gaussians<float>& rest, const Gaussians<float>& to,
                 const BasisBounds& bounds, float radius, std::vector<Vec<float, 13>>& changes) {
    for (Index i = 0; i < rest.count(); ++i) {
        const Quat<float> turn = quat_product<float>(
            quat_normalized<float>(to.rotation.col(i)),
            quat_conjugate<float>(quat_normalized<float>(rest.rotation.col(i))));
        Vec<float, 13> c;
        c.segment<3>(0) = to.mean.col(i) - rest.mean.col(i);
        c.segment<3>(3) = quat_log<float>(turn);
        for (Index k = 0; k < 3; ++k) {
            constexpr float least = 1e-9F; // as an export's
            c[6 + k] =
                std::log(std::max(to.scale(k, i), least) / std::max(rest.scale(k, i), least));
        }
        c.segment<3>(9) = (to.feature.col(i) - rest.feature.col(i)).head<3>();
        c[12] = to.opacity(0, i) - rest.opacity(0, i);
        bool kept = false;
        const auto bound = [&](Index from, Index count, float least) {
            if (c.segment(from, count).norm() < least)
                c.segment(from, count).setZero();
            else
                kept = true;
        };
        bound(0, 3, bounds.centre * radius);
        bound(3, 3, bounds.turn);
        bound(6, 3, bounds.log_scale);
        bound(9, 3, bounds.colour);
        bound(12, 1, bounds.opacity);
        if (!kept) continue;
        b.index.push_back(static_cast<std::uint32_t>(i));
        changes.push_back(c);
    }
    b.begin.push_back(static_cast<std::uint32_t>(b.index.size()));
}

/// Returns the half-width of the box around the Gaussians.
float radius_of(const Gaussians<float>& g) {
    return 0.5F * (g.mean.rowwise().maxCoeff() - g.mean.rowwise().minCoeff()).maxCoeff();
}

/// Gives the bases the axes of a file whose y is down and z forward.
void turn_half(SplatBases& b, std::vector<Vec<float, 13>>& changes) {
    for (Vec<float, 13>& c : changes)
        for (const Index k : {1, 2, 4, 5}) c[k] = -c[k];
    for (TurningEye& eye : b.eyes) eye.centre.tail<2>() *= -1;
    b.head = quat_product<double>(Quat<double>(0, 1, 0, 0), b.head);
}

} // namespace

SplatBases linear_bases(const BasesOf& of) {
    require(!of.state.compared, "rye export", "--bases: got a run whose avatar.gaze_mechanism is '",
            word_of(of.state.config.gaze_mechanism), "', expected 'rotation'");
    TrainState state = drawn_state(of.state);
    state.avatar.eyes.optics = {}; // highlights and refraction are a camera's
    const Gaussians<float> rest = driven_gaussians(state, of.rest);
    const auto& eyes = state.avatar.eyes;
    SplatBases b;
    b.gaussians = rest.count();
    b.head = so3_exp_quat<double>(of.rest.pose.head<3>().cast<double>());
    const auto centres = posed_centres(state, of.rest);
    for (std::size_t e = 0; e < 2; ++e) {
        const auto eye = static_cast<Index>(e);
        const Vec2<float> gaze = pitch_yaw(of.rest.gaze[e]);
        TurningEye& t = b.eyes[e];
        t.first = state.avatar.face.position.cols() + eyes.first_point(eye);
        t.count = eyes.points_of(eye);
        t.centre = centres[e];
        for (std::size_t k = 0; k < 2; ++k) {
            const auto row = static_cast<Index>(k);
            t.gaze[k] = degrees * static_cast<double>(gaze[row]);
            if (eyes.kappa.size() > 0)
                t.kappa[k] = degrees * static_cast<double>(eyes.kappa(row, eye));
        }
    }
    std::vector<Vec<float, 13>> changes;
    for (const End& end : ends_of(of)) {
        Gaussians<float> to = driven_gaussians(state, end.drivers);
        turn_back(b, turns_of(state, of.rest, end.drivers), to);
        b.bases.push_back(end.basis);
        add_entries(b, rest, to, of.bounds, radius_of(rest), changes);
    }
    if (of.half_turn) turn_half(b, changes);
    b.change.resize(basis_numbers, static_cast<Index>(changes.size()));
    for (std::size_t i = 0; i < changes.size(); ++i)
        b.change.col(static_cast<Index>(i)) = changes[i].cast<Eigen::half>();
    return b;
}

} // namespace rye::trainer
