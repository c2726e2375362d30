// SPDX-License-Identifier: Apache-2.0
/// rye/rig/parts.hpp: user-defined parts in place of an avatar's defaults. Parts are entries of the
/// list of effects, so an avatar is one type argument, and a list without parts is the published
/// method:
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

/// Metric of AvatarConfig::metric, selected at run time.
struct ConfiguredMetric {};

/// Default activation, skip and encoding (of points, head pose and gaze) of the networks.
struct PublishedNetworks {
    using Activation = LeakyRelu;
    using Encoding = PositionalEncoding;
    /// Returns the layer that takes the input again, as MlpShape::skip_layer.
    static constexpr int skip_layer(const MlpShape&) { return MlpShape::middle; }
};
/// Activation, encoding and skip of the networks, as PublishedNetworks has them.
template <class N>
concept NetworkPolicy = Activation<typename N::Activation> && Encoding<typename N::Encoding> &&
                        requires(const MlpShape& shape) {
                            { N::skip_layer(shape) } -> std::convertible_to<int>;
                        };

/// Default super-resolution network, as a template over the scalar.
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

/// Part: metric M of the expression's influence.
template <InfluenceMetric M>
struct ExpressionInfluence : detail::PartEntry<detail::ExpressionInfluenceSlot, M> {
    static constexpr std::string_view name = "influence of the expression";
};
/// Part: metric M of the head pose's influence; lambda_pose is 1 minus the influence of the
/// expression's landmarks by M.
template <InfluenceMetric M>
struct PoseInfluence : detail::PartEntry<detail::PoseInfluenceSlot, M> {
    static constexpr std::string_view name = "influence of the head pose";
};
/// Part: metric M of the gaze's influence.
template <InfluenceMetric M>
struct GazeInfluence : detail::PartEntry<detail::GazeInfluenceSlot, M> {
    static constexpr std::string_view name = "influence of the gaze";
};
/// Part: mechanism M that turns the eyes.
template <GazeMechanism M>
struct GazeBy : detail::PartEntry<detail::GazeSlotOfParts, M> {
    static constexpr std::string_view name = "gaze mechanism";
};
/// Part: appearance A that gives the features of the eyes' points.
template <EyeAppearance A>
struct EyesBy : detail::PartEntry<detail::EyesSlot, A> {
    static constexpr std::string_view name = "eye appearance";
};
/// Part: source S of the eyeballs' points.
template <EyeballSource S>
struct EyeballsBy : detail::PartEntry<detail::EyeballsSlot, S> {
    static constexpr std::string_view name = "eyeball template";
};
/// Part: activation and encoding of the networks, from N.
template <NetworkPolicy N>
struct NetworksBy : detail::PartEntry<detail::NetworksSlot, N> {
    static constexpr std::string_view name = "networks";
};
/// Part: policy U of the network that enlarges the image.
template <UpsamplerPolicy U>
struct UpsampledBy : detail::PartEntry<detail::UpsamplerSlot, U> {
    static constexpr std::string_view name = "upsampler";
};

namespace detail {

/// Metric of the expression's influence in an avatar of effects S.
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

} // namespace detail

/// Mechanism that turns the eyes; by default ExplicitRotation.
template <EffectSet S>
using GazeMechanismOf =
    typename detail::PartOf<S, detail::GazeSlotOfParts, ExplicitRotation>::type;
/// Appearance of the eyes' points; by default FreeFeatures.
template <EffectSet S>
using EyeAppearanceOf = typename detail::PartOf<S, detail::EyesSlot, FreeFeatures>::type;

namespace detail {

/// Source of the eyeballs' points.
template <EffectSet S>
using EyeballSourceOf =
    typename detail::PartOf<S, detail::EyeballsSlot, BasicEyeballShape<S>>::type;
/// Policy of the networks.
template <EffectSet S>
using NetworksOf = typename detail::PartOf<S, detail::NetworksSlot, PublishedNetworks>::type;
/// Encoding of positions.
template <EffectSet S>
using EncodingOf = typename NetworksOf<S>::Encoding;
/// Type of the networks.
template <class T, EffectSet S>
using NetworkOf = Mlp<T, typename NetworksOf<S>::Activation>;
/// Type of the upsampler.
template <class T, EffectSet S>
using UpsamplerOf = typename detail::PartOf<S, detail::UpsamplerSlot,
                                            PublishedUpsampler>::type::template Network<T>;

/// True if the avatar has default parts only.
template <EffectSet S>
inline constexpr bool default_parts = false;
template <class... E>
inline constexpr bool default_parts<Effects<E...>> =
    !(requires { typename E::part_of; } || ...);

} // namespace detail

} // namespace rye
