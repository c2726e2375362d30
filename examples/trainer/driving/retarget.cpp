// SPDX-License-Identifier: Apache-2.0
#include "driving/retarget.hpp"

#include <algorithm>

#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "driving/face_names.hpp"

namespace rye::trainer {
namespace {

constexpr double look_aside = 40 * degree, look_up = 30 * degree; // of a coefficient of 1
constexpr double dm_per_mm = 0.01;                                // heads are about decimetres

/// Returns the place of the coefficient with this name and side.
std::optional<Index> place_of(const std::vector<SidedName>& all, const std::string& base,
                              char side) {
    for (std::size_t i = 0; i < all.size(); ++i)
        if (all[i] == SidedName{base, side}) return static_cast<Index>(i);
    return std::nullopt;
}

} // namespace

Retarget::Retarget(const std::vector<std::string>& tracked, const std::vector<std::string>& avatar,
                   int coefficients) {
    std::vector<SidedName> from;
    for (const std::string& name : tracked) from.push_back(sided_name(name));
    std::vector<bool> used(tracked.size());
    std::string undriven;
    sources_.resize(static_cast<std::size_t>(coefficients));
    for (std::size_t k = 0; k < std::min(avatar.size(), sources_.size()); ++k) {
        const SidedName wanted = sided_name(avatar[k]);
        std::vector<Source>& list = sources_[k];
        const auto add = [&](char side, double weight) {
            const std::optional<Index> i = place_of(from, wanted.base, side);
            if (i) list.push_back({*i, weight});
            return i.has_value();
        };
        if (!add(wanted.side, 1)) {
            if (wanted.side != 0) {
                add(0, 1);
            } else if (place_of(from, wanted.base, 'l') && place_of(from, wanted.base, 'r')) {
                add('l', 0.5);
                add('r', 0.5);
            }
        }
        for (const Source& s : list) used[static_cast<std::size_t>(s.tracked)] = true;
        if (list.empty()) undriven += (undriven.empty() ? "" : ", ") + avatar[k];
    }
    find_looks(tracked);
    for (const auto& eye : looks_)
        for (const std::optional<Index>& look : eye)
            if (look) used[static_cast<std::size_t>(*look)] = true;
    words_ = std::to_string(driven()) + " of " + std::to_string(coefficients) +
             " coefficients are driven by name";
    if (avatar.empty() && coefficients > 0) words_ += ": those of the avatar have no names";
    if (!undriven.empty()) words_ += "; not " + undriven;
    std::string unused;
    for (std::size_t i = 0; i < tracked.size(); ++i)
        if (!used[i] && from[i].base != "neutral")
            unused += (unused.empty() ? "" : ", ") + tracked[i];
    if (!unused.empty() && !avatar.empty()) words_ += "; the avatar has no " + unused;
}

Retarget::Retarget(const std::vector<std::string>& tracked, const ExpressionMix& mix) {
    sources_.resize(static_cast<std::size_t>(mix.weights.rows()));
    mixed_ = true;
    int found = 0;
    for (std::size_t k = 0; k < mix.names.size(); ++k) {
        std::optional<Index> i = index_of_name(tracked, mix.names[k]);
        if (!i && sided_name(mix.names[k]).side != 0)
            i = index_of_name(tracked, sided_name(mix.names[k]).base);
        if (!i) continue;
        ++found;
        for (std::size_t e = 0; e < sources_.size(); ++e)
            sources_[e].push_back({*i, mix.weights(static_cast<Index>(e), static_cast<Index>(k))});
    }
    find_looks(tracked);
    words_ = std::to_string(sources_.size()) + " coefficients without names are driven by what " +
             std::to_string(found) + " of the track's move in the landmarks";
}

void Retarget::find_looks(const std::vector<std::string>& tracked) {
    std::vector<SidedName> from;
    for (const std::string& name : tracked) from.push_back(sided_name(name));
    const std::array<std::array<const char*, 4>, 2> looks{
        {{"eyelookout", "eyelookin", "eyelookup", "eyelookdown"},
         {"eyelookin", "eyelookout", "eyelookup", "eyelookdown"}}};
    for (std::size_t e = 0; e < 2; ++e)
        for (std::size_t k = 0; k < 4; ++k)
            looks_[e][k] = place_of(from, looks[e][k], e == 0 ? 'l' : 'r');
}

int Retarget::driven() const {
    return static_cast<int>(std::count_if(sources_.begin(), sources_.end(),
                                          [](const auto& list) { return !list.empty(); }));
}

Drivers<float> Retarget::apply(const TrackedFace& face, const Drivers<float>& rest) const {
    Drivers<float> d = rest;
    const auto tracked = [&](Index i) {
        return i < face.coefficients.size() ? face.coefficients[i] : 0;
    };
    for (std::size_t k = 0; k < sources_.size(); ++k) {
        if (sources_[k].empty() || face.coefficients.size() == 0) continue;
        double sum = mixed_ ? static_cast<double>(rest.expression[static_cast<Index>(k)]) : 0;
        for (const Source& s : sources_[k]) sum += s.weight * tracked(s.tracked);
        d.expression[static_cast<Index>(k)] = static_cast<float>(sum);
    }
    for (std::size_t e = 0; e < 2; ++e) {
        std::optional<Vec2<double>> gaze = face.gaze[e];
        const auto& look = looks_[e];
        if (!gaze && face.coefficients.size() > 0 && look[0] && look[1] && look[2] && look[3])
            gaze = Vec2<double>(look_up * (tracked(*look[2]) - tracked(*look[3])),
                                look_aside * (tracked(*look[0]) - tracked(*look[1])));
        if (!gaze) continue;
        const Vec2<double> held = gaze->cwiseMax(-gaze_range).cwiseMin(gaze_range);
        d.gaze[e] = gaze_vector(held[0], held[1]).cast<float>();
    }
    const Mat3<double> own = so3_exp(Vec3<double>(rest.pose.head<3>().cast<double>()));
    if (face.turn) d.pose.head<3>() = so3_log(Mat3<double>(own * *face.turn)).cast<float>();
    if (face.place)
        d.pose.tail<3>() +=
            (own * (dm_per_mm * static_cast<double>(rest.scale) * *face.place)).cast<float>();
    return d;
}

} // namespace rye::trainer
