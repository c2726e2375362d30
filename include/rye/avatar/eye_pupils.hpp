// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_pupils.hpp: a frame's pupils, for the effect Pupil (rig/pupil.hpp): where they
/// move the eyes' points, before refraction and before the eye's turn, and what they stretch. The
/// points are not trained, and the gradient of a scale's logarithm does not change by a factor, so
/// that the vjp of the eyes only takes the points as they are moved.
/// Frame: points relative to the eyeball's centre in canonical units, iris toward +z.
#pragma once

#include <array>

#include <rye/avatar/eye_parameters.hpp>
#include <rye/backend/each.hpp>
#include <rye/rig/pupil.hpp>

namespace rye {

/// Returns the iris of an eye (0: the subject's left), from its points.
template <class T, EffectSet E>
Iris<T> iris_of(const EyeStream<T, E>& eyes, Index eye) {
    return iris_of_points<T>(
        eyes.position.middleCols(eyes.first_point(eye), eyes.points_of(eye)));
}

namespace detail {

/// Both eyes' pupils in a frame.
template <class T>
struct FramePupils {
    Columns<T> points; ///< both eyes' points, moved, 3 x P; empty if both pupils are at rest
    std::array<PupilMap<T>, 2> map;
};

/// Sets point i of an eye, moved by its pupil.
template <class T>
struct MoveEyePoint {
    static constexpr const char* name = "pupils";
    const T* position; ///< at rest, 3 x P
    PupilMap<T> map;
    T* moved; ///< 3 x P

    RYE_HD void operator()(Index i) const { put_column<3>(map(column3(position, i)), moved, i); }
};

/// Stretches the scale of Gaussian i of an eye along the surface.
template <class T>
struct StretchEyePoint {
    static constexpr const char* name = "pupils, sizes";
    const T* position; ///< at rest, 3 x P
    PupilMap<T> map;
    T* scale; ///< 3 x P

    RYE_HD void operator()(Index i) const {
        const T by = map.stretch(column3(position, i));
        for (Index k = 0; k < 2; ++k) scale[3 * i + k] *= by;
    }
};

/// Returns the maps of both pupils at these drivers; throws as pupil_map. An eye whose pupil does
/// not move has the zero iris.
template <class T, EffectSet E>
std::array<PupilMap<T>, 2> pupil_maps(const EyeStream<T, E>& eyes, const Drivers<T, E>& drivers) {
    std::array<PupilMap<T>, 2> maps;
    for_eyes([&]<std::size_t eye>() {
        if constexpr (pupil_moves<E, eye>)
            if (const T& ratio = of_eye<eye>(drivers.pupil); !(Real<T> && ratio == T(1)))
                maps[eye] = pupil_map<T>(eye, iris_of(eyes, static_cast<Index>(eye)), ratio);
    });
    return maps;
}

/// Sets the pupils of a frame, a FramePupils<T> of an avatar with the effect. Throws as pupil_map.
template <class T, EffectSet E, Backend B, class Pupils>
void set_pupils([[maybe_unused]] const B& backend, [[maybe_unused]] const EyeStream<T, E>& eyes,
                [[maybe_unused]] const Drivers<T, E>& drivers, [[maybe_unused]] Pupils& pupils) {
    if constexpr (has_effect<E, Pupil>) {
        pupils.map = pupil_maps(eyes, drivers);
        const bool moves = pupils.map[0].iris.limbus > T(0) || pupils.map[1].iris.limbus > T(0);
        pupils.points.resize(3, moves ? eyes.position.cols() : 0);
        for (std::size_t eye = 0; moves && eye < 2; ++eye) {
            const Index e = static_cast<Index>(eye), first = 3 * eyes.first_point(e);
            for_each(backend, eyes.points_of(e),
                     MoveEyePoint<T>{eyes.position.data() + first, pupils.map[eye],
                                     pupils.points.data() + first});
        }
    }
}

/// Returns the eyes' points, as the frame's pupils move them, 3 x P.
template <class T, EffectSet E, class Pupils>
const Columns<T>& moved_points(const EyeStream<T, E>& eyes,
                               [[maybe_unused]] const Pupils& pupils) {
    if constexpr (has_effect<E, Pupil>)
        if (pupils.points.size() > 0) return pupils.points;
    return eyes.position;
}

/// Stretches the scales of an eye's Gaussians, 3 x its points, by the frame's pupil.
template <class T, EffectSet E, Backend B, class Pupils>
void stretch_eye([[maybe_unused]] const B& backend, [[maybe_unused]] const EyeStream<T, E>& eyes,
                 [[maybe_unused]] Index eye, [[maybe_unused]] const Pupils& pupils,
                 [[maybe_unused]] T* scale) {
    if constexpr (has_effect<E, Pupil>)
        if (pupils.points.size() > 0)
            for_each(backend, eyes.points_of(eye),
                     StretchEyePoint<T>{eyes.position.data() + 3 * eyes.first_point(eye),
                                        pupils.map[static_cast<std::size_t>(eye)], scale});
}

} // namespace detail

} // namespace rye
