// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/hold.hpp>

#include <algorithm>
#include <filesystem>
#include <vector>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/train/checkpoint.hpp>

#include "../support/effect_sets.hpp"
#include "../support/avatar_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using B = ScalarBackend<>;

template <EffectSet E>
std::vector<std::string> tensors() {
    std::vector<std::string> names;
    const auto note = [&](const std::string& name, const auto&) { names.push_back(name); };
    const TwoStream<double, E> avatar = restricted<E>(avatar_of_all());
    TwoStream<double, E>::fields(note, avatar);
    TwoStream<double, E>::buffers(note, avatar);
    return names;
}

/// Whether a tensor of an avatar of these effects has this word in its name.
template <EffectSet E>
bool names(const std::string& word) {
    const std::vector<std::string> all = tensors<E>();
    return std::any_of(all.begin(), all.end(), [&](const std::string& n) {
        return n.find(word) != std::string::npos;
    });
}

} // namespace

TEST_CASE("an avatar's vjp is the transpose of its duals, whatever its effects") {
    CHECK(law_error<AllEffects>(1) <= 1e-12);
    CHECK(law_error<Less<AllEffects, Expression>>(2) <= 1e-12);
    CHECK(law_error<Less<AllEffects, HeadPose, LeftGaze>>(3) <= 1e-12);
    CHECK(law_error<Effects<RightGaze, Kappa, Periocular>>(4) <= 1e-12);
    CHECK(law_error<Effects<PoseResidual>>(5) <= 1e-12);
    CHECK(law_error<Effects<>>(6) <= 1e-12);
}

TEST_CASE("kappa learns from the eyeball alone, too") {
    CHECK(law_error<Effects<LeftGaze, RightGaze, Kappa, HeadPose>>(7) <= 1e-12);
}

TEST_CASE("an effect that is off has no tensor in a checkpoint") {
    CHECK(tensors<PaperEffects>().size() < tensors<AllEffects>().size());
    CHECK(names<AllEffects>("exp_"));
    CHECK_FALSE(names<Less<AllEffects, Expression>>("exp_"));
    CHECK(names<AllEffects>("pose_color_mlp"));
    CHECK_FALSE(names<Less<AllEffects, PoseResidual>>("pose_color_mlp"));
    CHECK_FALSE(names<Less<AllEffects, PoseResidual>>("pose_attributes_mlp"));
    CHECK(names<AllEffects>("leftgaze"));
    CHECK_FALSE(names<Less<AllEffects, LeftGaze>>("leftgaze"));
    CHECK(names<Less<AllEffects, LeftGaze>>("rightgaze"));
    CHECK_FALSE(names<Less<AllEffects, RightGaze>>("rightgaze"));
    CHECK_FALSE(names<Less<AllEffects, Periocular>>("gaze"));
    CHECK(names<AllEffects>("eye_offset_mlp"));
    CHECK_FALSE(names<Less<AllEffects, EyeOffset>>("eye_offset_mlp"));
    CHECK(names<AllEffects>("kappa"));
    CHECK_FALSE(names<PaperEffects>("kappa"));
    CHECK(names<Effects<HeadPose>>("delta_poses"));
    CHECK_FALSE(names<Effects<LeftGaze>>("delta_poses"));
    for (const char* word : {"mlp", "landmarks", "face.feature", "delta_poses"})
        CHECK_MESSAGE(!names<Effects<>>(word), word);
}

namespace {

/// The parameters of an avatar without effects, by hand.
struct BareFace {
    Columns<float> position, log_scale, rotation, opacity_logit, rest_color, anchor;
};
struct BareEyes {
    Columns<float> feature, log_scale, rotation, opacity_logit, position, centre, spacing;
    Index left_points;
};
/// And of the paper's.
struct WholeFace {
    Mlp<float> exp_attributes, pose_attributes;
    Columns<float> position, feature, log_scale, rotation, opacity_logit;
    Mlp<float> exp_color, pose_color, exp_deform, pose_deform;
    std::array<Mlp<float>, 2> gaze_deform, gaze_color;
    Columns<float> landmarks;
};
struct NoExpression {
    Mlp<float> pose_attributes;
    Columns<float> position, feature, log_scale, rotation, opacity_logit, rest_color;
    Mlp<float> pose_color, pose_deform;
    std::array<Mlp<float>, 2> gaze_deform, gaze_color;
    Columns<float> landmarks, anchor;
};
struct LeftEyeDrivers {
    Vec3<float> left;
};

static_assert(sizeof(FaceStream<float, Effects<>>) == sizeof(BareFace));
static_assert(sizeof(EyeStream<float, Effects<>>) == sizeof(BareEyes));
static_assert(sizeof(FaceStream<float>) == sizeof(WholeFace));
static_assert(sizeof(FaceStream<float, Less<PaperEffects, Expression>>) == sizeof(NoExpression));
static_assert(sizeof(FaceStream<float, Less<PaperEffects, LeftGaze>>) ==
              sizeof(WholeFace) + 2 * sizeof(Columns<float>) - 2 * sizeof(Mlp<float>));
static_assert(sizeof(EyeStream<float>) == sizeof(BareEyes) + sizeof(Mlp<float>));
static_assert(sizeof(Drivers<float, Effects<LeftGaze>>) == sizeof(LeftEyeDrivers));
static_assert(std::is_empty_v<Drivers<float, Effects<>>>);
static_assert(std::is_empty_v<FrameCode<float, Effects<LeftGaze>>>);
static_assert(std::is_empty_v<FaceTrace<float, Effects<LeftGaze>>>);

} // namespace

TEST_CASE("an avatar with fewer effects is saved and read; one with more is not read from it") {
    using Fewer = Less<AllEffects, Expression, LeftGaze>;
    const auto a = held<Fewer>(B{}, avatar_of_all(), tiny_config(), tiny_roles(), drivers_of_all());
    const auto path = std::filesystem::temp_directory_path() / "rye_effects_test.safetensors";
    const auto save = [&](const auto& avatar) {
        std::vector<TensorEntry> entries;
        append_fields("avatar", avatar, entries);
        write_safetensors(path, entries, {});
    };
    save(a);
    TwoStream<double, Fewer> b = zeros_like(a);
    TwoStream<double, Fewer>::buffers([](const std::string&, auto& x) { x.setZero(); }, b);
    load_fields(read_safetensors(path), "avatar", b);
    const auto same = [](const std::string& name, const auto& x, const auto& y) {
        CHECK_MESSAGE((x.size() > 0 && x == y), name);
    };
    TwoStream<double, Fewer>::fields(same, a, b);
    TwoStream<double, Fewer>::buffers(same, a, b);
    TwoStream<double, AllEffects> more = avatar_of_all();
    CHECK_THROWS_WITH_AS(load_fields(read_safetensors(path), "avatar", more),
                         doctest::Contains("exp_color_mlp"), Error);
    // Nothing held: the anchor has no points.
    const TwoStream<double, Fewer> plain = restricted<Fewer>(avatar_of_all());
    save(plain);
    b.face.anchor.resize(0, 0);
    load_fields(read_safetensors(path), "avatar", b);
    CHECK(b.face.anchor.size() == 0);
    CHECK(b.face.position == plain.face.position);
    std::filesystem::remove(path);
}

TEST_CASE("held: with fewer effects it looks the same at those drivers, and goes on from there") {
    const TwoStream<double, AllEffects> all = avatar_of_all();
    const Drivers<double, AllEffects> drivers = drivers_of_all();
    const auto same = [&]<EffectSet Fewer>(const Drivers<double, AllEffects>& at, Fewer) {
        const auto a = held<Fewer>(B{}, all, tiny_config(), tiny_roles(), drivers);
        Drivers<double, Fewer> d = restricted<Fewer>(at);
        if constexpr (!has_effect<Fewer, Kappa>)
            for_eyes([&]<std::size_t eye>() {
                if constexpr (eye_turns<Fewer, eye>)
                    of_eye<eye>(d.gaze) = optical_drivers(all.eyes, at).drivers.gaze[eye];
            });
        const auto x = driven(a, d);
        const auto y = driven(all, at);
        double most = 0;
        Gaussians<double>::fields([&](const std::string&, const auto& m, const auto& n) {
            most = std::max(most, (m - n).cwiseAbs().maxCoeff());
        }, x.gaussians, y.gaussians);
        return most;
    };
    CHECK(same(drivers, Less<AllEffects, Expression>{}) <= 1e-14);
    CHECK(same(drivers, Less<AllEffects, Expression, PoseResidual, EyeOffset>{}) <= 1e-14);
    CHECK(same(drivers, Less<AllEffects, LeftGaze, EyeOffset>{}) <= 1e-14);
    CHECK(same(drivers, Effects<HeadPose>{}) <= 1e-14);
    Drivers<double, AllEffects> later = drivers;
    later.gaze[0] = Vec3<double>(-0.2, 0.3, 0.9);
    CHECK(same(later, Less<AllEffects, Expression, PoseResidual, EyeOffset>{}) <= 1e-14);
    CHECK(same(later, Less<AllEffects, LeftGaze>{}) > 1e-3);
    later.expression[0] += 0.5;
    CHECK(same(later, Less<AllEffects, Expression, EyeOffset>{}) > 1e-3);
}
