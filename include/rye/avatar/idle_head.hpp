// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/idle_head.hpp: drivers of a head whose eyes live by themselves (rig/idle_eyes.hpp):
/// gazes, and lids by the avatar's own coefficients, found by their names.
#pragma once

#include <algorithm>
#include <string>
#include <string_view>
#include <vector>

#include <rye/avatar/drivers.hpp>
#include <rye/rig/gaze_at.hpp>
#include <rye/rig/idle_eyes.hpp>

namespace rye {

namespace detail {

/// Turn of the upper lid from open to closed [rad], of which weights of `wide` are made: about 40
/// degrees.
inline constexpr double idle_lid_turn = 0.7;

} // namespace detail

/// Returns the letters and digits of a name, in lower case: how names are compared that programs
/// spell differently.
inline std::string plain_name(std::string_view name) {
    std::string plain;
    for (const char c : name) {
        if (c >= 'A' && c <= 'Z') plain += static_cast<char>(c - 'A' + 'a');
        if ((c >= 'a' && c <= 'z') || (c >= '0' && c <= '9')) plain += c;
    }
    return plain;
}

/// Coefficient of an expression that moves the lids of an eye.
template <class T>
struct LidCoefficient {
    Index index;
    T most; ///< weight at which the lids are closed, or as wide as they go
};

/// Coefficients that close lids, and those that open them wide.
template <class T>
struct LidCoefficients {
    std::vector<LidCoefficient<T>> blink, wide;
};

/// Returns the coefficients that close lids, with `blink` or `eyesClosed` in their names, and those
/// that open them, which begin with `eyeWide`, in any spelling. most: the largest weight that each
/// may have, E; one of 0 is left out. Without names there are none.
template <class T>
LidCoefficients<T> lid_coefficients(const std::vector<std::string>& names, const VecX<T>& most) {
    LidCoefficients<T> lids;
    for (std::size_t k = 0; k < names.size(); ++k) {
        const std::string plain = plain_name(names[k]);
        const bool closes = plain.find("blink") != std::string::npos ||
                            plain.find("eyesclosed") != std::string::npos;
        const auto i = static_cast<Index>(k);
        if ((!closes && !plain.starts_with("eyewide")) || i >= most.size() || !(most[i] > T(0)))
            continue;
        (closes ? lids.blink : lids.wide).push_back({i, most[i]});
    }
    return lids;
}

/// Moves gazes and lids by what a moment adds. A gaze is stopped `range` [rad] from straight ahead,
/// or where it was if that is further; weights of lids are not below what they were.
template <class T>
void add_idle(const IdleMoment& m, const LidCoefficients<T>& lids, double range, Drivers<T>& d) {
    for (Vec3<T>& gaze : d.gaze) {
        if (m.turn[0] == 0 && m.turn[1] == 0) break;
        const Vec3<double> before = gaze.template cast<double>();
        const double most = std::max(range, angle_from_ahead(before));
        const Vec3<double> turned = apply_kappa(before, KappaAngles<double>{m.turn[0], m.turn[1]});
        gaze =
            (angle_from_ahead(turned) > most ? at_range(turned, most) : turned).template cast<T>();
    }
    const double behind = m.lid_behind / detail::idle_lid_turn; // above 0: the lid is still higher
    const auto move = [&](const std::vector<LidCoefficient<T>>& list, double share) {
        const auto s = static_cast<T>(std::clamp(share, 0.0, 1.0));
        for (const LidCoefficient<T>& c : list) {
            T& w = d.expression[c.index];
            w += s * std::max(T(0), c.most - w);
        }
    };
    move(lids.blink, m.closed + std::max(0.0, -behind));
    move(lids.wide, behind);
}

} // namespace rye
