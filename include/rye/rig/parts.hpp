// SPDX-License-Identifier: Apache-2.0
/// rye/rig/parts.hpp: user-defined parts in place of an avatar's default ones. Parts are named in
/// the list of effects, so an avatar is one type argument, and a list without parts is the
/// published method:
///     using Mine = More<PaperEffects, ExpressionInfluence<MyMetric>, GazeBy<MyMechanism>>;
///     TwoStream<float, Mine> avatar;
/// | part                                   | concept          | default            |
/// | ExpressionInfluence, GazeInfluence     | InfluenceMetric  | ConfiguredMetric   |
/// | PoseInfluence                          | InfluenceMetric  | the expression's   |
/// | GazeBy                                 | GazeMechanism    | ExplicitRotation   |
/// | EyesBy                                 | EyeAppearance    | FreeFeatures       |
/// | EyeballsBy                             | EyeballSource    | BasicEyeballShape  |
/// | NetworksBy                             | NetworkPolicy    | PublishedNetworks  |
/// | UpsampledBy                            | UpsamplerPolicy  | PublishedUpsampler |
#pragma once

#include <rye/backend/scalar.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/nn/mlp.hpp>
#include <rye/nn/upsampler.hpp>
#include <rye/rig/effects.hpp>
#include <rye/rig/eye_appearance.hpp>
#include <rye/rig/eyeball.hpp>
#include <rye/rig/gaze_mechanism.hpp>
#include <rye/rig/influence.hpp>

namespace rye {

/// The metric of AvatarConfig::metric, selected at run time.
struct ConfiguredMetric {};

/// The networks' activation, skip and encoding of points, head pose and gaze.
struct PublishedNetworks {
    using Activation = LeakyRelu;
    using Encoding = PositionalEncoding;
    /// The layer that takes the input again: MlpShape::skip_layer.
    static constexpr int skip_layer(const MlpShape&) { return MlpShape::middle; }
};
template <class N>
concept NetworkPolicy = Activation<typename N::Activation> && Encoding<typename N::Encoding> &&
                        requires(const MlpShape& shape) {
                            { N::skip_layer(shape) } -> std::convertible_to<int>;
                        };

/// The super-resolution network, as a template over the scalar.
struct PublishedUpsampler {
    template <class T>
    using Network = Upsampler<T>;
};
/// Network<T> has fields(), init(UpsamplerShape, Random) and a Trace; its namespace has
/// upsampler_forward and upsampler_vjp with the signatures of nn/upsampler.hpp.
template <class U>
concept UpsamplerPolicy =
    requires(const typename U::template Network<float>& net,
             typename U::template Network<float>& grad,
             typename U::template Network<float>::Trace& trace, const Image<float>& image,
             const ScalarBackend<>& backend, Columns<float>& g, const Random& random) {
        {
            U::template Network<float>::init(UpsamplerShape{}, random)
        } -> std::same_as<typename U::template Network<float>>;
        { upsampler_forward(backend, net, image, &trace) } -> std::same_as<Image<float>>;
        upsampler_vjp(backend, net, image, trace, g, grad, &g);
    };

namespace detail {

/// Base of a part, which makes it an entry of a list of effects.
template <class Slot, class P>
struct PartEntry {
    using part_of = Slot;
    using part = P;
    static constexpr Reads reads = Reads::nothing;
    static constexpr Touches touches = Touches::nothing;
    static constexpr std::string_view neutral = "the default part";
    static constexpr EffectBound droppable{0, "nothing"};
};

struct ExpressionInfluenceSlot {};
struct PoseInfluenceSlot {};
struct GazeInfluenceSlot {};
struct GazeSlotOfParts {};
struct EyesSlot {};
struct EyeballsSlot {};
struct NetworksSlot {};
struct UpsamplerSlot {};

template <class Slot, class Default, class... E>
struct FindPart {
    using type = Default;
};
template <class Slot, class Default, class First, class... E>
struct FindPart<Slot, Default, First, E...> : FindPart<Slot, Default, E...> {};
template <class Slot, class Default, class First, class... E>
    requires std::same_as<typename First::part_of, Slot>
struct FindPart<Slot, Default, First, E...> {
    using type = typename First::part;
};

template <class S, class Slot, class Default>
struct PartOf;
template <class... E, class Slot, class Default>
struct PartOf<Effects<E...>, Slot, Default> : FindPart<Slot, Default, E...> {};

} // namespace detail

/// The expression's influence is by the metric M.
template <InfluenceMetric M>
struct ExpressionInfluence : detail::PartEntry<detail::ExpressionInfluenceSlot, M> {
    static constexpr std::string_view name = "influence of the expression";
};
/// lambda_pose is 1 minus the influence of the expression's landmarks by this metric.
template <InfluenceMetric M>
struct PoseInfluence : detail::PartEntry<detail::PoseInfluenceSlot, M> {
    static constexpr std::string_view name = "influence of the head pose";
};
/// The gaze's influence is by the metric M.
template <InfluenceMetric M>
struct GazeInfluence : detail::PartEntry<detail::GazeInfluenceSlot, M> {
    static constexpr std::string_view name = "influence of the gaze";
};
/// Eyes are turned by the mechanism M.
template <GazeMechanism M>
struct GazeBy : detail::PartEntry<detail::GazeSlotOfParts, M> {
    static constexpr std::string_view name = "gaze mechanism";
};
/// Features of the eyes' points are those of the appearance A.
template <EyeAppearance A>
struct EyesBy : detail::PartEntry<detail::EyesSlot, A> {
    static constexpr std::string_view name = "eye appearance";
};
/// Points of the eyeballs come from S.
template <EyeballSource S>
struct EyeballsBy : detail::PartEntry<detail::EyeballsSlot, S> {
    static constexpr std::string_view name = "eyeball template";
};
/// Networks have the activation and encoding of N.
template <NetworkPolicy N>
struct NetworksBy : detail::PartEntry<detail::NetworksSlot, N> {
    static constexpr std::string_view name = "networks";
};
/// The image is enlarged by the policy U.
template <UpsamplerPolicy U>
struct UpsampledBy : detail::PartEntry<detail::UpsamplerSlot, U> {
    static constexpr std::string_view name = "upsampler";
};

/// The parts of an avatar of these effects.
template <EffectSet S>
using ExpressionInfluenceOf =
    typename detail::PartOf<S, detail::ExpressionInfluenceSlot, ConfiguredMetric>::type;
/// Metric of the head pose's influence; by default that of the expression's.
template <EffectSet S>
using PoseInfluenceOf =
    typename detail::PartOf<S, detail::PoseInfluenceSlot, ExpressionInfluenceOf<S>>::type;
/// Metric of the gaze's influence.
template <EffectSet S>
using GazeInfluenceOf =
    typename detail::PartOf<S, detail::GazeInfluenceSlot, ConfiguredMetric>::type;
/// What turns the eyes; by default ExplicitRotation.
template <EffectSet S>
using GazeMechanismOf =
    typename detail::PartOf<S, detail::GazeSlotOfParts, ExplicitRotation>::type;
/// Features of the eyes' points; by default FreeFeatures.
template <EffectSet S>
using EyeAppearanceOf = typename detail::PartOf<S, detail::EyesSlot, FreeFeatures>::type;
/// Where the eyeballs' points come from.
template <EffectSet S>
using EyeballSourceOf =
    typename detail::PartOf<S, detail::EyeballsSlot, BasicEyeballShape<S>>::type;
/// Activation and encoding of the networks.
template <EffectSet S>
using NetworksOf = typename detail::PartOf<S, detail::NetworksSlot, PublishedNetworks>::type;
/// Encoding of positions.
template <EffectSet S>
using EncodingOf = typename NetworksOf<S>::Encoding;
/// The type of the networks.
template <class T, EffectSet S>
using NetworkOf = Mlp<T, typename NetworksOf<S>::Activation>;
/// The type of the upsampler.
template <class T, EffectSet S>
using UpsamplerOf = typename detail::PartOf<S, detail::UpsamplerSlot,
                                            PublishedUpsampler>::type::template Network<T>;

/// Whether the avatar has default parts only.
template <EffectSet S>
inline constexpr bool default_parts = false;
template <class... E>
inline constexpr bool default_parts<Effects<E...>> =
    !(requires { typename E::part_of; } || ...);

} // namespace rye
