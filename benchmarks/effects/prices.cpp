// SPDX-License-Identifier: Apache-2.0
// Cost of each effect per frame: the time to drive the avatar, with the paper's networks, with
// every effect, over the time without one of them; and the same of its vjp. Both alternate, each as
// often first as second, and are constructed anew in each round, so that neither has the better
// place in memory. Few points and many rounds: short pieces of work are rarely disturbed.
#include <benchmark/benchmark.h>

#include <optional>
#include <string>

#include <rye/avatar/two_stream.hpp>
#include <rye/backend/lanes.hpp>
#include <rye/rig/driven_features.hpp>

#include "turns.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

using B = XsimdBackend<DefaultArch, Serial>;
using All = More<PaperEffects, Kappa>;
using AllOptics = More<All, CornealRefraction, Glint>;
using AllPupils = More<All, Pupil>;
using AllLids = More<All, LidShadow>;
using AllShaded = More<All, HeadShading>;
using AllViewed = More<All, ViewColor>;
using DrivenEyes = EyesBy<DrivenFeatures>;
/// An avatar without networks, which only rotates its eyes and head, with the cornea's optics.
using Turning = Effects<HeadPose, LeftGaze, RightGaze, CornealRefraction, Glint>;
using TurningPupils = Effects<HeadPose, LeftGaze, RightGaze, Pupil>;
using TurningLids = Effects<HeadPose, LeftGaze, RightGaze, LidShadow>;
using TurningShaded = Effects<HeadPose, LeftGaze, RightGaze, HeadShading>;
using TurningViewed = Effects<HeadPose, LeftGaze, RightGaze, ViewColor>;
constexpr Index face_points = 600, eye_points_each = 100;
/// Degree of the colours by the view, 0: none, though the list has them.
int view_degree = 1;
constexpr int rounds = 12, turns_a_round = 4;

Columns<float> noise(Index rows, Index cols, double size, double middle, std::uint64_t stream) {
    Columns<float> a(rows, cols);
    const Random random{9, stream};
    for (Index i = 0; i < a.size(); ++i)
        a(i) = float(middle + size * (2 * random.uniform(static_cast<std::uint64_t>(i)) - 1));
    return a;
}

/// An avatar of one set of effects, and its frame.
template <EffectSet E>
struct Driven {
    AvatarConfig config;
    LandmarkRoles roles;
    TwoStream<float, E> avatar;
    Drivers<float, E> drivers;
    TwoStreamTrace<float, E> trace;
    TwoStream<float, E> gradient;
    Gaussians<float> g;

    Driven() {
        config.expression = 64;
        FaceStream<float, E>& f = avatar.face;
        f.networks = FaceNetworks<float, E>::init(config, Random{1, 0});
        // A third of the face near the landmarks, a twentieth near each eye.
        f.position = noise(3, face_points, 1, 0, 1);
        f.log_scale = noise(3, face_points, 0.3, -4, 2);
        f.rotation = noise(4, face_points, 1, 0, 3);
        f.opacity_logit = noise(1, face_points, 1, 0, 4);
        if constexpr (has_effect<E, FaceDrivers>) {
            f.feature = noise(config.feature, face_points, 1, 0, 5);
            f.landmarks = noise(3, 66, 0.5, 0, 6);
            for (Index k = 0; k < 66; ++k)
                (k < 54 ? roles.expression : roles.eye[k < 60 ? 0 : 1]).push_back(k);
        }
        if constexpr (face_rests<E>) f.rest_color = noise(config.channels, face_points, 1, 0, 7);
        const auto attributes = [&](int frame, const std::vector<int>& hidden) {
            return Mlp<float>::init(mlp_shape(config.feature, frame, hidden, 8), Random{2, 0});
        };
        if constexpr (has_effect<E, Expression>)
            f.exp_attributes = attributes(config.expression, config.networks.exp_attributes);
        if constexpr (has_effect<E, PoseResidual>)
            f.pose_attributes = attributes(config.pose_code(), config.networks.pose_attributes);
        EyeStream<float, E>& e = avatar.eyes;
        constexpr Index n = 2 * eye_points_each;
        e.feature = noise(config.channels, n, 1, 0, 8);
        e.log_scale = noise(3, n, 0.3, -5, 9);
        e.rotation = noise(4, n, 1, 0, 10);
        e.opacity_logit = noise(1, n, 1, 0, 11);
        e.position = noise(3, n, 0.1, 0, 12);
        e.centre = noise(3, 2, 0.3, 0, 13);
        e.spacing = noise(1, n, 0.001, 0.01, 14);
        if constexpr (has_effect<E, EyeOffset>)
            e.offset = EyeOffsetNetwork<float>::init(config, Random{3, 0});
        if constexpr (has_effect<E, Kappa>) e.kappa = noise(2, 2, 0.1, 0, 15);
        if constexpr (EyeAppearanceOf<E>::reads_inputs)
            e.appearance() = init_eye_appearance<EyeAppearanceOf<E>, float>(
                appearance_sizes<E>(config, n), Random{4, 0});
        if constexpr (has_effect<E, HeadShading>)
            avatar.shading = {noise(8, 3, 0.3, 0, 21), noise(3, face_points, 1, 0, 22),
                              noise(3, 2, 1, 0, 23)};
        if constexpr (has_effect<E, SeesCornea>) {
            // Two fifths of the points are an iris behind the cornea, as in eyeball_template.
            const EyeballShape shape{.iris_plane = 0.1};
            const Cornea<float> cornea = cornea_of<float>(shape);
            set_corneas(e.optics, cornea, cornea);
            if constexpr (has_effect<E, CornealRefraction>) set_refraction(e.optics);
            for (Index i = 0; i < n; i += 5)
                for (Index k = 0; k < 2; ++k) {
                    const double r = 0.059 * double(i) / double(n), a = 2.4 * double(i + k);
                    e.position.col(i + k) = Vec3<double>(r * std::cos(a), r * std::sin(a),
                                                         shape.iris(r)).cast<float>();
                }
        }
        if constexpr (has_effect<E, ReadsCamera>) drivers.camera = Vec3<float>(0.5f, 0.3f, 10);
        if constexpr (has_effect<E, ViewColor>)
            if (view_degree > 0) {
                const Index rows = view_color_numbers(view_degree);
                avatar.view_color = {noise(rows, face_points, 0.1, 0, 26),
                                     noise(rows, n, 0.1, 0, 27)};
            }
        if constexpr (has_effect<E, Pupil>) {
            // Two fifths of the points are an iris, the others on the sphere beyond the limbus.
            const EyeballShape shape{.iris_plane = 0.1};
            for (Index i = 0; i < n; ++i) {
                Vec3<float> p = 0.12f * e.position.col(i).normalized();
                if (i % 5 < 2) {
                    const double r = 0.059 * double(i) / double(n), a = 2.4 * double(i);
                    p = Vec3<double>(r * std::cos(a), r * std::sin(a), shape.iris(r)).cast<float>();
                } else if (p.z() > 0 && p.head<2>().norm() < 0.06f) {
                    p.z() = -p.z();
                }
                e.position.col(i) = p;
            }
            drivers.pupil = {1.3f, 0.8f};
        }
        if constexpr (has_effect<E, LidShadow>) {
            e.lid_shadow = noise(3, 2, 0.3, -0.5, 24);
            e.lid_line = noise(3, 32, 0.1, 0, 25);
            for (Index i = 0; i < 32; ++i) e.lid_line(0, i) = float(17 * i);
        }
        if constexpr (has_effect<E, Glint>) {
            e.optics.light_position = noise(3, 2, 2, 6, 18);
            e.optics.light_intensity = noise(3, 2, 0.2, 0.5, 19);
            e.optics.light_width = noise(1, 2, 0, 0.2, 20);
        }
        if constexpr (has_effect<E, ReadsExpression>)
            drivers.expression = noise(config.expression, 1, 1, 0, 16).col(0);
        if constexpr (has_effect<E, ReadsHeadPose>) {
            drivers.pose = noise(6, 1, 0.2, 0, 17).col(0);
            avatar.delta_pose = Columns<float>::Zero(6, 1);
        }
        for_eyes([&]<std::size_t eye>() {
            if constexpr (eye_turns<E, eye>)
                of_eye<eye>(drivers.gaze) = Vec3<float>(0.2f, 0.1f, 0.95f);
        });
        gradient = zeros_like(avatar);
    }
    void forward() { drive(B{}, avatar, {config, roles, drivers}, trace); }
    void backward() {
        g = trace.gaussians;  // any cotangents do; the vjp consumes them
        drive_vjp(B{}, avatar, {config, roles, drivers}, trace, {g, gradient});
    }
    /// Number of trained parameters, without the Gaussians' own.
    Index parameters() const {
        Index n = 0;
        TwoStream<float, E>::fields(
            [&](const std::string& name, const auto& a) {
                if (name.find("_mlp") != std::string::npos || name == "eyes.kappa" ||
                    name == "shading.light" || name.starts_with("eyes.light_") ||
                    name == "eyes.lid_shadow" || name.starts_with("view_color."))
                    n += a.size();
            },
            avatar);
        return n;
    }
};

/// Cost of effects X (one, or a few that go together) of `With`.
template <EffectSet With, Effect... X>
void price(benchmark::State& state) {
    using Without = Less<With, X...>;
    Turns forward, backward;
    double parameters = 0;
    for (auto _ : state)
        for (int r = 0; r < rounds; ++r) {
            std::optional<Driven<With>> with;
            std::optional<Driven<Without>> without;
            if (r % 2 == 0) with.emplace();
            without.emplace();
            if (r % 2 == 1) with.emplace();
            parameters = double(with->parameters() - without->parameters());
            for (int k = -1; k < turns_a_round; ++k) {
                if (k < 0) { // touches the memory
                    with->forward(), with->backward();
                    without->forward(), without->backward();
                    continue;
                }
                forward.time([&] { with->forward(); }, [&] { without->forward(); });
                backward.time([&] { with->backward(); }, [&] { without->backward(); });
            }
        }
    state.counters["forward_ratio"] = forward.ratio();
    state.counters["vjp_ratio"] = backward.ratio();
    state.counters["share_of_forward"] = 1 - 1 / forward.ratio();
    state.counters["parameters"] = parameters;
}

// Two equal pieces of work: the noise of a ratio.
BENCHMARK(price<All>)->Name("price/nothing")->Iterations(1);
BENCHMARK(price<All, Expression>)->Name("price/expression")->Iterations(1);
BENCHMARK(price<All, HeadPose>)->Name("price/head_pose")->Iterations(1);
BENCHMARK(price<All, PoseResidual>)->Name("price/pose_residual")->Iterations(1);
BENCHMARK(price<All, LeftGaze>)->Name("price/left_gaze")->Iterations(1);
BENCHMARK(price<All, RightGaze>)->Name("price/right_gaze")->Iterations(1);
BENCHMARK(price<All, EyeOffset>)->Name("price/eye_offset")->Iterations(1);
BENCHMARK(price<All, Kappa>)->Name("price/kappa")->Iterations(1);
BENCHMARK(price<All, Periocular>)->Name("price/periocular")->Iterations(1);
BENCHMARK(price<All, CornealBulge>)->Name("price/corneal_bulge")->Iterations(1);
BENCHMARK(price<AllOptics, CornealRefraction>)->Name("price/corneal_refraction")->Iterations(1);
BENCHMARK(price<AllOptics, Glint>)->Name("price/glint")->Iterations(1);
BENCHMARK(price<AllPupils, Pupil>)->Name("price/pupil")->Iterations(1);
BENCHMARK(price<AllLids, LidShadow>)->Name("price/lid_shadow")->Iterations(1);
BENCHMARK(price<AllShaded, HeadShading>)->Name("price/head_shading")->Iterations(1);
BENCHMARK(price<More<All, DrivenEyes>, DrivenEyes>)->Name("price/driven_eyes")->Iterations(1);
template <EffectSet With, int degree>
void view_price(benchmark::State& state) {
    view_degree = degree;
    price<With, ViewColor>(state);
}
BENCHMARK(view_price<AllViewed, 0>)->Name("price/view_color_of_degree_0")->Iterations(1);
BENCHMARK(view_price<AllViewed, 1>)->Name("price/view_color_of_degree_1")->Iterations(1);
BENCHMARK(view_price<AllViewed, 3>)->Name("price/view_color_of_degree_3")->Iterations(1);
BENCHMARK(view_price<TurningViewed, 0>)
    ->Name("price/view_color_of_degree_0_of_no_networks")
    ->Iterations(1);
BENCHMARK(view_price<TurningViewed, 1>)
    ->Name("price/view_color_of_degree_1_of_no_networks")
    ->Iterations(1);
BENCHMARK(view_price<TurningViewed, 3>)
    ->Name("price/view_color_of_degree_3_of_no_networks")
    ->Iterations(1);
BENCHMARK(price<TurningShaded, HeadShading>)
    ->Name("price/head_shading_of_no_networks")
    ->Iterations(1);
BENCHMARK(price<Turning>)->Name("price/nothing_of_no_networks")->Iterations(1);
BENCHMARK(price<Turning, CornealRefraction>)
    ->Name("price/corneal_refraction_of_no_networks")
    ->Iterations(1);
BENCHMARK(price<Turning, Glint>)->Name("price/glint_of_no_networks")->Iterations(1);
BENCHMARK(price<TurningPupils, Pupil>)->Name("price/pupil_of_no_networks")->Iterations(1);
BENCHMARK(price<TurningLids, LidShadow>)->Name("price/lid_shadow_of_no_networks")->Iterations(1);
BENCHMARK(price<All, Expression, PoseResidual, EyeOffset, Periocular>)
    ->Name("price/all_networks")
    ->Iterations(1);

} // namespace
