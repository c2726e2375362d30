// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/rest_pose.hpp: what of the face stream no driver changes: influences, the points that
/// each driver moves, and the networks' inputs at those points. Valid while the face's positions,
/// features and landmarks are the ones it was made from; a step of training changes them.
/// Memory: for each driver its points times (position code + feature + 1) numbers.
#pragma once

#include <array>
#include <vector>

#include <rye/avatar/face_stream.hpp>

namespace rye {

/// The constants of an avatar that is driven: influences, and codes and features of the points that
/// each driver moves. A driver that the avatar has not moves no point.
template <class T, EffectSet E = PaperEffects>
struct RestPose {
    /// Points that one driver moves.
    struct Moved {
        std::vector<Index> points;  ///< lambda > 0, ascending
        Columns<T> code;            ///< positional encoding of these
        Columns<T> feature;         ///< tanh(F_0) of these
    };
    Index count = 0;                ///< of all points
    Weights<T, E> weights;
    std::array<Moved, face_drivers> moved; ///< in the order of their sums

    /// The size of all of it, in numbers and in indices.
    std::array<Index, 2> sizes() const {
        std::array<Index, 2> n{0, 0};
        for_face_fields<E>([&](auto by) { n[0] += by.influence(weights).size(); });
        for (const Moved& m : moved) {
            n[0] += m.code.size() + m.feature.size();
            n[1] += static_cast<Index>(m.points.size());
        }
        return n;
    }
};

/// The rest pose of a face, by its landmarks' roles.
template <class T, EffectSet E, Backend B>
RestPose<T, E> rest_pose(const B& backend, const FaceStream<T, E>& face,
                         const AvatarConfig& config, const LandmarkRoles& roles) {
    RestPose<T, E> rest;
    rest.count = face.position.cols();
    if constexpr (has_effect<E, FaceDrivers>) {
        WeightsTrace<T, E> nearest;
        rest.weights =
            face_weights<T>(backend, {config, face.seen(), face.landmarks}, roles, nearest);
        // Of all points, as in face_gaussians: a number's bits may depend on its place in a vector.
        Columns<T> code, feature;
        encode_points<detail::EncodingOf<E>>(backend, face.seen(), config.frequencies, code);
        detail::tanh_into(backend, face.feature, feature);
        for_face_fields<E>([&](auto by) {
            auto& moved = rest.moved[by.driver];
            moved.points = detail::influenced(backend, by.influence(rest.weights));
            detail::pick_into(backend, code, moved.points, moved.code);
            detail::pick_into(backend, feature, moved.points, moved.feature);
        });
    }
    return rest;
}

namespace detail {

/// The union of some drivers' points, and each driver's points in it (as their numbers among its
/// own): what is added up again when these drivers change.
struct Reached {
    std::vector<Index> points;                            ///< ascending
    std::array<std::vector<Index>, face_drivers> listed;
};

} // namespace detail

/// The points that the changed drivers move.
template <class T, EffectSet E>
detail::Reached reached(const RestPose<T, E>& rest, const std::array<bool, face_drivers>& changed) {
    std::vector<bool> in(static_cast<std::size_t>(rest.count), false);
    for (std::size_t d = 0; d < face_drivers; ++d)
        if (changed[d])
            for (const Index i : rest.moved[d].points) in[static_cast<std::size_t>(i)] = true;
    detail::Reached r;
    for (std::size_t i = 0; i < in.size(); ++i)
        if (in[i]) r.points.push_back(static_cast<Index>(i));
    for (std::size_t d = 0; d < face_drivers; ++d) {
        const std::vector<Index>& points = rest.moved[d].points;
        for (std::size_t k = 0; k < points.size(); ++k)
            if (in[static_cast<std::size_t>(points[k])])
                r.listed[d].push_back(static_cast<Index>(k));
    }
    return r;
}

} // namespace rye
