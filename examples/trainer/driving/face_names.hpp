// SPDX-License-Identifier: Apache-2.0
/// driving/face_names.hpp: names of coefficients in the spellings of different programs, and turns
/// of a head by angles.
#pragma once

#include <cmath>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <rye/avatar/idle_head.hpp>
#include <rye/math/linalg.hpp>

namespace rye::trainer {

/// Name without its side: of browDown_L and BrowDownLeft "browdown" and 'l'; 0 for no side.
struct SidedName {
    std::string base;
    char side = 0;
    bool operator==(const SidedName&) const = default;
};

inline SidedName sided_name(std::string_view name) {
    const std::string plain = plain_name(name);
    for (const auto& [end, side] : {std::pair<std::string_view, char>{"left", 'l'}, {"right", 'r'}})
        if (plain.size() > end.size() && plain.ends_with(end))
            return {plain.substr(0, plain.size() - end.size()), side};
    if (name.size() > 2) {
        const char mark = name[name.size() - 2], last = name.back();
        const bool marked = mark == '_' || mark == '.' || mark == '-' || mark == ' ';
        if (marked && (last == 'L' || last == 'l')) return {plain.substr(0, plain.size() - 1), 'l'};
        if (marked && (last == 'R' || last == 'r')) return {plain.substr(0, plain.size() - 1), 'r'};
    }
    return {plain, 0};
}

/// Returns the place of a name in a list, in any spelling.
inline std::optional<Index> index_of_name(const std::vector<std::string>& names,
                                          std::string_view name) {
    const SidedName wanted = sided_name(name);
    for (std::size_t i = 0; i < names.size(); ++i)
        if (sided_name(names[i]) == wanted) return static_cast<Index>(i);
    return std::nullopt;
}

/// Returns the turn of a head that looks toward its left by `yaw`, then up by `pitch`, then tilts
/// toward its right ear by `roll` [rad].
inline Mat3<double> head_turn(double yaw, double pitch, double roll) {
    const auto turn = [](int from, int to, double angle) { // of axis `from` toward axis `to`
        Mat3<double> r = Mat3<double>::Identity();
        r(from, from) = r(to, to) = std::cos(angle);
        r(to, from) = std::sin(angle);
        r(from, to) = -std::sin(angle);
        return r;
    };
    return turn(2, 0, yaw) * turn(2, 1, pitch) * turn(1, 0, -roll);
}

} // namespace rye::trainer
