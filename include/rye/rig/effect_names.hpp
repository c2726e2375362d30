// SPDX-License-Identifier: Apache-2.0
/// rye/rig/effect_names.hpp: names of effects and sets of names, for decisions at run time: which
/// effects a scene needs, and which compiled variant has them.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <string>
#include <string_view>

#include <rye/core/config.hpp>
#include <rye/core/error.hpp>

namespace rye {

/// Everything that a render may simulate: the effects, and choices of the renderer.
enum class EffectName : std::uint8_t {
    expression,
    head_pose,
    pose_residual,
    left_gaze,
    right_gaze,
    eye_offset,
    kappa,
    periocular,
    corneal_bulge,
    corneal_refraction,
    glint,
    pupil,
    lid_shadow,
    head_shading,
    view_color,
    eye_appearance,
    sh1, ///< band 1 of the spherical harmonics
    sh2,
    sh3,
    feature_channels, ///< more than three channels
    antialias,
    lens_distortion,
    super_resolution,
    extra_outputs ///< depth, normals, contributors
};

/// Names as in the effect types and the documents, in the order of EffectName.
inline constexpr std::array<std::string_view, 24> effect_names{"expression",
                                                               "head pose",
                                                               "pose residual",
                                                               "left gaze",
                                                               "right gaze",
                                                               "eye offset",
                                                               "kappa",
                                                               "periocular",
                                                               "corneal bulge",
                                                               "corneal refraction",
                                                               "glint",
                                                               "pupil",
                                                               "lid shadow",
                                                               "head shading",
                                                               "view color",
                                                               "eye appearance",
                                                               "sh 1",
                                                               "sh 2",
                                                               "sh 3",
                                                               "feature channels",
                                                               "antialias",
                                                               "lens distortion",
                                                               "super-resolution",
                                                               "extra outputs"};
/// Number of names.
inline constexpr std::size_t effect_count = effect_names.size();

/// Returns the name of an effect, as in the documents.
constexpr std::string_view name_of(EffectName e) {
    return effect_names[static_cast<std::size_t>(e)];
}

/// A set of effects.
struct EffectMask {
    std::uint32_t bits = 0;

    constexpr EffectMask() = default;
    constexpr EffectMask(std::initializer_list<EffectName> effects) {
        for (const EffectName e : effects) add(e);
    }
    constexpr void add(EffectName e) { bits |= 1U << static_cast<unsigned>(e); }
    constexpr bool has(EffectName e) const {
        return (bits >> static_cast<unsigned>(e) & 1U) != 0;
    }
    constexpr bool contains(const EffectMask& o) const { return (o.bits & ~bits) == 0; }
    constexpr int count() const { return std::popcount(bits); }
    constexpr bool operator==(const EffectMask&) const = default;
    constexpr EffectMask without(const EffectMask& o) const {
        EffectMask r;
        r.bits = bits & ~o.bits;
        return r;
    }
    constexpr EffectMask with(const EffectMask& o) const {
        EffectMask r;
        r.bits = bits | o.bits;
        return r;
    }
};

/// Returns the names of a set, as in "expression, head pose", or "none".
inline std::string text_of(const EffectMask& m) {
    std::string s;
    for (std::size_t k = 0; k < effect_count; ++k)
        if (m.has(static_cast<EffectName>(k)))
            s += (s.empty() ? "" : ", ") + std::string(effect_names[k]);
    return s.empty() ? "none" : s;
}

/// Parses a list of names, as in "head pose, left gaze"; accepts - or _ for a space. Throws an
/// Error that begins with `who` for an unknown name.
inline EffectMask effects_of(std::string_view list, const std::string& who) {
    const auto same = [](char a, char b) {
        const auto space = [](char c) { return c == '-' || c == '_' ? ' ' : c; };
        return space(a) == space(b);
    };
    EffectMask m;
    if (list == "none") return m;
    while (true) {
        const std::string_view item = list.substr(0, list.find(','));
        const std::size_t first = std::min(item.find_first_not_of(' '), item.size());
        const std::string_view name = item.substr(first, item.find_last_not_of(' ') + 1 - first);
        std::size_t k = 0;
        while (k < effect_count && !std::equal(name.begin(), name.end(), effect_names[k].begin(),
                                               effect_names[k].end(), same))
            ++k;
        if (k == effect_count) {
            EffectMask all;
            all.bits = (1U << effect_count) - 1;
            throw Error(who + ": got '" + std::string(name) + "', expected names of effects: " +
                        text_of(all));
        }
        m.add(static_cast<EffectName>(k));
        if (item.size() == list.size()) return m;
        list.remove_prefix(item.size() + 1);
    }
}

/// Returns the set of some effect types by their `name`s; an unknown name does not compile.
template <class... E>
consteval EffectMask mask_of() {
    EffectMask m;
    [[maybe_unused]] const auto add = [&](std::string_view name) {
        std::size_t k = 0;
        while (effect_names.at(k) != name) ++k;
        m.add(static_cast<EffectName>(k));
    };
    (add(E::name), ...);
    return m;
}

} // namespace rye
