// SPDX-License-Identifier: Apache-2.0
/// benchmarks/accuracy/policy.hpp: accuracy policies behind one run-time interface. Each is bound
/// to a scene once; its renders reuse memory, as a user's would.
#pragma once

#include <functional>
#include <memory>

#include <rye/splat/lanes.hpp>

#include "scenes.hpp"

namespace rye::bench {

/// A policy bound to a scene.
struct Runner {
    std::function<void()> forward, backward;
    std::function<Columns<double>()> feature;    ///< of the last forward
    std::function<Gaussians<double>()> gradient; ///< of the last backward
    std::function<void(const Gaussians<float>&)> place; ///< sets other Gaussians, as many
    std::function<void(const Columns<float>&)> pull;    ///< sets another cotangent of the feature
};

/// The order of a policy's reference: by depths in float, in double, or by pixel.
enum class Truth { float_depths, double_depths, by_peak };

struct Policy {
    std::string name, group; ///< "preset", or the setting that is changed
    Truth truth;
    std::function<Runner(const Scenery&, const Columns<float>& w, const Columns<float>& w_alpha)>
        bind;
};

template <class B, class T, class A>
Policy policy(const std::string& name, const std::string& group, const A& accuracy) {
    const Truth truth = A::order == BlendOrder::by_peak             ? Truth::by_peak
                        : sizeof(T) == 8 || A::depth_bits == 64 ? Truth::double_depths
                                                                    : Truth::float_depths;
    return {
        name, group, truth,
        [accuracy](const Scenery& s, const Columns<float>& weights, const Columns<float>& w_alpha) {
            struct State {
                Rasterizer<A> rasterizer;
                Gaussians<T> g, gradient;
                Pinhole<T> camera;
                VecX<T> background;
                Columns<T> w, w_alpha;
                Raster<T> raster;
                RasterScratch<T> scratch;
            };
            const auto st = std::make_shared<State>();
            st->rasterizer.accuracy = accuracy;
            convert_fields(st->g, s.gaussians, [](float x) { return static_cast<T>(x); });
            st->camera = s.camera.cast<T>();
            st->background = s.background.cast<T>();
            st->w = weights.cast<T>();
            st->w_alpha = w_alpha.cast<T>();
            return Runner{
                [st] {
                    st->rasterizer.forward_into(B{}, st->g, st->camera, st->background, st->raster,
                                                &st->scratch);
                },
                [st] {
                    st->rasterizer.vjp_into(B{}, st->g, st->camera, st->background, st->raster,
                                            {st->w, &st->w_alpha}, st->gradient, &st->scratch);
                },
                [st] { return Columns<double>(st->raster.feature.pixels.template cast<double>()); },
                [st] {
                    Gaussians<double> d;
                    convert_fields(d, st->gradient, [](T x) { return static_cast<double>(x); });
                    return d;
                },
                [st](const Gaussians<float>& g) {
                    convert_fields(st->g, g, [](float x) { return static_cast<T>(x); });
                },
                [st](const Columns<float>& w) { st->w = w.cast<T>(); }};
        }};
}

using Lanes = XsimdBackend<DefaultArch, Serial>;
using Plain = ScalarBackend<Serial>;

/// Exact32's numbers under another degree of the exponential.
template <int Degree>
struct ExactDegree : Exact32 {
    static constexpr int exp2_degree = Degree;
};

// One file each, since each kind of rule is compiled for every number of channels.
std::vector<Policy> exact_policies();  ///< Exact32 and changes of one field
std::vector<Policy> preset_policies(); ///< Tight, Balanced, Fast
std::vector<Policy> degree_policies(); ///< degrees of the exponential
std::vector<Policy> rule_policies();   ///< other stops and supports
std::vector<Policy> scalar_policies(); ///< double, and plain loops

} // namespace rye::bench
