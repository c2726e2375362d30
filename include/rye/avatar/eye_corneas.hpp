// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_corneas.hpp: the corneas of both eyes, the lights that they mirror and how they
/// refract, for the effects CornealRefraction and Glint: parameters, and their checks.
/// Frames: the eyeball's, canonical units; lights in the world.
#pragma once

#include <cstddef>

#include <rye/avatar/eye_lights.hpp>
#include <rye/core/error.hpp>
#include <rye/rig/effect_slots.hpp>
#include <rye/rig/eyeball.hpp>

namespace rye {

/// The effects that look at the cornea.
using SeesCornea = AnyOf<CornealRefraction, Glint>;

/// Corneas and lights of both eyes, for the effects that see them; fields of other effects are
/// absent. Without lights, Glint has no tensor and does nothing; nor has CornealRefraction without
/// an index.
template <class T, EffectSet E = PaperEffects>
struct EyeOptics {
    /// Fixed, an eye a column: centre, radius, axis, rim of rig/cornea.hpp's Cornea, 8 x 2.
    [[no_unique_address]] detail::Slot<E, SeesCornea, Columns<T>> cornea;
    /// Refractive index behind each cornea, 1 x 2; or empty: nothing is refracted.
    [[no_unique_address]] detail::Slot<E, CornealRefraction, Columns<T>> index;
    [[no_unique_address]] detail::Slot<E, Glint, Columns<T>> light_position; ///< world, 3 x L
    /// Colour that a light's highlight adds to the first channels at its middle, 3 x L.
    [[no_unique_address]] detail::Slot<E, Glint, Columns<T>, 1> light_intensity;
    /// Fixed: the deviation of a light's lobe [rad], 1 x L (rig/cornea.hpp). Gaussians that are
    /// farther apart than its image, about half the corneal radius times that, do not show it.
    [[no_unique_address]] detail::Slot<E, Glint, Columns<T>, 2> light_width;

    template <class F, class... P>
    static void fields([[maybe_unused]] F&& f, [[maybe_unused]] P&&... p) {
        if constexpr (has_effect<E, CornealRefraction>)
            if ((p.refracts() || ...)) f("refractive_index", p.index...);
        if constexpr (has_effect<E, Glint>)
            if (((p.light_width.size() > 0) || ...)) {
                f("light_position", p.light_position...);
                f("light_intensity", p.light_intensity...);
            }
    }
    template <class F, class... P>
    static void buffers([[maybe_unused]] F&& f, [[maybe_unused]] P&&... p) {
        if constexpr (has_effect<E, SeesCornea>)
            if ((p.sees_cornea() || ...)) f("cornea", p.cornea...);
        if constexpr (has_effect<E, Glint>)
            if (((p.light_width.size() > 0) || ...)) f("light_width", p.light_width...);
    }

    /// Returns the number of lights.
    Index lights() const {
        if constexpr (has_effect<E, Glint>) return light_width.cols();
        return 0;
    }
    /// Returns true if what a camera sees of the eyes depends on where it is.
    bool sees_cornea() const { return refracts() || lights() > 0; }
    /// Returns true if the corneas refract.
    bool refracts() const {
        if constexpr (has_effect<E, CornealRefraction>) return index.size() > 0;
        return false;
    }
};

/// The cornea of an eyeball's shape.
template <Real T, EffectSet S>
    requires has_effect<S, CornealBulge>
Cornea<T> cornea_of(const BasicEyeballShape<S>& shape) {
    return {Vec3<T>(T(0), T(0), static_cast<T>(shape.cornea_offset)),
            static_cast<T>(shape.cornea_radius), Vec3<T>(T(0), T(0), T(1)),
            static_cast<T>(shape.limbus_plane())};
}

/// The cornea of an eye (0: the subject's left) of the 8 x 2 parameter.
template <class T>
Cornea<T> cornea_of(const Columns<T>& cornea, std::size_t eye) {
    const Index e = static_cast<Index>(eye);
    require(cornea.rows() == 8 && cornea.cols() == 2, "eye_optics", "got corneas of ",
            cornea.rows(), " x ", cornea.cols(), ", expected 8 x 2: see set_corneas");
    return {cornea.template block<3, 1>(0, e), cornea(3, e), cornea.template block<3, 1>(4, e),
            cornea(7, e)};
}

/// The corneas of both eyes, and no light and no refraction yet.
template <Real T, EffectSet E>
    requires has_effect<E, SeesCornea>
void set_corneas(EyeOptics<T, E>& optics, const Cornea<T>& left, const Cornea<T>& right) {
    optics.cornea.resize(detail::cornea_numbers, 2);
    for (Index k = 0; k < 3; ++k) {
        optics.cornea.row(k) << left.centre[k], right.centre[k];
        optics.cornea.row(4 + k) << left.axis[k], right.axis[k];
    }
    optics.cornea.row(3) << left.radius, right.radius;
    optics.cornea.row(7) << left.rim, right.rim;
    if constexpr (has_effect<E, CornealRefraction>) optics.index.resize(1, 0);
    if constexpr (has_effect<E, Glint>) {
        optics.light_position.resize(3, 0);
        optics.light_intensity.resize(detail::light_channels, 0);
        optics.light_width.resize(1, 0);
    }
}

/// Lets both corneas refract by an index; corneas of 0 where it has none yet.
template <class T, EffectSet E>
    requires has_effect<E, CornealRefraction>
void set_refraction(EyeOptics<T, E>& optics, double index = detail::aqueous_index) {
    if (optics.cornea.size() == 0) optics.cornea.setZero(detail::cornea_numbers, 2);
    optics.index.setConstant(1, 2, T(index));
}

/// Most lights that an avatar may have.
inline constexpr Index most_lights = 16;

/// Gives the avatar so many lights, of position and intensity 0 and width 1; corneas of 0 where it
/// has none yet.
template <class T, EffectSet E>
    requires has_effect<E, Glint>
void resize_lights(EyeOptics<T, E>& optics, Index count) {
    if (optics.cornea.size() == 0) optics.cornea.setZero(detail::cornea_numbers, 2);
    optics.light_position.setZero(3, count);
    optics.light_intensity.setZero(detail::light_channels, count);
    optics.light_width.setOnes(1, count);
}

namespace detail {

/// Turns an eye's cornea, where there is one, with its points.
template <class T, EffectSet E>
    requires has_effect<E, SeesCornea>
void turn_cornea(EyeOptics<T, E>& optics, std::size_t eye, const Mat3<T>& rotation) {
    if (optics.cornea.size() == 0) return;
    const Index e = static_cast<Index>(eye);
    for (const Index row : {Index(0), Index(4)}) {
        const Vec3<T> x = optics.cornea.template block<3, 1>(row, e);
        optics.cornea.template block<3, 1>(row, e) = rotation * x;
    }
}

/// Throws an Error unless corneas and lights have the shapes that belong together.
template <class T, EffectSet E>
    requires has_effect<E, SeesCornea>
void check_optics(const EyeOptics<T, E>& optics) {
    const auto shape = [](const char* name, const Columns<T>& a, Index rows, Index cols,
                          const char* more) {
        require(a.rows() == rows && a.cols() == cols, "eye_optics", name, " of ", a.rows(), " x ",
                a.cols(), ", expected ", rows, " x ", cols, more);
    };
    shape("got corneas", optics.cornea, cornea_numbers, 2, ": see set_corneas");
    if constexpr (has_effect<E, CornealRefraction>)
        if (optics.refracts()) shape("got refractive indices", optics.index, 1, 2, "");
    if constexpr (has_effect<E, Glint>) {
        if (optics.lights() == 0) return;
        shape("got positions of lights", optics.light_position, 3, optics.lights(), "");
        shape("got intensities of lights", optics.light_intensity, light_channels, optics.lights(),
              "");
        require(optics.lights() <= most_lights, "eye_optics", "got ", optics.lights(),
                " lights, expected at most ", most_lights);
    }
}

} // namespace detail

/// Returns the views of the lights' arrays.
template <class T, EffectSet E>
    requires has_effect<E, Glint>
detail::LightArrays<T> arrays_of(const EyeOptics<T, E>& optics) {
    return {optics.cornea.data(), optics.light_position.data(), optics.light_intensity.data(),
            optics.light_width.data(), optics.lights()};
}

} // namespace rye
