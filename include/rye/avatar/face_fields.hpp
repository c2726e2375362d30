// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/face_fields.hpp: the networks that move and colour the face, as one member for each,
/// whatever is kept of them (parameters, gradients, traces), and the walk over those that are on.
/// Source: paper sections 3.2 and 3.3.
#pragma once

#include <rye/rig/effect_slots.hpp>

namespace rye {

namespace detail {

/// A V for each network that both stages share.
template <class V, EffectSet E = PaperEffects>
struct FaceFields {
    [[no_unique_address]] Slot<E, Expression, V> exp_color;
    [[no_unique_address]] Slot<E, PoseResidual, V> pose_color;
    [[no_unique_address]] Slot<E, Expression, V, 1> exp_deform;
    [[no_unique_address]] Slot<E, PoseResidual, V, 1> pose_deform;
    [[no_unique_address]] SkinSlot<E, V> gaze_deform;   ///< left, right
    [[no_unique_address]] SkinSlot<E, V, 1> gaze_color; ///< left, right
};

/// A V for each network that stage 2 adds.
template <class V, EffectSet E = PaperEffects>
struct AttributeFields {
    [[no_unique_address]] Slot<E, Expression, V, 2> exp_attributes;
    [[no_unique_address]] Slot<E, PoseResidual, V, 2> pose_attributes;
};

} // namespace detail

/// The names of each driver of the face: in FaceFields, in Weights, in FrameCode. The
/// attributes (log-scale, quaternion, logit opacity) are stage 2's; the gaze has none.
struct ExpressionField {
    static constexpr std::size_t driver = 0; ///< place in the order of sums
    static constexpr bool attributes = true;
    static auto& color(auto& fields) { return fields.exp_color; }
    static auto& deform(auto& fields) { return fields.exp_deform; }
    static auto& attribute(auto& fields) { return fields.exp_attributes; }
    static auto& influence(auto& weights) { return weights.exp; }
    static auto& code(auto& code) { return code.expression; }
};
/// The fields that the head pose drives.
struct PoseField {
    static constexpr std::size_t driver = 1; ///< place in the order of sums
    static constexpr bool attributes = true;
    static auto& color(auto& fields) { return fields.pose_color; }
    static auto& deform(auto& fields) { return fields.pose_deform; }
    static auto& attribute(auto& fields) { return fields.pose_attributes; }
    static auto& influence(auto& weights) { return weights.pose; }
    static auto& code(auto& code) { return code.pose; }
};
/// The fields that the gaze of an eye (0: the subject's left) drives.
template <std::size_t eye>
struct GazeField {
    static constexpr std::size_t driver = 2 + eye; ///< place in the order of sums
    static constexpr bool attributes = false;
    static auto& color(auto& fields) { return of_eye<eye>(fields.gaze_color); }
    static auto& deform(auto& fields) { return of_eye<eye>(fields.gaze_deform); }
    static auto& influence(auto& weights) { return of_eye<eye>(weights.gaze); }
    static auto& code(auto& code) { return of_eye<eye>(code.gaze); }
};

/// Number of the drivers of the face: expression, head pose, left gaze, right gaze.
inline constexpr std::size_t face_drivers = 4;

/// Calls f(ExpressionField{}), ... for the drivers that are on, in the order of their sums.
template <EffectSet E, class F>
void for_face_fields(F&& f) {
    if constexpr (has_effect<E, Expression>) f(ExpressionField{});
    if constexpr (has_effect<E, PoseResidual>) f(PoseField{});
    if constexpr (detail::skin_follows<E, 0>) f(GazeField<0>{});
    if constexpr (detail::skin_follows<E, 1>) f(GazeField<1>{});
}
/// For those that have attributes.
template <EffectSet E, class F>
void for_attribute_fields(F&& f) {
    for_face_fields<E>([&](auto field) {
        if constexpr (field.attributes) f(field);
    });
}

/// The weights of expression and head pose are one ramp and its rest: either needs it.
using ReadsFaceRamp = AnyOf<Expression, PoseResidual>;
/// Effects that drive the face.
using FaceDrivers = AnyOf<Expression, PoseResidual, Periocular>;

/// True if a driver of the face was left out, whose last result can be kept (avatar/hold.hpp).
template <EffectSet E>
inline constexpr bool face_rests = !has_effect<E, Expression> || !has_effect<E, PoseResidual> ||
                                   !detail::skin_follows<E, 0> || !detail::skin_follows<E, 1>;

namespace detail {

struct NothingLeftOut {};
/// V where a driver of the face was left out, else absent.
template <EffectSet E, class V, int number = 0>
using RestSlot = std::conditional_t<face_rests<E>, V, Without<NothingLeftOut, number>>;

} // namespace detail

} // namespace rye
