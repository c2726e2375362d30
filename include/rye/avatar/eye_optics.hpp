// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_optics.hpp: what a camera sees of the eyeballs through and on their corneas
/// (rig/cornea.hpp), for the effects CornealRefraction and Glint: parameters, their part of a frame
/// and its vjp. It happens in each eyeball's own frame, before its transform: the camera and the
/// lights are taken there.
/// Frames: parameters in the eyeball's, canonical units; lights and camera in the world.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/eye_lights.hpp>
#include <rye/avatar/head_pose.hpp>
#include <rye/backend/backend.hpp>
#include <rye/rig/eyeball.hpp>

namespace rye {

/// The effects that look at the cornea.
using SeesCornea = AnyOf<CornealRefraction, Glint>;

/// Corneas and lights of both eyes, for the effects that see them; fields of other effects are
/// absent. Without lights, Glint has no tensor and does nothing.
template <class T, EffectSet E = PaperEffects>
struct EyeOptics {
    /// Fixed, an eye a column: centre, radius, axis, rim of rig/cornea.hpp's Cornea, 8 x 2.
    [[no_unique_address]] detail::Slot<E, SeesCornea, Columns<T>> cornea;
    [[no_unique_address]] detail::Slot<E, CornealRefraction, Columns<T>> index; ///< fixed, 1 x 2
    [[no_unique_address]] detail::Slot<E, Glint, Columns<T>> light_position;    ///< world, 3 x L
    /// Colour that a light's highlight adds to the first channels at its middle, 3 x L.
    [[no_unique_address]] detail::Slot<E, Glint, Columns<T>, 1> light_intensity;
    /// Fixed: the deviation of a light's lobe [rad], 1 x L (rig/cornea.hpp). Gaussians that are
    /// farther apart than its image, about half the corneal radius times that, do not show it.
    [[no_unique_address]] detail::Slot<E, Glint, Columns<T>, 2> light_width;

    template <class F, class... P>
    static void fields([[maybe_unused]] F&& f, [[maybe_unused]] P&&... p) {
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
        if constexpr (has_effect<E, CornealRefraction>) f("refractive_index", p.index...);
        if constexpr (has_effect<E, Glint>)
            if (((p.light_width.size() > 0) || ...)) f("light_width", p.light_width...);
    }

    /// Returns the number of lights.
    Index lights() const {
        if constexpr (has_effect<E, Glint>) return light_width.cols();
        return 0;
    }
    /// Returns true if what a camera sees of the eyes depends on where it is.
    bool sees_cornea() const { return has_effect<E, CornealRefraction> || lights() > 0; }
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

/// The corneas of both eyes, and no light yet.
template <Real T, EffectSet E>
    requires has_effect<E, SeesCornea>
void set_corneas(EyeOptics<T, E>& optics, const Cornea<T>& left, const Cornea<T>& right,
                 double index = detail::aqueous_index) {
    optics.cornea.resize(detail::cornea_numbers, 2);
    for (Index k = 0; k < 3; ++k) {
        optics.cornea.row(k) << left.centre[k], right.centre[k];
        optics.cornea.row(4 + k) << left.axis[k], right.axis[k];
    }
    optics.cornea.row(3) << left.radius, right.radius;
    optics.cornea.row(7) << left.rim, right.rim;
    if constexpr (has_effect<E, CornealRefraction>)
        optics.index = Columns<T>::Constant(1, 2, static_cast<T>(index));
    if constexpr (has_effect<E, Glint>) {
        optics.light_position.resize(3, 0);
        optics.light_intensity.resize(detail::light_channels, 0);
        optics.light_width.resize(1, 0);
    }
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
    if constexpr (has_effect<E, Glint>) {
        shape("got positions of lights", optics.light_position, 3, optics.lights(), "");
        shape("got intensities of lights", optics.light_intensity, light_channels,
              optics.lights(), "");
        require(optics.lights() <= most_lights, "eye_optics", "got ", optics.lights(),
                " lights, expected at most ", most_lights);
    }
}

} // namespace detail

/// Returns the views of the lights' arrays.
template <class T, EffectSet E>
    requires has_effect<E, Glint> detail::LightArrays<T> arrays_of(const EyeOptics<T, E>& optics) {
        return {optics.cornea.data(), optics.light_position.data(), optics.light_intensity.data(),
                optics.light_width.data(), optics.lights()};
    }

namespace detail {

/// Intermediate results of the eyes' optics for their vjp; those of lights are empty without any.
template <class T, EffectSet E = PaperEffects>
struct OpticsTrace {
    /// Each eye's points, its own frame, 3 x P.
    [[no_unique_address]] Slot<E, CornealRefraction, std::array<Columns<T>, 2>> seen;
    [[no_unique_address]] Slot<E, Glint, std::array<std::vector<SeenLight<T>>, 2>, 1> lights;
    std::array<EyeTransform<T>, 2> placed;
};

/// Terms that the view of the corneas adds to the cotangents of the eyes' transforms.
template <class T>
struct OpticsCotangent {
    std::array<Mat3<T>, 2> turn{Mat3<T>::Zero(), Mat3<T>::Zero()}; ///< eye to head, as a matrix
    Columns<T> centre = Columns<T>::Zero(3, 2);                    ///< head frame
    HeadTransformGradient<T> head;
};

/// An eye before a camera.
template <class T>
struct ViewedEye {
    std::size_t eye;
    const Vec3<T>& camera; ///< its centre, world
    const EyeTransform<T>& placed;
    const T* points; ///< in the eye's frame, 3 x P
    Index count;     ///< P
};

/// Returns an eye's lights as the camera sees them.
template <class T, EffectSet E>
    requires has_effect<E, Glint>
std::vector<SeenLight<T>> see_lights(const EyeOptics<T, E>& optics,
                                     const std::type_identity_t<ViewedEye<T>>& viewed) {
    std::vector<SeenLight<T>> seen;
    for (Index l = 0; l < optics.lights(); ++l)
        seen.push_back(see_light(arrays_of(optics), static_cast<int>(viewed.eye), l,
                                 viewed.placed, viewed.camera));
    return seen;
}

} // namespace detail

/// Adds an eye's highlights to its columns of `feature`; `seen`: its points as they are seen.
template <class T, EffectSet E, Backend B>
    requires has_effect<E, Glint>
void add_highlights(const B& backend, const EyeOptics<T, E>& optics,
                    const std::type_identity_t<detail::ViewedEye<T>>& viewed,
                    const std::vector<SeenLight<T>>& lights, const T* seen, Index channels,
                    T* feature) {
    const detail::LightArrays<T> arrays = arrays_of(optics);
    const T* const cornea = arrays.cornea + detail::cornea_numbers * static_cast<Index>(viewed.eye);
    if (arrays.count > 0)
        for_each(backend, viewed.count,
                 detail::LightEyePoint<T>{{viewed.points, seen, cornea},
                                          lights.data(),
                                          arrays.intensity,
                                          arrays.count,
                                          channels,
                                          feature});
}

namespace detail {

/// Throws an Error unless the camera, which the corneas reflect or refract for, is somewhere.
template <class T>
void require_camera(const Vec3<T>& camera) {
    using std::isfinite;
    require(isfinite(camera[0]) && isfinite(camera[1]) && isfinite(camera[2]), "eye_optics",
            "got drivers without a camera, expected its centre in the world");
}

/// Computes the points of one eye as they are seen; adds the highlights to its columns of
/// `feature`, the first of which is that of its first point. Returns the points as they are seen.
template <class T, EffectSet E, Backend B>
const T* look_into_eye(const B& backend, const EyeOptics<T, E>& optics,
                       const std::type_identity_t<ViewedEye<T>>& viewed, OpticsTrace<T, E>& trace,
                       [[maybe_unused]] Index channels, [[maybe_unused]] T* feature) {
    const std::size_t eye = viewed.eye;
    trace.placed[eye] = viewed.placed;
    if constexpr (has_effect<E, Glint>) trace.lights[eye].clear();
    if (!optics.sees_cornea()) return viewed.points;
    require_camera(viewed.camera);
    check_optics(optics);
    const T* seen = viewed.points;
    if constexpr (has_effect<E, CornealRefraction>) {
        const RefractingCornea<T> refracting{cornea_of(optics.cornea, eye),
                                             optics.index(0, static_cast<Index>(eye))};
        const Vec3<T> camera = into_eye(viewed.placed, viewed.camera);
        trace.seen[eye].resize(3, viewed.count);
        // By maps: copies of columns cost a few instructions a point more.
        const T* const from = viewed.points;
        T* const to = trace.seen[eye].data();
        const auto point = [](const T* p, Index i) { return Eigen::Map<const Vec3<T>>(p + 3 * i); };
        for_chunks(backend.threads, viewed.count, 256, [&](Index b, Index e, Index) {
            for (Index i = b; i < e; ++i)
                Eigen::Map<Vec3<T>>(to + 3 * i) =
                    seen_through<T>(refracting, camera, point(from, i));
        });
        seen = to;
    }
    if constexpr (has_effect<E, Glint>) {
        trace.lights[eye] = see_lights(optics, viewed);
        add_highlights(backend, optics, viewed, trace.lights[eye], seen, channels, feature);
    }
    return seen;
}

/// Cotangents of an eye's Gaussians: of its points as they are seen, in its frame (3 x P, where
/// refraction reads them), and of its features.
template <class T>
struct SeenCotangent {
    Columns<T>& seen;
    const T* feature;
    Index channels;
};

/// One eye's part of eye_optics_vjp.
template <class T, EffectSet E, Backend B>
IntoEye<T> look_into_eye_vjp(const B& backend, const EyeOptics<T, E>& optics,
                             const std::type_identity_t<ViewedEye<T>>& viewed,
                             const OpticsTrace<T, E>& trace,
                             const std::type_identity_t<SeenCotangent<T>>& cotangent,
                             [[maybe_unused]] EyeOptics<T, E>& grad) {
    const std::size_t eye = viewed.eye;
    Vec3<T> g_camera = Vec3<T>::Zero();
    IntoEye<T> sum;
    if constexpr (has_effect<E, Glint>) {
        const LightArrays<T> arrays = arrays_of(optics);
        const T* seen = viewed.points;
        T* g_seen = nullptr;
        if constexpr (has_effect<E, CornealRefraction>) {
            seen = trace.seen[eye].data();
            g_seen = cotangent.seen.data();
        }
        const T* const own = arrays.cornea + cornea_numbers * static_cast<Index>(eye);
        for (Index l = 0; l < arrays.count; ++l) {
            const SeenLight<T>& light = trace.lights[eye][static_cast<std::size_t>(l)];
            using Sums = LightEyePointVjp<T>;
            const SumsOf<Sums> sums =
                sum_each(backend, viewed.count,
                         Sums{{viewed.points, seen, own}, &light,
                              arrays.intensity + light_channels * l, cotangent.channels,
                              cotangent.feature, g_seen});
            const LightGradient<T> g = light_vjp(light, sums);
            for (int c = 0; c < light_channels; ++c)
                grad.light_intensity(c, l) += sums[std::size_t(Sums::intensity_at + c)];
            g_camera += g.camera;
            grad.light_position.col(l) +=
                sum.add(viewed.placed, optics.light_position.col(l), g.light);
        }
    }
    if constexpr (has_effect<E, CornealRefraction>) {
        const Vec3<T> camera = into_eye(viewed.placed, viewed.camera);
        const RefractingCornea<T> refracting{cornea_of(optics.cornea, eye),
                                             optics.index(0, static_cast<Index>(eye))};
        for (Index i = 0; i < viewed.count; ++i)
            seen_through_vjp<T>(refracting, camera, column3(viewed.points, i),
                                cotangent.seen.col(i), g_camera);
    }
    sum.add(viewed.placed, viewed.camera, g_camera);
    return sum;
}

/// Both eyes before the camera.
template <class T, EffectSet E>
struct ViewedEyes {
    const Vec3<T>& camera;      ///< its centre, world
    const Columns<T>& position; ///< both eyes' points
    Index left;                 ///< how many of them are the left eye's
    const OpticsTrace<T, E>& trace;
};

/// Head-frame cotangents of the eyes' Gaussians: columns of a cloud's from `begin` on.
template <class T>
struct EyesCotangent {
    const Gaussians<T>& gaussians;
    Index begin;
};

/// Destinations of eye_optics_vjp: gradients that it adds to, cotangents that it sets.
template <class T, EffectSet E>
struct OpticsGradients {
    EyeOptics<T, E>& lights;
    OpticsCotangent<T>& eyes;
};

/// Accumulates the lights' gradients, and gives what the camera and the lights, taken into the
/// eyes, add to those of the transforms. `head` is the HeadTransform of an avatar that has one.
template <class T, EffectSet E, Backend B, class... Head>
    requires has_effect<E, SeesCornea>
void eye_optics_vjp(const B& backend, const EyeOptics<T, E>& optics,
                    const std::type_identity_t<ViewedEyes<T, E>>& viewed,
                    const std::type_identity_t<EyesCotangent<T>>& cotangent,
                    const std::type_identity_t<OpticsGradients<T, E>>& gradients,
                    const Head&... head) {
    if (!optics.sees_cornea()) return;
    const OpticsTrace<T, E>& trace = viewed.trace;
    const Gaussians<T>& g = cotangent.gaussians;
    OpticsCotangent<T>& out = gradients.eyes;
    Vec3<T> translation = Vec3<T>::Zero();
    ((translation = head.translation), ...);
    for (std::size_t eye = 0; eye < 2; ++eye) {
        const Index first = eye == 0 ? 0 : viewed.left, at = cotangent.begin + first,
                    n = eye == 0 ? viewed.left : viewed.position.cols() - viewed.left;
        const EyeTransform<T>& placed = trace.placed[eye];
        Columns<T> g_seen;
        if constexpr (has_effect<E, CornealRefraction>)
            g_seen = (placed.head_rotation.transpose() * placed.rotation).transpose() *
                     g.mean.middleCols(at, n); // from the head's frame into the eye's
        const IntoEye<T> into = detail::look_into_eye_vjp<T, E>(
            backend, optics,
            {eye, viewed.camera, placed, viewed.position.data() + 3 * first, n}, trace,
            {g_seen, g.feature.data() + g.feature.rows() * at, g.feature.rows()},
            gradients.lights);
        const PlacedEyeCotangent<T> apart = placed_eye_vjp(into, placed, translation);
        out.turn[eye] = apart.turn;
        out.centre.col(static_cast<Index>(eye)) = apart.centre;
        out.head.rotation += apart.head_rotation;
        out.head.translation += apart.head_translation;
    }
}

} // namespace detail

} // namespace rye
