// SPDX-License-Identifier: Apache-2.0
#include "model/run.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <csignal>
#include <fstream>
#include <iostream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include <sys/resource.h>

#include <doctest/doctest.h>

#include <rye/avatar/hold.hpp>
#include <rye/io/safetensors.hpp>

#include "../support/file_bytes.hpp"
#include "../support/hostile.hpp"
#include "data/checksums.hpp"
#include "data/threads.hpp"
#include "data/validate.hpp"
#include "drawing/shown.hpp"
#include "tiny_capture.hpp"
#include "tiny_run.hpp"
#include "training/run_folder.hpp"
#include "training/steps.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

/// The tiny run, trained by lines of sight, with a kappa of a few degrees.
TrainState sight_state() {
    TrainState s = tiny_state();
    s.config.gaze_axis = GazeAxis::visual;
    s.avatar.eyes.kappa.resize(2, 2);
    s.avatar.eyes.kappa << -0.03f, -0.02f, 0.09f, -0.08f;
    s.avatar_adam = Adam<Avatar>(s.avatar);
    s.avatar_adam.m.eyes.kappa(0, 1) = 0.25f;
    s.avatar_adam.step = 7;
    return s;
}

std::string message(const fs::path& run) {
    try {
        load_checkpoint(run);
    } catch (const Error& e) {
        return e.what();
    }
    return "accepted";
}

} // namespace

TEST_CASE("run: one by lines of sight comes back from its checkpoint, with its kappa") {
    const TemporaryFolder folder;
    const TrainState state = sight_state();
    save_checkpoint(folder.path, state);
    const TrainState back = load_checkpoint(folder.path);
    CHECK(back.config.gaze_axis == GazeAxis::visual);
    CHECK(read_safetensors(checkpoint_path(folder.path)).has("avatar.eyes.kappa"));
    Avatar::fields([](const std::string& name, const auto& a, const auto& b) {
        INFO(name);
        CHECK((a.array() == b.array()).all());
    }, back.avatar, state.avatar);
    CHECK(back.avatar_adam.m.eyes.kappa(0, 1) == 0.25f);
    CHECK(back.avatar_adam.step == 7);
}

TEST_CASE("run: corrections of cameras come back from its checkpoint") {
    const TemporaryFolder folder;
    TrainState state = tiny_state();
    save_checkpoint(folder.path, state);
    CHECK(!read_safetensors(checkpoint_path(folder.path)).has("avatar.delta_views"));
    state.avatar.delta_view = Columns<float>::Constant(6, 3, 0.01F);
    state.avatar_adam = Adam<Avatar>(state.avatar);
    state.avatar_adam.m.delta_view(2, 1) = 0.5F;
    save_checkpoint(folder.path, state);
    const TrainState back = load_checkpoint(folder.path);
    CHECK(back.avatar.delta_view == state.avatar.delta_view);
    CHECK(back.avatar_adam.m.delta_view(2, 1) == 0.5F);
}

TEST_CASE("run: an optical one has no tensor of kappa") {
    const TemporaryFolder folder;
    save_checkpoint(folder.path, tiny_state());
    CHECK(!read_safetensors(checkpoint_path(folder.path)).has("avatar.eyes.kappa"));
    const TrainState back = load_checkpoint(folder.path);
    CHECK(back.config.gaze_axis == GazeAxis::optical);
    CHECK(drawn_state(back).avatar.eyes.kappa.size() == 0);
}

TEST_CASE("run: a checkpoint that does not fit its gaze_axis is refused, and why") {
    const TemporaryFolder folder;
    TrainState state = sight_state();
    state.config.gaze_axis = GazeAxis::optical;
    save_checkpoint(folder.path, state);
    CHECK(message(folder.path).find("tensor 'avatar.eyes.kappa': got an angle that is not 0, expected "
                                    "none: the run's gaze_axis is 'optical'") != std::string::npos);
    state = tiny_state();
    state.config.gaze_axis = GazeAxis::visual;
    save_checkpoint(folder.path, state);
    CHECK(message(folder.path).find("there is no tensor 'avatar.eyes.kappa', expected one: the "
                                    "run's gaze_axis is 'visual'") != std::string::npos);
}

TEST_CASE("run: what is drawn of one by lines of sight is what is trained, bit for bit") {
    const TrainState state = sight_state(), drawn = drawn_state(state);
    const Drivers<float> drivers = test::tiny_drivers<float>();
    TwoStreamTrace<float, TrainEffects> trace;
    drive(train_backend(), state.avatar,
          {state.config.avatar, state.subject.roles, restricted<TrainEffects>(drivers)}, trace);
    const Gaussians<float>& trained = trace.gaussians;
    Gaussians<float>::fields([](const std::string& name, const auto& a, const auto& b) {
        INFO(name);
        CHECK((a.array() == b.array()).all());
    }, driven_gaussians(drawn, drivers), trained);
    // It is not what the same gazes show as optical axes.
    TrainState optical = drawn;
    optical.avatar.eyes.kappa = {};
    CHECK((driven_gaussians(optical, drivers).mean.array() != trained.mean.array()).any());
}

TEST_CASE("run: a step by lines of sight moves kappa, and the rate 0 keeps it") {
    for (const double rate : {1e-3, 0.0}) {
        TrainState state = sight_state();
        state.config.gaussians.rates.kappa = rate;
        state.config.gaussians.weights.eye_smooth = 0;
        const Columns<float> before = state.avatar.eyes.kappa;
        const StepReport report = avatar_steps(state, {})->step(state, small_sample(state), 1,
                                                                [](const char*) {});
        CHECK(report.bad_field.empty());
        CHECK(state.step == 1);
        const Columns<float>& after = state.avatar.eyes.kappa;
        CHECK(((after - before).cwiseAbs().minCoeff() > 0) == (rate > 0));
        CHECK(((after - before).cwiseAbs().maxCoeff() > 0) == (rate > 0));
    }
}

TEST_CASE("run: a capture without lines of sight does not do for one by them") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    CHECK_NOTHROW(require_gazes(read_capture(folder.path), GazeAxis::visual));
    TinyCapture::remove(tiny.params(2, "gaze.npz"), "visual_right");
    const Capture capture = read_capture(folder.path);
    CHECK_NOTHROW(require_gazes(capture, GazeAxis::optical));
    CHECK_THROWS_WITH_AS(require_gazes(capture, GazeAxis::visual),
                         doctest::Contains("frame '0002': gaze.npz has no visual_right, expected it "
                                           "in every frame, since the run's gaze_axis is 'visual'"),
                         Error);
}

namespace {

/// A checkpoint as a tool might change it: tensors and words by name.
struct Edited {
    std::map<std::string, std::vector<Index>> shape;
    std::map<std::string, std::vector<float>> floats;
    std::map<std::string, std::vector<double>> doubles;
    std::map<std::string, std::vector<std::int64_t>> counts;
    TensorMetadata words;

    explicit Edited(const fs::path& run) {
        const Safetensors file = read_safetensors(checkpoint_path(run));
        words = file.metadata();
        for (const auto& [name, t] : file.tensors()) {
            shape[name] = t.shape;
            if (t.type == TensorType::f32) floats[name] = file.values<float>(name, t.shape);
            else if (t.type == TensorType::f64) doubles[name] = file.values<double>(name, t.shape);
            else counts[name] = file.values<std::int64_t>(name, t.shape);
        }
    }
    void write(const fs::path& run) const {
        std::vector<TensorEntry> entries;
        const auto add = [&]<class T>(const std::map<std::string, std::vector<T>>& all) {
            for (const auto& [name, values] : all)
                entries.push_back(tensor_entry<T>(name, shape.at(name), values));
        };
        add(floats);
        add(doubles);
        add(counts);
        write_safetensors(checkpoint_path(run), entries, words);
    }
    void set(const std::string& name, std::vector<Index> s, std::vector<double> v) {
        shape[name] = std::move(s);
        doubles[name] = std::move(v);
    }
};

/// The checkpoint of `state`, changed, is refused with these words.
template <class F>
void check_refused(const TrainState& state, const std::string& words, F&& change) {
    const TemporaryFolder folder;
    save_checkpoint(folder.path, state);
    Edited e(folder.path);
    change(e);
    e.write(folder.path);
    INFO("expected: ", words);
    const std::string told = message(folder.path);
    INFO("told: ", told);
    CHECK(told.find(words) != std::string::npos);
    CHECK(told.find("checkpoint.safetensors") != std::string::npos);
}

TrainState mesh_state() {
    TrainState s = tiny_state();
    s.stage = Stage::mesh;
    s.avatar = {};
    s.avatar_adam = {};
    s.mesh_adam = Adam<Mesh>(s.mesh);
    return s;
}

/// A run in stage 1 whose surface is a sphere, with eyes of two different radii of the iris.
TrainState state_of_different_eyes() {
    TrainState s = mesh_state();
    s.config.grid.cell = 0.35;
    s.config.mesh.pretrain_steps = 60;
    s.config.gaussians.mouth_points = 20;
    s.config.gaussians.spacing = 0;
    s.config.gaussians.eyeball.points = 120;
    s.subject.limbus_radius = {0.045, 0.07};
    s.subject.iris_plane = {0.1, 0.1};
    pretrain_mesh(s);
    return s;
}

void check_same(const Avatar& a, const Avatar& b) {
    const auto same = [](const std::string& name, const auto& x, const auto& y) {
        INFO(name);
        REQUIRE(x.size() == y.size());
        CHECK((x.array() == y.array()).all());
    };
    Avatar::fields(same, a, b);
    Avatar::buffers(same, a, b);
    CHECK(a.eyes.left_points == b.eyes.left_points);
}

} // namespace

TEST_CASE("run: neighbours of the face are those of its beginning, and a resume has its bits") {
    TrainState state = state_of_different_eyes();
    AvatarLossConfig& weights = state.config.gaussians.weights;
    state.config.gaussians.rates.position = 0.01;
    begin_avatar(state, make_lattice(state));
    CHECK(first_neighbours(state).near.empty()); // weights of 0
    weights.face_smooth = 1, weights.face_mirror = 0.5;
    const FaceNeighbours first =
        face_neighbours(ScalarBackend<Serial>{}, state.avatar.face.position, weights);
    const AvatarSample<float> sample = small_sample(state);
    const auto step = [&](TrainState& s, int count) {
        const std::unique_ptr<AvatarSteps> steps = avatar_steps(s, {});
        for (int k = 0; k < count; ++k)
            CHECK(steps->step(s, sample, 1, [](const char*) {}).bad_field.empty());
    };
    TrainState whole = state;
    step(whole, 4);
    step(state, 2);
    const TemporaryFolder folder;
    save_checkpoint(folder.path, state);
    TrainState back = load_checkpoint(folder.path);
    // Its Gaussians have moved.
    CHECK(face_neighbours(ScalarBackend<Serial>{}, back.avatar.face.position, weights).near !=
          first.near);
    for (const int threads : {1, 3, 0}) {
        set_threads(threads);
        const FaceNeighbours again = first_neighbours(back);
        CHECK((again.near == first.near && again.mirror == first.mirror));
    }
    step(back, 2);
    check_same(back.avatar, whole.avatar);
    // A drawn state has no guidance mesh, and asks for none.
    TrainState plain = drawn_state(back);
    plain.config.gaussians.weights.face_smooth = plain.config.gaussians.weights.face_mirror = 0;
    CHECK(first_neighbours(plain).mirror.empty());
}

TEST_CASE("run: two eyes that differ, through steps, a checkpoint, a resume and a drawing") {
    TrainState state = state_of_different_eyes();
    begin_avatar(state, make_lattice(state));
    const auto& eyes = state.avatar.eyes;
    const Index left = eyes.points_of(0), right = eyes.points_of(1);
    REQUIRE(left != right);
    CHECK(eyes.position.cols() == left + right);
    for (std::size_t e = 0; e < 2; ++e) { // each eye has the points of its own template, in its place
        const double limbus = state.subject.limbus_radius[e];
        const Columns<float> points = eyes.position.middleCols(eyes.first_point(static_cast<Index>(e)),
                                                               eyes.points_of(static_cast<Index>(e)));
        int on_rim = 0;
        for (Index i = 0; i < points.cols(); ++i)
            on_rim += points(2, i) > 0 && std::abs(points.col(i).head<2>().norm() - limbus) < 1e-4;
        CHECK(on_rim >= 8);
    }
    const AvatarSample<float> sample = small_sample(state);
    const auto step = [&](TrainState& s) {
        return avatar_steps(s, {})->step(s, sample, 1, [](const char*) {});
    };
    for (int k = 0; k < 2; ++k) CHECK(step(state).bad_field.empty());
    const TemporaryFolder folder;
    save_checkpoint(folder.path, state);
    CHECK(read_safetensors(checkpoint_path(folder.path)).word("left_eye_points") ==
          std::to_string(left));
    TrainState back = load_checkpoint(folder.path);
    check_same(back.avatar, state.avatar);
    step(state);
    step(back);
    check_same(back.avatar, state.avatar);

    // Each eye turns by its own gaze, about its own centre, and the other one does not.
    const TrainState drawn = load_trained(folder.path);
    Drivers<float> drivers = sample.drivers;
    const Gaussians<float> before = driven_gaussians(drawn, drivers);
    const Index face = drawn.avatar.face.position.cols();
    for (std::size_t e = 0; e < 2; ++e) {
        drivers = sample.drivers;
        drivers.gaze[e] = Vec3<float>(0.4f, -0.2f, 1).normalized();
        const Columns<float> moved =
            (driven_gaussians(drawn, drivers).mean - before.mean).colwise().norm();
        const auto of = [&](Index eye) {
            return moved.middleCols(face + drawn.avatar.eyes.first_point(eye),
                                    drawn.avatar.eyes.points_of(eye));
        };
        const Index turned = static_cast<Index>(e);
        CHECK(of(turned).minCoeff() > 0);
        CHECK(of(1 - turned).maxCoeff() == 0);
    }
    CHECK(render_avatar(drawn, {sample.drivers, test::tiny_camera(63, 47).cast<float>()}).high.width ==
          63);
}

TEST_CASE("run: shapes, ranges and finiteness of a checkpoint are checked, and named") {
    const TrainState state = tiny_state();
    using E = Edited;
    check_refused(state, "'subject.roles.expression': value 3 is 1000000000.000000, expected a whole",
                  [](E& e) { e.doubles["subject.roles.expression"][3] = 1e9; });
    check_refused(state, "'subject.roles.expression': value 0 is 0.500000",
                  [](E& e) { e.doubles["subject.roles.expression"][0] = 0.5; });
    check_refused(state, "'subject.roles.right_eye': value 1 is nan",
                  [](E& e) { e.doubles["subject.roles.right_eye"][1] = std::nan(""); });
    check_refused(state, "'subject.roles.left_eye': got 0 columns",
                  [](E& e) { e.set("subject.roles.left_eye", {0, 1}, {}); });
    check_refused(state, "subject.head_centre: got shape (0, 3), expected (1, 3)",
                  [](E& e) { e.set("subject.head_centre", {0, 3}, {}); });
    check_refused(state, "'subject.neutral_landmarks': got shape (2, 3), expected (N, 3)",
                  [](E& e) { e.set("subject.neutral_landmarks", {2, 3}, {0, 0, 0, 1, 1, 1}); });
    check_refused(state, "'subject.eye_sizes': eye_radius 0.120000, limbus_radius 0.500000",
                  [](E& e) { e.doubles["subject.eye_sizes"][1] = 0.5; });
    check_refused(state, "avatar.delta_poses: got shape (1, 6), expected (2, 6)", [](E& e) {
        e.shape["avatar.delta_poses"] = {1, 6};
        e.floats["avatar.delta_poses"].resize(6);
    });
    TrainState views = state;
    views.avatar.delta_view = Columns<float>::Constant(6, 3, 0.01F);
    views.avatar_adam = Adam<Avatar>(views.avatar);
    check_refused(views, "tensor 'avatar.delta_views': got shape (3, 5), expected (cameras, 6)",
                  [](E& e) {
                      e.shape["avatar.delta_views"] = {3, 5};
                      e.floats["avatar.delta_views"].resize(15);
                  });
    check_refused(state, "'train_frames': got shape (0,)", [](E& e) {
        e.shape["train_frames"] = {0};
        e.counts["train_frames"].clear();
    });
    check_refused(state, "'train_frames': got -1", [](E& e) { e.counts["train_frames"][1] = -1; });
    check_refused(state, "'avatar.face.xyz': value 0 is nan, expected a finite number", [](E& e) {
        for (float& x : e.floats["avatar.face.xyz"]) x = std::nanf("");
    });
    check_refused(state, "'avatar.eyes.spacing': value 4 is inf",
                  [](E& e) { e.floats["avatar.eyes.spacing"][4] = INFINITY; });
    check_refused(state, "'avatar_adam.v.face.xyz': value 2 is -1.000000",
                  [](E& e) { e.floats["avatar_adam.v.face.xyz"][2] = -1; });
    check_refused(state, "'avatar_adam.field_steps': got 1 counts", [](E& e) {
        e.shape["avatar_adam.field_steps"] = {1};
        e.counts["avatar_adam.field_steps"] = {0};
    });
    check_refused(state, "'avatar_adam.step': got -3",
                  [](E& e) { e.counts["avatar_adam.step"][0] = -3; });
    check_refused(state, "metadata 'left_eye_points': got '18', expected a whole number from 0 to 17",
                  [](E& e) { e.words["left_eye_points"] = "18"; });
    check_refused(state, "metadata 'step': got '2000000000'",
                  [](E& e) { e.words["step"] = "2000000000"; });
    check_refused(state, "metadata 'expression': got '99999999999999999999'",
                  [](E& e) { e.words["expression"] = "99999999999999999999"; });
    check_refused(state, "metadata 'measured_eyes': got 'maybe'",
                  [](E& e) { e.words["measured_eyes"] = "maybe"; });
    check_refused(mesh_state(), "'mesh.geo_mlp.conv0.bias': value 0 is nan",
                  [](E& e) { e.floats["mesh.geo_mlp.conv0.bias"][0] = std::nanf(""); });
    check_refused(mesh_state(), "'mesh_adam.m.geo_mlp.conv0.bias': value 0 is inf",
                  [](E& e) { e.floats["mesh_adam.m.geo_mlp.conv0.bias"][0] = INFINITY; });
}

TEST_CASE("run: sizes that only the configuration claims allocate nothing") {
    const auto claim = [](const std::string& field, const nlohmann::json& value) {
        return [=](Edited& e) {
            auto json = nlohmann::json::parse(e.words["config"]);
            json[nlohmann::json::json_pointer(field)] = value;
            e.words["config"] = json.dump();
        };
    };
    const auto before = std::chrono::steady_clock::now();
    for (const TrainState& state : {tiny_state(), mesh_state()}) {
        check_refused(state, "metadata 'config': its networks have ",
                      claim("/avatar/networks/geometry", std::vector<int>(64, 65536)));
        check_refused(state, "metadata 'config': its networks have ",
                      claim("/avatar/networks/eye_offset", std::vector<int>{65536, 65536}));
        check_refused(state, "metadata 'config': field 'avatar.feature': got 1000000000",
                      claim("/avatar/feature", 1'000'000'000));
    }
    check_refused(tiny_state(), "metadata 'config': its networks have ",
                  claim("/gaussians/upsampler/capacity", 1024));
    check_refused(tiny_state(), "metadata 'config': its networks have ", [](Edited& e) {
        e.words["expression"] = "1000000";
    });
    CHECK(std::chrono::steady_clock::now() - before < std::chrono::seconds(20));
}

TEST_CASE("run: a state that is not finite is not saved, and the checkpoint before it stays") {
    const TemporaryFolder folder;
    TrainState state = tiny_state();
    save_checkpoint(folder.path, state);
    const Bytes before = read_file(checkpoint_path(folder.path));
    state.avatar.face.log_scale(1, 5) = INFINITY;
    CHECK_THROWS_WITH_AS(save_checkpoint(folder.path, state),
                         doctest::Contains("'avatar.face.scales': value 16 is inf"), Error);
    CHECK(read_file(checkpoint_path(folder.path)) == before);
}

TEST_CASE("run: what is not trained is not drawn, and the command that goes on is named") {
    const TemporaryFolder folder;
    const std::string command = "`rye train --out " + folder.path.string() + " --resume`";
    TrainState state = tiny_state();
    save_checkpoint(folder.path, state); // stage 2, step 0
    CHECK_THROWS_WITH_AS(load_trained(folder.path), doctest::Contains(command.c_str()), Error);
    save_checkpoint(folder.path, mesh_state());
    CHECK_THROWS_WITH_AS(load_trained(folder.path), doctest::Contains(command.c_str()), Error);
    state.step = 1;
    save_checkpoint(folder.path, state);
    CHECK_NOTHROW(load_trained(folder.path));
}

TEST_CASE("run: drivers that overflow draw nothing, with an error") {
    TrainState state = drawn_state(tiny_state());
    state.avatar.face.log_scale.setConstant(200);
    CHECK_THROWS_WITH_AS(driven_gaussians(state, test::tiny_drivers<float>()),
                         doctest::Contains("not finite everywhere"), Error);
}

// ---- the folder of a run ------------------------------------------------------------------------

namespace {

void overwrite(const fs::path& path, const std::string& text) { std::ofstream(path) << text; }
/// Lines of a log, each with its checksum.
std::string checked_lines(const std::string& lines) {
    std::istringstream in(lines);
    std::string all;
    for (std::string line; std::getline(in, line);)
        all += checked_text(nlohmann::ordered_json::parse(line), -1);
    return all;
}

} // namespace

TEST_CASE("run folder: the log of a resumed run keeps its own lines, whatever else is in the file") {
    const TemporaryFolder folder;
    TrainState state = tiny_state();
    state.step = 40;
    const std::string good = R"({"stage":"mesh","step":900,"loss":1})" "\n"
                             R"({"stage":"avatar","step":20})" "\n"
                             R"({"stage":"avatar","step":40})" "\n";
    overwrite(folder.path / "log.jsonl",
               "5\n[]\n\"x\"\nnull\n{}\n" + good + R"({"stage":"avatar","step":60})" "\n" +
                   R"({"stage":5,"step":20})" "\n" + R"({"stage":"avatar","step":"20"})" "\n" +
                   R"({"stage":"avatar","st)");
    int damaged = 0;
    const std::string kept = kept_log(folder.path / "log.jsonl", state, damaged);
    CHECK(kept == checked_lines(good));
    CHECK(damaged == 7);
    // The lines of an older program have checksums now, and are still there when it goes on again.
    damaged = 0;
    overwrite(folder.path / "log.jsonl", kept);
    CHECK(kept_log(folder.path / "log.jsonl", state, damaged) == kept);
    CHECK(damaged == 0);
    CHECK(kept_log(folder.path / "none", state, damaged).empty());
    // What was fitted after stage 1 belongs to stage 2: a run that is still in stage 1 fits again.
    const std::string step = R"({"stage":"mesh","step":15})" "\n";
    const std::string fit = R"({"stage":"mesh","step":15,"landmark_rms":0.1})" "\n";
    overwrite(folder.path / "log.jsonl", step + fit);
    CHECK(kept_log(folder.path / "log.jsonl", state, damaged) == checked_lines(step + fit));
    state.stage = Stage::mesh;
    state.step = 15;
    CHECK(kept_log(folder.path / "log.jsonl", state, damaged) == checked_lines(step));
    // What was found about labels is of the whole run.
    const std::string labels = R"({"stage":"labels","step":0,"labels":[]})" "\n";
    overwrite(folder.path / "log.jsonl", labels + step);
    CHECK(kept_log(folder.path / "log.jsonl", state, damaged) == checked_lines(labels + step));
}

TEST_CASE("run folder: a run is replaced when the new one has a checkpoint, not before") {
    const TemporaryFolder folder;
    TrainState old = tiny_state();
    {
        RunFolder run(folder.path, old, Beginning::fresh);
        run.log({{"stage", "avatar"}, {"step", 20}});
        run.save(old);
        overwrite(folder.path / "panels" / "step_0000500.png", "old");
    }
    const auto all = [&] {
        return bytes_of(folder.path / "checkpoint.safetensors") + bytes_of(folder.path / "config.json") +
               bytes_of(folder.path / "log.jsonl") +
               bytes_of(folder.path / "panels" / "step_0000500.png");
    };
    const std::string before = all();
    CHECK(before.find("\"step\":20") != std::string::npos);
    TrainState state = tiny_state();
    state.config.seed = 77;
    {
        RunFolder run(folder.path, state, Beginning::replacing);
        run.log({{"stage", "avatar"}, {"step", 1}});
        CHECK(all() == before);
        state.avatar.face.position(0, 0) = NAN;
        CHECK_THROWS_WITH_AS(run.save(state), doctest::Contains("the run that is there stays"), Error);
        CHECK(all() == before);
    } // killed here, the old run is as it was
    CHECK(all() == before);
    state.avatar.face.position(0, 0) = 0;
    RunFolder run(folder.path, state, Beginning::replacing);
    run.log({{"stage", "avatar"}, {"step", 2}});
    run.save(state);
    run.log({{"stage", "avatar"}, {"step", 3}});
    const std::string log = bytes_of(folder.path / "log.jsonl");
    CHECK(log.starts_with("{\"stage\":\"avatar\",\"step\":2,"));
    CHECK(log.find("\n{\"stage\":\"avatar\",\"step\":3,") != std::string::npos);
    CHECK(std::count(log.begin(), log.end(), '\n') == 2);
    CHECK(bytes_of(folder.path / "config.json").find("\"seed\": 77") != std::string::npos);
    CHECK(load_checkpoint(folder.path).config.seed == 77);
    CHECK(!fs::exists(folder.path / "panels" / "step_0000500.png"));
    CHECK(files_in(folder.path) == 4); // and nothing beside them
}

TEST_CASE("run folder: a log that has no room has whole lines only, a checkpoint stays, and both say") {
    const TemporaryFolder folder;
    TrainState state = tiny_state();
    RunFolder run(folder.path, state, Beginning::fresh);
    run.save(state);
    const std::string before = bytes_of(folder.path / "checkpoint.safetensors");
    std::ostringstream told;
    std::streambuf* const usual = std::cerr.rdbuf(told.rdbuf());
    std::string fault;
    rlimit limit{};
    REQUIRE(::getrlimit(RLIMIT_FSIZE, &limit) == 0);
    const rlimit little{1000, limit.rlim_max};
    const auto handler = std::signal(SIGXFSZ, SIG_IGN);
    REQUIRE(::setrlimit(RLIMIT_FSIZE, &little) == 0);
    for (int step = 20; step <= 1000; step += 20) run.log({{"stage", "avatar"}, {"step", step}});
    state.step = 1;
    try {
        run.save(state);
    } catch (const Error& e) {
        fault = e.what();
    }
    ::setrlimit(RLIMIT_FSIZE, &limit);
    std::signal(SIGXFSZ, handler);
    std::cerr.rdbuf(usual);
    const std::string log = bytes_of(folder.path / "log.jsonl");
    CHECK(log.size() > 900);
    CHECK(log.size() <= 1000);
    CHECK(log.back() == '\n');
    int damaged = 0;
    state.step = 1000;
    CHECK(kept_log(folder.path / "log.jsonl", state, damaged) == log);
    CHECK(damaged == 0);
    CHECK(told.str().find("log.jsonl: cannot be written: File too large; lines of it are left out\n") !=
          std::string::npos);
    CHECK(fault.find("checkpoint.safetensors: cannot be written (the old file is untouched): File too large") !=
          std::string::npos);
    CHECK(fault.find("go on from the checkpoint before it with `rye train --out ") !=
          std::string::npos);
    CHECK(bytes_of(folder.path / "checkpoint.safetensors") == before);
    CHECK(files_in(folder.path) == 4);
}

TEST_CASE("run folder: a path that is a file, and a panel that cannot be drawn") {
    const TemporaryFolder folder;
    overwrite(folder.path / "file", "mine");
    const TrainState state = tiny_state();
    CHECK_THROWS_WITH_AS(RunFolder(folder.path / "file", state, Beginning::fresh),
                         doctest::Contains("is a file, expected a folder"), Error);
    CHECK_THROWS_AS(RunFolder(folder.path / "file" / "run", state, Beginning::fresh), Error);
    CHECK(bytes_of(folder.path / "file") == "mine");
    fs::create_directories(folder.path / "run" / "checkpoint.safetensors");
    CHECK_THROWS_AS(RunFolder(folder.path / "run", state, Beginning::fresh), Error);
    CHECK(!fs::exists(folder.path / "run" / "config.json"));
    RunFolder run(folder.path / "other", state, Beginning::fresh);
    CHECK_NOTHROW(run.panel("step_1.png", []() -> Image<float> { throw Error("no picture"); }));
    CHECK(files_in(folder.path / "other" / "panels") == 0);
}
