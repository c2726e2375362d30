// SPDX-License-Identifier: Apache-2.0
/// rye/rig/effects.hpp: the effects that an avatar simulates, as a list of types. An effect not in
/// the list has no storage, argument, work or checkpoint tensor; any use of it is a compile error
/// (rig/effect_slots.hpp).
/// Bounds: an effect may be left out if its input varies by less than `droppable`. All bounds
/// follow from least_move, the largest motion that changes no pixel.
/// Source of the list: docs/effects.md. docs/parts.md shows how to write your own parts.
#pragma once

#include <concepts>
#include <string_view>
#include <type_traits>

#include <rye/core/config.hpp>

namespace rye {

/// Inputs of a frame that an effect depends on.
enum class Reads : unsigned {
    nothing = 0, expression = 1, head_pose = 2, gaze = 4, camera = 8, pupil = 16
};
/// Attributes of a Gaussian or of the image that an effect changes.
enum class Touches : unsigned {
    nothing = 0, position = 1, rotation = 2, scale = 4, opacity = 8, colour = 16, pixel = 32
};

/// A set of flags of an effect.
template <class F>
concept EffectFlags = std::same_as<F, Reads> || std::same_as<F, Touches>;

/// Returns the union of two sets of flags.
template <EffectFlags F>
constexpr F operator|(F a, F b) {
    return static_cast<F>(static_cast<unsigned>(a) | static_cast<unsigned>(b));
}
/// Returns true if two sets of flags intersect.
template <EffectFlags F>
constexpr bool overlap(F a, F b) {
    return (static_cast<unsigned>(a) & static_cast<unsigned>(b)) != 0;
}

/// Largest invisible motion of a Gaussian: 1/20 px for a head (2 units) 1000 px high.
inline constexpr double least_move = 1e-4; ///< [unit]

/// Upper bound, with its unit, on an input's variation over a scene, below which an effect may be
/// left out.
struct EffectBound {
    double most;
    std::string_view of;
};

/// An empty type with a name for messages and checkpoints, the inputs and attributes concerned, its
/// neutral parameters, and the bound below which it may be left out.
template <class X>
concept Effect = std::is_empty_v<X> && std::default_initializable<X> && requires {
    { X::name } -> std::convertible_to<std::string_view>;
    { X::reads } -> std::convertible_to<Reads>;
    { X::touches } -> std::convertible_to<Touches>;
    { X::neutral } -> std::convertible_to<std::string_view>;
    { X::droppable } -> std::convertible_to<EffectBound>;
};

/// Colour, displacement and attributes of the face, driven by the expression code (paper eq. 2-6).
struct Expression {
    static constexpr std::string_view name = "expression";
    static constexpr Reads reads = Reads::expression;
    static constexpr Touches touches = Touches::position | Touches::rotation | Touches::scale |
                                       Touches::opacity | Touches::colour;
    static constexpr std::string_view neutral = "last layers 0";
    static constexpr EffectBound droppable{1e-3, "an expression coefficient"};
};

/// The head's rigid motion and size: one similarity per frame.
struct HeadPose {
    static constexpr std::string_view name = "head pose";
    static constexpr Reads reads = Reads::head_pose;
    static constexpr Touches touches = Touches::position | Touches::rotation | Touches::scale;
    static constexpr std::string_view neutral = "pose 0, scale 1";
    static constexpr EffectBound droppable{least_move, "a pose component [rad, unit]"};
};

/// Colour, displacement and attributes of the face, driven by the head pose code where lambda_exp
/// is below 1.
struct PoseResidual {
    static constexpr std::string_view name = "pose residual";
    static constexpr Reads reads = Reads::head_pose;
    static constexpr Touches touches = Expression::touches;
    static constexpr std::string_view neutral = "last layers 0";
    static constexpr EffectBound droppable{1e-3, "a pose component [rad, unit]"};
};

/// Rotation of the subject's left eyeball to its gaze.
struct LeftGaze {
    static constexpr std::string_view name = "left gaze";
    static constexpr Reads reads = Reads::gaze;
    static constexpr Touches touches = Touches::position | Touches::rotation;
    static constexpr std::string_view neutral = "gaze +z";
    static constexpr EffectBound droppable{least_move / 0.12, "the left gaze [rad]"};
};

/// Rotation of the subject's right eyeball to its gaze.
struct RightGaze {
    static constexpr std::string_view name = "right gaze";
    static constexpr Reads reads = Reads::gaze;
    static constexpr Touches touches = LeftGaze::touches;
    static constexpr std::string_view neutral = "gaze +z";
    static constexpr EffectBound droppable{least_move / 0.12, "the right gaze [rad]"};
};

/// Displacement of both eyeballs, driven by expression and head pose: one network (paper eq. 9-10).
struct EyeOffset {
    static constexpr std::string_view name = "eye offset";
    static constexpr Reads reads = Reads::expression | Reads::head_pose;
    static constexpr Touches touches = Touches::position;
    static constexpr std::string_view neutral = "last layer 0";
    static constexpr EffectBound droppable{least_move, "a displacement of an eye's centre [unit]"};
};

/// Constant angle per eye from its visual axis, the input, to its optical axis, to which the
/// eyeball rotates (rig/gaze.hpp). Not in the paper, whose gazes are optical axes.
struct Kappa {
    static constexpr std::string_view name = "kappa";
    static constexpr Reads reads = Reads::gaze;
    static constexpr Touches touches = LeftGaze::touches;
    static constexpr std::string_view neutral = "both angles 0";
    static constexpr EffectBound droppable{least_move / 0.12, "an angle of kappa [rad]"};
};

/// Displacement and colour of lids and skin around an eye, driven by its gaze (paper 3.3, eq. 11).
struct Periocular {
    static constexpr std::string_view name = "periocular";
    static constexpr Reads reads = Reads::gaze;
    static constexpr Touches touches = Touches::position | Touches::colour;
    static constexpr std::string_view neutral = "last layers 0";
    static constexpr EffectBound droppable{1e-3, "a gaze [rad]"};
};

/// Corneal bulge on the eyeball's front. Part of the asset; no cost per frame.
struct CornealBulge {
    static constexpr std::string_view name = "corneal bulge";
    static constexpr Reads reads = Reads::nothing;
    static constexpr Touches touches = Touches::position;
    static constexpr std::string_view neutral = "the cornea's sphere is the eyeball's";
    static constexpr EffectBound droppable{least_move, "the cornea's height [unit]"};
};

/// Displacement of points behind the cornea onto their refracted rays (rig/cornea.hpp). Not in the
/// paper.
struct CornealRefraction {
    static constexpr std::string_view name = "corneal refraction";
    static constexpr Reads reads = Reads::camera;
    static constexpr Touches touches = Touches::position;
    static constexpr std::string_view neutral = "index 1";
    static constexpr EffectBound droppable{least_move / 0.2, "the refractive index over 1"};
};

/// Reflections of lights on the cornea, added to the eyeball's colours (rig/cornea.hpp). Not in the
/// paper.
struct Glint {
    static constexpr std::string_view name = "glint";
    static constexpr Reads reads = Reads::camera;
    static constexpr Touches touches = Touches::colour;
    static constexpr std::string_view neutral = "intensity 0";
    static constexpr EffectBound droppable{1e-3, "a light's intensity"};
};

/// Radial stretch of the iris of each eye that turns, by its pupil (rig/pupil.hpp). Not in the
/// paper.
struct Pupil {
    static constexpr std::string_view name = "pupil";
    static constexpr Reads reads = Reads::pupil;
    static constexpr Touches touches = Touches::position | Touches::scale;
    static constexpr std::string_view neutral = "ratio 1";
    static constexpr EffectBound droppable{least_move / 0.02, "a pupil's radius over that at rest"};
};

/// Shadow of each upper lid on its eyeball, whose colours darken near the lid's line as the driven
/// face has it (rig/lid_shadow.hpp). Not in the paper.
struct LidShadow {
    static constexpr std::string_view name = "lid shadow";
    static constexpr Reads reads = Reads::nothing;
    static constexpr Touches touches = Touches::colour;
    static constexpr std::string_view neutral = "strength 0";
    static constexpr EffectBound droppable{1e-3, "the share of light that a lid takes away"};
};

/// Change of colours with the head's rotation under fixed lights (avatar/head_shading.hpp). Not in
/// the paper.
struct HeadShading {
    static constexpr std::string_view name = "head shading";
    static constexpr Reads reads = Reads::head_pose;
    static constexpr Touches touches = Touches::colour;
    static constexpr std::string_view neutral = "light 0";
    static constexpr EffectBound droppable{1e-3, "a rotation of the head [rad]"};
};

/// Colours that depend on where a Gaussian is seen from, in the head's frame, by harmonics
/// (avatar/view_color.hpp). Not in the paper.
struct ViewColor {
    static constexpr std::string_view name = "view color";
    static constexpr Reads reads = Reads::camera;
    static constexpr Touches touches = Touches::colour;
    static constexpr std::string_view neutral = "coefficients 0";
    static constexpr EffectBound droppable{1.0 / 255, "a colour's change with the view"};
};

static_assert(Effect<Expression> && Effect<HeadPose> && Effect<PoseResidual> && Effect<LeftGaze> &&
              Effect<RightGaze> && Effect<EyeOffset> && Effect<Kappa> && Effect<Periocular> &&
              Effect<CornealBulge> && Effect<CornealRefraction> && Effect<Glint> && Effect<Pupil> &&
              Effect<LidShadow> && Effect<HeadShading> && Effect<ViewColor> &&
              !Effect<EffectBound>);

/// Any of several effects, for members that several of them need.
template <Effect... X>
struct AnyOf {};

namespace detail {

/// Any effect that reads an input of a frame.
template <Reads what>
struct ReaderOf {};

template <class X>
struct NamedIn {
    template <class... E>
    static constexpr bool among = (std::same_as<X, E> || ...);
};
template <class... X>
struct NamedIn<AnyOf<X...>> {
    template <class... E>
    static constexpr bool among = (NamedIn<X>::template among<E...> || ...);
};
template <Reads what>
struct NamedIn<ReaderOf<what>> {
    template <class... E>
    static constexpr bool among = (overlap(E::reads, what) || ...);
};

template <class X, class... E>
inline constexpr bool named_once = (int(std::same_as<X, E>) + ...) == 1;
template <class X, class... E>
inline constexpr bool has_its_gaze =
    !NamedIn<X>::template among<E...> || NamedIn<AnyOf<LeftGaze, RightGaze>>::template among<E...>;

} // namespace detail

/// No effect stands in the list twice.
template <class... E>
concept EachNamedOnce = (detail::named_once<E, E...> && ...);
/// Periocular requires LeftGaze or RightGaze; so does Kappa.
template <class... E>
concept PeriocularHasAGaze = detail::has_its_gaze<Periocular, E...>;
/// Kappa requires LeftGaze or RightGaze.
template <class... E>
concept KappaHasAGaze = detail::has_its_gaze<Kappa, E...>;

/// Pupil requires LeftGaze or RightGaze.
template <class... E>
concept PupilHasAGaze = detail::has_its_gaze<Pupil, E...>;

/// The list of an avatar's effects.
template <Effect... E>
    requires EachNamedOnce<E...> && PeriocularHasAGaze<E...> && KappaHasAGaze<E...> &&
             PupilHasAGaze<E...>
struct Effects {
    /// True if the list has an effect, an effect of AnyOf, or one of ReaderOf.
    template <class X>
    static constexpr bool has = detail::NamedIn<X>::template among<E...>;

    /// Calls f(effect) for each effect, in the order of the list.
    template <class F>
    static constexpr void for_each(F&& f) {
        (f(E{}), ...);
    }
    static constexpr std::size_t count = sizeof...(E);
};

/// The paper's effects, the default everywhere.
using PaperEffects = Effects<Expression, HeadPose, PoseResidual, LeftGaze, RightGaze, EyeOffset,
                             Periocular, CornealBulge>;

/// True if S is Effects<...>.
template <class S>
inline constexpr bool is_effect_set = false;
template <class... E>
inline constexpr bool is_effect_set<Effects<E...>> = true;
/// A list of effects, Effects<...>.
template <class S>
concept EffectSet = is_effect_set<S>;
static_assert(EffectSet<PaperEffects> && EffectSet<Effects<>> && !EffectSet<Expression>);

/// True if the set S has the effect X.
template <EffectSet S, class X>
inline constexpr bool has_effect = S::template has<X>;

/// True if an eye (0: the subject's left) rotates.
template <EffectSet S, std::size_t eye>
inline constexpr bool eye_turns = has_effect<S, std::conditional_t<eye == 0, LeftGaze, RightGaze>>;

/// True if an eye (0: the subject's left) has a pupil that is driven.
template <EffectSet S, std::size_t eye>
inline constexpr bool pupil_moves = eye_turns<S, eye> && has_effect<S, Pupil>;

namespace detail {

/// True if the skin around an eye (0: the subject's left) follows its gaze.
template <EffectSet S, std::size_t eye>
inline constexpr bool skin_follows = eye_turns<S, eye> && has_effect<S, Periocular>;

template <class... E>
struct List {};

template <class S, class Done>
struct LessOf;
template <class... Done>
struct LessOf<List<>, List<Done...>> {
    template <class... X>
    using type = Effects<Done...>;
};
template <class First, class... E, class... Done>
struct LessOf<List<First, E...>, List<Done...>> {
    template <class... X>
    using type = typename LessOf<
        List<E...>, std::conditional_t<(std::same_as<First, X> || ...), List<Done...>,
                                       List<Done..., First>>>::template type<X...>;
};
template <class S>
struct ListOf;
template <class... E>
struct ListOf<Effects<E...>> {
    using type = List<E...>;
};

template <class S, class... X>
struct MoreOf;
template <class... E, class... X>
struct MoreOf<Effects<E...>, X...> {
    using type = Effects<E..., X...>;
};

} // namespace detail

/// The effects S without X...
template <EffectSet S, Effect... X>
using Less = typename detail::LessOf<typename detail::ListOf<S>::type,
                                     detail::List<>>::template type<X...>;
/// The effects S with X... added.
template <EffectSet S, Effect... X>
using More = typename detail::MoreOf<S, X...>::type;
static_assert(std::same_as<Less<Effects<Expression, HeadPose>, Expression>, Effects<HeadPose>>);

} // namespace rye
