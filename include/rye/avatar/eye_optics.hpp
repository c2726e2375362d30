// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_optics.hpp: what a camera sees of the eyeballs through and on their corneas
/// (rig/cornea.hpp), for the effects CornealRefraction and Glint: their part of a frame and its
/// vjp, by the parameters of avatar/eye_corneas.hpp. It happens in each eyeball's own frame, before
/// its transform: the camera and the lights are taken there.
/// Frames: parameters in the eyeball's, canonical units; lights and camera in the world.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/eye_corneas.hpp>
#include <rye/avatar/eye_refraction.hpp>
#include <rye/avatar/head_pose.hpp>
#include <rye/backend/backend.hpp>

namespace rye {

namespace detail {

/// Intermediate results of the eyes' optics for their vjp; those of lights are empty without any.
template <class T, EffectSet E = PaperEffects>
struct OpticsTrace {
    /// Each eye's points, its own frame, 3 x P, where corneas refract.
    [[no_unique_address]] Slot<E, CornealRefraction, std::array<Columns<T>, 2>> seen;
    [[no_unique_address]] Slot<E, Glint, std::array<std::vector<SeenLight<T>>, 2>, 1> lights;
    std::array<EyeTransform<T>, 2> placed;

    /// Returns an eye's points as they are seen; `points`: as they are.
    const T* seen_points([[maybe_unused]] const EyeOptics<T, E>& optics,
                         [[maybe_unused]] std::size_t eye, const T* points) const {
        if constexpr (has_effect<E, CornealRefraction>)
            if (optics.refracts()) return seen[eye].data();
        return points;
    }
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

/// Returns the refraction of an eye's points, 3 x P, to `seen`.
template <class T, EffectSet E>
    requires has_effect<E, CornealRefraction>
RefractEyePoint<T> refraction_of(const EyeOptics<T, E>& optics,
                                 const std::type_identity_t<ViewedEye<T>>& viewed, T* seen) {
    const Index e = static_cast<Index>(viewed.eye);
    return {viewed.points, optics.cornea.data() + cornea_numbers * e, optics.index.data() + e,
            into_eye(viewed.placed, viewed.camera), seen};
}

/// Sets an eye's points as they are seen through its cornea, 3 x P.
template <class T, EffectSet E, Backend B>
    requires has_effect<E, CornealRefraction>
void see_points(const B& backend, const EyeOptics<T, E>& optics,
                const std::type_identity_t<ViewedEye<T>>& viewed, T* seen) {
    const RefractingCornea<T> refracting{cornea_of(optics.cornea, viewed.eye),
                                         optics.index(0, static_cast<Index>(viewed.eye))};
    const Vec3<T> camera = into_eye(viewed.placed, viewed.camera);
    // By maps: copies of columns cost a few instructions a point more.
    const T* const from = viewed.points;
    const auto point = [](const T* p, Index i) { return Eigen::Map<const Vec3<T>>(p + 3 * i); };
    for_chunks(backend.threads, viewed.count, 256, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i)
            Eigen::Map<Vec3<T>>(seen + 3 * i) = seen_through<T>(refracting, camera, point(from, i));
    });
}

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
    if constexpr (has_effect<E, CornealRefraction>)
        if (optics.refracts()) {
            trace.seen[eye].resize(3, viewed.count);
            seen = trace.seen[eye].data();
            see_points(backend, optics, viewed, trace.seen[eye].data());
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
        const T* const seen = trace.seen_points(optics, eye, viewed.points);
        T* const g_seen = optics.refracts() ? cotangent.seen.data() : nullptr;
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
    if constexpr (has_effect<E, CornealRefraction>)
        if (optics.refracts()) {
            using Sums = RefractEyePointVjp<T>;
            const SumsOf<Sums> sums =
                sum_each(backend, viewed.count,
                         Sums{refraction_of<T>(optics, viewed, nullptr), cotangent.seen.data()});
            for (std::size_t k = 0; k < 3; ++k) g_camera[Index(k)] += sums[Sums::camera_at + k];
            grad.index(0, static_cast<Index>(eye)) += sums[Sums::index_at];
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
        if (optics.refracts())
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
