// SPDX-License-Identifier: Apache-2.0
// Where stage 2 is trained, and the memory that it needs on a device. What a device computes is
// tested by tests/train and tests/cuda.
#include <doctest/doctest.h>

#include <rye/geometry/marching_tets.hpp>
#include <rye/geometry/refine.hpp>

#include "../support/hostile.hpp"
#include "../support/tiny_mesh.hpp"
#include "data/config_difference.hpp"
#include "device/choice.hpp"
#include "drawing/avatar_drawer.hpp"
#include "drawing/variants.hpp"
#include "model/run_size.hpp"
#include "tiny_run.hpp"
#include "training/device_count.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

DeviceFinding with_device() { return {true, DeviceFacts{"A device", 5e9, 8e9}, ""}; }
DeviceFinding without_device() { return {true, std::nullopt, "CUDA says: none"}; }
DeviceFinding without_build() { return {false, std::nullopt, "this build has no kernels"}; }

/// Needs 1.5 GB, of which 1 GB for 1000 pictures.
DeviceNeed some_need(const TrainConfig& config, bool lpips = false) {
    DeviceNeed need = need_of({50000000, 1000000000, 100000000, 200000000, 120000000, 30000000},
                              config, lpips);
    need.views = 1000;
    return need;
}

/// A run with these parts at the beginning of stage 2.
TrainState begun_state(const std::string& parts) {
    TrainState s = tiny_state();
    s.stage = Stage::mesh;
    from_json({{"avatar", nlohmann::ordered_json::parse(parts)},
               {"grid", {{"half_side", 1.6}, {"cell", 0.4}, {"subdivide", false}}},
               {"gaussians",
                {{"spacing", 0},
                 {"eyeball", {{"points", 400}}},
                 {"rates", {{"delta_gaze", 1e-3}, {"delta_view", 1e-3}}}}}},
              "x.json", s.config);
    s.view_directions = Columns<double>::Ones(3, 4);
    s.mesh = test::lifted<float>(test::tiny_mesh());
    begin_avatar(s, make_lattice(s));
    return s;
}

/// Eyes and lips on the front of a head.
Subject subject() {
    Subject s;
    s.head_centre = {0.1, 0.2, -0.3};
    s.neutral.resize(3, 66);
    for (Index k = 0; k < 66; ++k) {
        const double turn = 0.7 * static_cast<double>(k);
        s.neutral.col(k) = s.head_centre + Vec3<double>(0.4 * std::cos(turn), 0.3 * std::sin(turn),
                                                        0.6 + 0.01 * static_cast<double>(k % 9));
    }
    for (Index k = 0; k < 66; ++k)
        if (k < 36 || k >= 48) s.roles.expression.push_back(k);
    s.roles.eye = {std::vector<Index>{42, 43, 44}, std::vector<Index>{36, 37, 38}};
    return s;
}

/// Vertices that stage 2 begins with where stage 1 finds the sphere that a run is guessed by.
double vertices_of_sphere(const TrainConfig& c, const Columns<double>& landmarks) {
    const Vec3<float> h = Vec3<float>::Constant(1.75f);
    const TetGrid<float> coarse = bcc_grid<float>(-h, h, static_cast<float>(c.grid.cell));
    const TetGrid<float> grid = c.grid.subdivide ? subdivide(coarse) : coarse;
    Columns<float> distance(1, grid.vertices.cols());
    distance.row(0) = grid.vertices.colwise().norm().array() - 1.0f;
    const Surface<float> surface =
        marching_tetrahedra<float>(grid.topology, grid.vertices, distance);
    TriangleMesh<float> mesh{surface.positions, surface.topology.faces};
    Columns<float> none = Columns<float>::Zero(1, mesh.vertices.cols());
    const AvatarTrainConfig& g = c.gaussians;
    const auto bound = [&](const Vec3<float>& x) -> float {
        const double d =
            (landmarks.middleCols(36, 30).colwise() - x.cast<double>()).colwise().norm().minCoeff();
        return static_cast<float>(g.spacing + g.spacing_slope * d);
    };
    if (g.spacing > 0) refine(mesh, none, bound, 6);
    return static_cast<double>(mesh.vertices.cols());
}

} // namespace

TEST_CASE("device: before stage 1 the surface is guessed by what a lattice cuts of a sphere") {
    for (const bool finer : {false, true})
        for (const double spacing : {0.0, 0.02, 0.06})
            for (const double slope : {0.1, 0.3}) {
                TrainConfig c = preset("tiny");
                c.grid.cell = finer ? 0.2 : 0.1;
                c.grid.subdivide = finer;
                c.gaussians.spacing = spacing;
                c.gaussians.spacing_slope = slope;
                const SurfaceGuess guess = surface_guess(c, subject());
                INFO("spacing ", spacing, " slope ", slope, " finer ", finer);
                CHECK((guess.points.colwise().norm().array() - 1).abs().maxCoeff() < 1e-9);
                CHECK((guess.landmarks.colwise().norm().array() - 1).abs().maxCoeff() < 1e-9);
                // Heads have 1.2 times the surface.
                CHECK(guess.vertices.sum() / 1.2 ==
                      doctest::Approx(vertices_of_sphere(c, guess.landmarks)).epsilon(0.1));
            }
}

TEST_CASE("device: points that drivers move are those of the guess before stage 1") {
    TrainState s = tiny_state();
    s.stage = Stage::mesh;
    s.config = preset("gpu");
    s.config.avatar.expression = 4;
    s.subject = subject();
    Capture capture;
    capture.width = capture.height = 64;
    const DeviceSizes sizes = device_sizes(s, capture);
    const SurfaceGuess guess = surface_guess(s.config, s.subject);
    CHECK(sizes.face == static_cast<Index>(
                            std::ceil(guess.vertices.sum() + s.config.gaussians.mouth_points)));
    CHECK(sizes.eyes == 2 * s.config.gaussians.eyeball.points);
    for (const std::uint32_t listed : sizes.listed) {
        CHECK(listed > 0);
        CHECK(static_cast<Index>(listed) <= sizes.face);
    }
    CHECK(static_cast<int>(sizes.listed[0]) > s.config.gaussians.mouth_points); // expressions move the mouth
    CHECK(sizes.listed[2] < sizes.listed[0]);                 // gazes the lids alone
}

TEST_CASE("device: memory is that of the most Gaussians that density makes") {
    TrainState s = tiny_state();
    s.train_frames = {};
    Capture capture;
    capture.width = capture.height = 64;
    s.config.gaussians.steps = 100;
    s.step = 10;
    const DeviceSizes plain = device_sizes(s, capture);
    CHECK(plain.face == 60);
    s.config.gaussians.density = {.every = 20, .first = 20, .last = 60, .grow = 0.5, .most = 120};
    const DeviceSizes more = device_sizes(s, capture);
    CHECK(more.face == 120);
    CHECK(more.eyes == plain.eyes);
    for (std::size_t k = 0; k < 4; ++k) CHECK(more.listed[k] >= plain.listed[k]);
    s.step = 40; // one more
    CHECK(device_sizes(s, capture).face == 90);
    s.step = 60;
    CHECK(device_sizes(s, capture).face == 60);
}

TEST_CASE("device: fields that stage 1 does not read do not tell two first stages apart") {
    const TrainConfig a = preset("cpu");
    const auto differ = [&](const nlohmann::ordered_json& json) {
        TrainConfig b = a;
        from_json(json, "x.json", b);
        return first_difference(stage_one_fields(b), stage_one_fields(a));
    };
    for (const nlohmann::ordered_json& json : std::vector<nlohmann::ordered_json>{
             {{"gaussians", {{"mouth_points", 5}, {"steps", 7}, {"planes", 3}}}},
             {{"gaussians", {{"density", {{"every", 50}}}}}},
             {{"gaussians", {{"weights", {{"blank", 0}}}, {"eyeball", {{"points", 9}}}}}},
             {{"avatar", {{"gaze_mechanism", "condition"}, {"eye_appearance", "free"}}}},
             {{"avatar", {{"shading", "none"}, {"eye_appearance", "free"}}}},
             {{"avatar", {{"attribute_scale", 3}, {"networks", {{"exp_attributes", {5}}}}}}},
             {{"grid", {{"subdivide", false}}}}})
        CHECK(differ(json) == "");
    CHECK(differ({{"seed", 8}}) == "field 'seed': got 8, expected 1");
    CHECK(
        differ({{"mesh", {{"rates", {{"networks", 0.5}}}}}}).find("field 'mesh.rates.networks'") ==
        0);
    CHECK(differ({{"grid", {{"cell", 0.5}}}}).find("field 'grid.cell': got 0.5, expected") == 0);
    CHECK(differ({{"avatar", {{"networks", {{"gaze_deform", {5}}}}}}}) != "");
    CHECK(differ({{"avatar", {{"channels", 9}}}}) != "");
    CHECK(differ({{"gaze_axis", "visual"}}) != "");
    CHECK(differ({{"gaussians", {{"eyeball", {{"radius", 0.2}}}}}}) != "");
}

TEST_CASE("device: auto takes it where there is one with kernels for the configuration") {
    TrainConfig c = preset("gpu");
    CHECK(decided(DeviceWish::automatic, c, with_device()).device);
    CHECK(decided(DeviceWish::cuda, c, with_device()).device);
    CHECK_FALSE(decided(DeviceWish::cpu, c, with_device()).device);
    const DeviceDecision none = decided(DeviceWish::automatic, c, without_device());
    CHECK_FALSE(none.device);
    CHECK(none.reason == "CUDA says: none");
    const DeviceDecision plain = decided(DeviceWish::automatic, c, without_build());
    CHECK_FALSE(plain.device);
    CHECK(plain.reason.empty());
    CHECK_FAULT(decided(DeviceWish::cuda, c, without_device()),
                "--device: got cuda, but CUDA says: none");
    CHECK_FAULT(decided(DeviceWish::cuda, c, without_build()),
                "--device: got cuda, but this build has no kernels");
}

TEST_CASE("device: parts without kernels are named") {
    for (const std::string& name : preset_names()) {
        INFO(name);
        CHECK(without_kernels(preset(name)) == "");
    }
    for (const std::string name : {"tiny", "cpu", "gpu"})
        CHECK(beyond(preset(name), narrow_tiles) == "");
    CHECK(beyond(preset("paper"), narrow_tiles) ==
          "avatar.feature is 128, kernels have room for 64");
    const auto refused = [](const nlohmann::ordered_json& json, const std::string& words) {
        TrainConfig c = preset("tiny");
        from_json(json, "x.json", c);
        INFO(words);
        CHECK(without_kernels(c).find(words) == 0);
        CHECK_FAULT(decided(DeviceWish::cuda, c, with_device()),
                    "--device: got cuda, but " + words);
        CHECK_FALSE(decided(DeviceWish::automatic, c, with_device()).device);
        CHECK(decided(DeviceWish::automatic, c, with_device()).reason.find(words) == 0);
    };
    refused({{"avatar", {{"feature", 129}}}}, "avatar.feature is 129, kernels have room for 128");
    refused({{"avatar", {{"frequencies", 11}}}}, "avatar.frequencies is 11");
    refused({{"avatar", {{"networks", {{"exp_color", {64, 257}}}}}}},
            "a width of avatar.networks.exp_color is 257");
    refused({{"avatar", {{"networks", {{"gaze_deform", std::vector<int>(8, 16)}}}}}},
            "number of layers of avatar.networks.gaze_deform is 9");
    TrainConfig lit = preset("tiny");
    from_json({{"avatar", {{"eye_appearance", "driven"}, {"shading", "head_pose"}}}}, "x.json",
              lit);
    CHECK(without_kernels(lit) == "");
    for (const char* mechanism : {"rotation", "feature_rotation", "condition", "latent_rotation",
                                  "learned_quaternion", "none"}) {
        INFO(mechanism);
        TrainConfig c = preset("tiny");
        from_json({{"avatar", {{"gaze_mechanism", mechanism}}}}, "x.json", c);
        CHECK(without_kernels(c) == "");
    }
    TrainConfig wide = preset("tiny"); // of one column, and of stage 1
    wide.avatar.networks.eye_offset = {512};
    wide.avatar.networks.geometry = {512};
    CHECK(without_kernels(wide) == "");
}

TEST_CASE("device: this build finds a device, or says why not") {
    const DeviceFinding f = find_device();
    CHECK(f.found.has_value() == f.reason.empty());
    if (f.found) CHECK(f.found->total >= f.found->free);
    if (!f.built) {
        TrainState s = tiny_state();
        CHECK_FAULT(device_drawer<TrainEffects>(s.avatar, s.config.avatar, s.subject.roles, {}),
                    "this build has no kernels (configure it with -DRYE_CUDA=ON)");
        CHECK_FAULT(device_engine<TrainEffects>(s.avatar, s.avatar_adam, {}),
                    "this build has no kernels (configure it with -DRYE_CUDA=ON)");
    }
}

TEST_CASE("device: a run is drawn on the CPU where that is asked for, and where nothing else draws") {
    const TrainState run = drawn_state(tiny_state());
    const Drivers<float> drivers = test::tiny_drivers<float>();
    const Pinhole<float> camera = test::tiny_camera(63, 48).cast<float>();
    const AvatarView whole = render_avatar(run, {drivers, camera});
    const PosedEyes eyes = posed_eyes(run, {drivers, camera});
    const AvatarDrawer plain(run), asked(run, DeviceWish::cpu);
    for (const AvatarDrawer* d : {&plain, &asked}) {
        CHECK(!d->on_device());
        CHECK(d->name() == "cpu");
        CHECK(d->words().empty());
        CHECK(!d->lpips());
        CHECK(d->picture({drivers, camera}).pixels == whole.high.pixels);
        const ShownAvatar shown = d->shown({drivers, camera});
        CHECK(shown.picture.pixels == whole.high.pixels);
        CHECK(shown.eyes.area.pixels == eyes.area.pixels);
        CHECK(shown.eyes.centre == eyes.centre);
    }
    if (find_device().found) return;
    CHECK(AvatarDrawer(run, DeviceWish::automatic).name() == "cpu");
    CHECK_FAULT(AvatarDrawer(run, DeviceWish::cuda), "--device: got cuda, but ");
    CHECK(left_out_on_device("", "--effects").empty());
    CHECK(left_out_on_device("auto", "--effects").empty());
    CHECK(left_out_on_device("paper", "--effects").empty());
    CHECK(left_out_on_device("still", "--effects") ==
          "--effects still leaves effects out, and a device draws all that was trained");
}

TEST_CASE("device: memory is counted of an avatar as stage 2 begins with") {
    for (const std::string parts :
         {R"({})", R"({"eye_appearance": "driven", "shading": "head_pose"})",
          R"({"gaze_mechanism": "none"})", R"({"gaze_mechanism": "feature_rotation"})",
          R"({"gaze_mechanism": "condition", "shading": "head_pose"})",
          R"({"gaze_mechanism": "latent_rotation"})",
          R"({"gaze_mechanism": "learned_quaternion"})"}) {
        CAPTURE(parts);
        TrainState s = begun_state(parts);
        const auto shapes = [](const TrainState& of) {
            std::vector<std::pair<Index, Index>> all;
            const auto add = [&]<EffectSet E>(const TwoStream<float, E>& avatar) {
                const auto put = [&](const std::string&, const auto& a) {
                    all.emplace_back(a.rows(), a.cols());
                };
                TwoStream<float, E>::fields(put, avatar);
                TwoStream<float, E>::buffers(put, avatar);
            };
            of.compared ? add(of.compared->avatar) : add(of.avatar);
            return all;
        };
        const auto begun = shapes(s);
        DeviceSizes sizes;
        const auto count = [&](const auto& avatar) {
            sizes.face = avatar.face.position.cols();
            sizes.eyes = avatar.eyes.position.cols();
        };
        s.compared ? count(s.compared->avatar) : count(s.avatar);
        CHECK(shapes(sized_state(s, sizes)) == begun);
        s.stage = Stage::mesh;
        CHECK(shapes(sized_state(s, sizes)) == begun);
        s.stage = Stage::avatar;
        sizes.face += 7;
        const auto larger = shapes(sized_state(s, sizes));
        s.stage = Stage::mesh;
        CHECK(shapes(sized_state(s, sizes)) == larger);
        CHECK(larger != begun);
    }
}

TEST_CASE("device: what does not fit is refused, with the field to lower") {
    TrainConfig c = preset("gpu");
    DeviceNeed need = some_need(c);
    CHECK(need.sum() == 1.5e9);
    CHECK(text_of(need) == "about 1.500 GB of device memory: parameters, gradient and moments 0.050, "
                           "pictures 1.000, networks 0.100, renders 0.200, upsampler 0.120, losses "
                           "0.030");
    CHECK_NOTHROW(require_device_room(need, {"A device", need.sum(), 8e9}, "x"));
    CHECK_FAULT(require_device_room(need, {"A device", need.sum() - 1, 8e9}, "--preset gpu"),
                "--preset gpu: got settings that need about ");
    CHECK_FAULT(require_device_room(need, {"A device", 1e6, 8e9}, "x"),
                "expected at most the 0.001 GB that are free of the 8.000 GB of A device");
    CHECK_FAULT(require_device_room(need, {"A device", 1e9, 8e9}, "x"),
                "the capture's number or size of pictures");
    need = need_of({1, 2, 3, 4, 6000000000, 5}, c, false);
    CHECK_FAULT(require_device_room(need, {"A device", 1e9, 8e9}, "x"),
                "lowering gaussians.upsampler.capacity, or train with --device cpu");
    need = need_of({1, 2, 3, 4, 5, 6000000000}, c, true);
    CHECK_FAULT(require_device_room(need, {"A device", 1e9, 8e9}, "x"),
                "lowering the perceptual loss, by leaving out --perceptual-weights");
}

TEST_CASE("device: pictures that do not fit stay in the host's memory, other arrays do not") {
    const DeviceNeed need = some_need(preset("gpu"));
    const auto stay = [&](double free) { return views_on_host(need, {"A device", free, 8e9}); };
    CHECK(stay(need.sum()) == 0);
    // Three places remain, and a twentieth is spared: 0.9505 - 0.503 GB are 447 pictures.
    CHECK(stay(1.0005e9) == 1000 - 447);
    CHECK(stay(0.503e9) == 1000);
    CHECK(stay(0.502e9) == 0); // it is not the pictures
    DeviceNeed some = need;
    some.on_host = 553;
    CHECK(text_of(some).ends_with("; 553 of 1000 pictures stay in the host's memory"));
}

TEST_CASE("device: a configuration keeps its planes, of which there are kernels for 1 and 3") {
    TrainConfig c = preset("paper");
    CHECK(c.gaussians.planes == 1);
    from_json({{"gaussians", {{"planes", 3}}}}, "x.json", c);
    TrainConfig again = preset("paper");
    from_json(to_json(c), "y.json", again);
    CHECK(again.gaussians.planes == 3);
    CHECK_FAULT(from_json({{"gaussians", {{"planes", 2}}}}, "x.json", c),
                "x.json: field 'gaussians.planes': got 2, expected 1 or 3");
    CHECK_FAULT(from_json({{"gaussians", {{"planes", 4}}}}, "x.json", c),
                "field 'gaussians.planes': got 4, expected a whole number from 1 to 3");
}
