// SPDX-License-Identifier: Apache-2.0
// The presets "paper" and "paper-literal": the fields that tell them apart, and what they do.
#include <doctest/doctest.h>

#include <rye/io/safetensors.hpp>

#include "../support/hostile.hpp"
#include "../support/tiny_mesh.hpp"
#include "data/config_difference.hpp"
#include "tiny_run.hpp"
#include "training/steps.hpp"

using namespace rye;
using namespace rye::trainer;
using Json = nlohmann::ordered_json;

namespace {

/// Returns the greatest distance of the eyes' Gaussians from their eyeball's centre.
double farthest_of_eyes(bool bulge) {
    TrainState s = tiny_state();
    s.stage = Stage::mesh;
    s.config.grid.half_side = 1.6;
    s.config.grid.cell = 0.4;
    s.config.grid.subdivide = false;
    s.config.gaussians.spacing = 0;
    s.config.gaussians.eyeball.points = 400;
    s.config.gaussians.eyeball.bulge = bulge;
    s.mesh = test::lifted<float>(test::tiny_mesh());
    begin_avatar(s, make_lattice(s));
    return s.avatar.eyes.position.colwise().norm().maxCoeff();
}

} // namespace

TEST_CASE("paper: it differs from paper-literal in these fields alone") {
    const Json literal = {{"preset", "paper-literal"},
                          {"avatar", {{"eye_appearance", "free"}}},
                          {"mesh", {{"weights", {{"laplacian_unit", "world"}}}}},
                          {"gaussians",
                           {{"epochs_over", "frames"},
                            {"eyeball", {{"bulge", false}}},
                            {"upsampler", {{"doublings", 2}}}}}};
    Json changed = to_json(preset("paper"));
    CHECK(first_difference(to_json(preset("paper-literal")), changed) != "");
    changed.merge_patch(literal);
    CHECK(first_difference(to_json(preset("paper-literal")), changed) == "");
    CHECK(to_json(preset("paper"))["avatar"]["eye_appearance"] == "driven");
    CHECK(to_json(preset("paper"))["mesh"]["weights"]["laplacian_unit"] == "metre");
    CHECK(to_json(preset("paper"))["gaussians"]["epochs_over"] == "pictures");
    CHECK(to_json(preset("paper"))["gaussians"]["eyeball"]["bulge"] == true);
    CHECK(to_json(preset("paper"))["gaussians"]["upsampler"]["doublings"] == "auto");
}

TEST_CASE("paper: the short presets have the readings of paper-literal, but for the Laplacian's unit") {
    for (const char* name : {"tiny", "cpu", "gpu"}) {
        CAPTURE(name);
        const TrainConfig c = preset(name);
        CHECK(c.mesh.weights.laplacian_unit == LaplacianUnit::metre);
        CHECK(c.gaussians.epochs_over == EpochsOver::frames);
        CHECK_FALSE(c.gaussians.eyeball.bulge);
        CHECK_FALSE(c.gaussians.auto_doublings);
    }
    CHECK_FAULT(preset("papers"), "got 'papers', expected tiny, cpu, gpu, paper or paper-literal");
}

TEST_CASE("paper: a checkpoint without the fields means what it meant") {
    const TemporaryFolder folder;
    std::filesystem::create_directories(folder.path / "run");
    TrainState state = tiny_state();
    state.config.mesh.weights.laplacian_unit = LaplacianUnit::world;
    save_checkpoint(folder.path / "run", state);
    Safetensors file = read_safetensors(checkpoint_path(folder.path / "run"));
    TensorMetadata words = file.metadata();
    Json config = Json::parse(words.at("config"));
    config["mesh"].erase("epochs_over");
    config["mesh"]["weights"].erase("laplacian_unit");
    config["gaussians"].erase("epochs_over");
    config["gaussians"]["eyeball"].erase("bulge");
    words["config"] = config.dump();
    std::vector<TensorEntry> entries;
    for (const auto& [name, entry] : file.tensors()) entries.push_back(entry);
    write_safetensors(checkpoint_path(folder.path / "run"), entries, words);
    CHECK(to_json(load_checkpoint(folder.path / "run").config) == to_json(state.config));
}

TEST_CASE("paper: renders have 512 pixels or more where the photographs have") {
    const auto doublings = [](int width, int height) {
        TrainConfig c = preset("paper");
        choose_doublings(c, width, height);
        CHECK_FALSE(c.gaussians.auto_doublings);
        CHECK(to_json(c)["gaussians"]["upsampler"]["doublings"] == c.gaussians.upsampler.doublings);
        return c.gaussians.upsampler.doublings;
    };
    CHECK(doublings(16, 16) == 0);
    CHECK(doublings(512, 512) == 0);
    CHECK(doublings(1023, 512) == 0);
    CHECK(doublings(512, 1024) == 1);
    CHECK(doublings(2047, 2047) == 1);
    CHECK(doublings(2048, 2048) == 2);
    CHECK(doublings(4096, 2048) == 3);
    CHECK(doublings(32768, 32768) == 4);
    TrainConfig literal = preset("paper-literal");
    choose_doublings(literal, 512, 512);
    CHECK(literal.gaussians.upsampler.doublings == 2);
}

TEST_CASE("paper: doublings are a number or auto") {
    const auto read = [](const Json& value, const char* from) {
        TrainConfig c = preset(from);
        from_json({{"gaussians", {{"upsampler", {{"doublings", value}}}}}}, "x.json", c);
        return to_json(c)["gaussians"]["upsampler"]["doublings"];
    };
    CHECK(read("auto", "cpu") == "auto");
    CHECK(read(1, "paper") == 1);
    const std::string words = "x.json: field 'gaussians.upsampler.doublings': got ";
    CHECK_FAULT(read("Auto", "paper"), words + "\"Auto\", expected \"auto\" or a whole number");
    CHECK_FAULT(read(5, "paper"), words + "5, expected \"auto\" or a whole number from 0 to 4");
    CHECK_FAULT(read(1.5, "paper"), words + "1.5, expected");
}

TEST_CASE("paper: words of the new fields") {
    TrainConfig c = preset("paper");
    CHECK_FAULT(from_json({{"mesh", {{"weights", {{"laplacian_unit", "meter"}}}}}}, "x.json", c),
                "field 'mesh.weights.laplacian_unit': got \"meter\", expected \"metre\" or "
                "\"world\"");
    CHECK_FAULT(from_json({{"mesh", {{"epochs_over", 3}}}}, "x.json", c),
                "field 'mesh.epochs_over': got 3, expected \"frames\" or \"pictures\"");
    CHECK_FAULT(from_json({{"gaussians", {{"eyeball", {{"bulge", 1}}}}}}, "x.json", c),
                "field 'gaussians.eyeball.bulge': got 1, expected true or false");
}

TEST_CASE("paper: with the bulge the eyes' Gaussians stand out of the sphere, else none does") {
    const double radius = 0.12, plain = farthest_of_eyes(false), bulging = farthest_of_eyes(true);
    CHECK(plain < 1.001 * radius);
    CHECK(bulging > 1.05 * radius);
    CHECK(bulging < 1.25 * radius);
}
