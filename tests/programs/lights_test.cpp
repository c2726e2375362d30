// SPDX-License-Identifier: Apache-2.0
// `--lights` of commands that draw a run, and lights that `rye info` prints of it.
#include <doctest/doctest.h>

#include <fstream>
#include <string>
#include <vector>

#include <rye/io/avatar_file.hpp>

#include "../support/effect_sets.hpp"
#include "../support/file_bytes.hpp"
#include "command_line.hpp"
#include "tiny_scene.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

struct LitScene : TinyScene {
    fs::path out = folder.path / "out";

    LitScene() {
        TrainState state = load_checkpoint(run);
        test::set_tiny_lights(state.avatar.eyes.optics);
        state.avatar_adam = Adam<Avatar>(state.avatar);
        save_checkpoint(run, state);
    }
    fs::path write(const std::string& text) const {
        const fs::path file = folder.path / "lights.json";
        std::ofstream(file, std::ios::trunc) << text;
        return file;
    }
    /// Returns what a command writes for the run, to a name that ends in `kind`.
    std::string made(std::vector<std::string> words, const std::string& kind,
                     const fs::path& lights) const {
        const fs::path file = out.string() + kind;
        fs::remove_all(file);
        words.insert(words.end(),
                     {"--run", run.string(), "--out", file.string(), "--threads", "1"});
        if (!lights.empty()) words.insert(words.end(), {"--lights", lights.string()});
        const Answer a = answer(words);
        if (a.code != 0) {
            CHECK_FALSE(fs::exists(file));
            throw Error(a.text);
        }
        return bytes_of(file);
    }
    std::string drawn(const fs::path& lights) const { return made({"redirect"}, ".png", lights); }
};

const std::string other = R"([{"to": [0.2, 0.1, 1], "intensity": [0.9, 0.1, 0.1], "width": 1.5}])";

} // namespace

TEST_CASE("lights: a run's own, from what info prints, change no bit; others and none do") {
    const LitScene scene;
    const Answer info = answer({"info", "--json", "--run", scene.run.string()});
    REQUIRE(info.code == 0);
    const std::string own = scene.drawn({});
    CHECK(scene.drawn(scene.write(info.printed)) == own);
    const std::string red = scene.drawn(scene.write(other)), none = scene.drawn(scene.write("[]"));
    CHECK(red != own);
    CHECK(none != own);
    CHECK(red != none);
    const Answer text = answer({"info", "--run", scene.run.string()});
    CHECK(text.printed.find("a light") != std::string::npos);
}

TEST_CASE("lights: an exported avatar has them") {
    const LitScene scene;
    scene.made({"export", "--full-precision"}, ".avatar", scene.write(other));
    const auto lit = read_avatar<float>(fs::path(scene.out.string() + ".avatar"));
    const auto& optics = lit.avatar.eyes.optics;
    REQUIRE(optics.lights() == 1);
    CHECK(optics.light_width(0, 0) == 1.5f);
    CHECK(Vec3<float>(optics.light_intensity.col(0)) == Vec3<float>(0.9f, 0.1f, 0.1f));
    CHECK_FAULT(scene.made({"export"}, ".ply", scene.write(other)),
                "--lights: a splat file has no highlights, expected an .avatar");
}

TEST_CASE("lights: faults are told, and nothing is written") {
    const LitScene scene;
    const fs::path bad = scene.write(R"([{"to": [0, 0, 1], "intensity": [1, 1, 1], "width": -1}])");
    CHECK_FAULT(scene.drawn(bad), "lights.json: lights[0]: width: got -1 rad");
    const fs::path good = scene.write(other);
    CHECK_FAULT(scene.drawn(scene.folder.path / "none.json"), "none.json");
    const fs::path capture = scene.folder.path / "made";
    const auto render = [&](const fs::path& lights) {
        return answer({"capture", "--out", capture.string(), "--lights", lights.string(), "--size",
                       "32", "--frames", "1", "--test-frames", "0", "--apart-frames", "0"});
    };
    for (const char* field : {R"("intensity": [0.5, 0.9, 0], "width": 0.2)",
                              R"("intensity": [0.5, 0.5, 0], "width": 1.5)",
                              R"("intensity": [-0.5, 0.5, 0], "width": 0.2)"}) {
        CAPTURE(field);
        const Answer a = render(scene.write("[{\"to\": [0, 0, 1], " + std::string(field) + "}]"));
        CHECK(a.code == 2);
        CHECK(a.text.find("lights.json: lights[0]: ") != std::string::npos);
        CHECK_FALSE(fs::exists(capture));
    }
    const TinyScene plain;
    const Answer a = answer({"redirect", "--run", plain.run.string(), "--lights",
                             scene.write(other).string(), "--out", scene.out.string() + ".png"});
    CHECK(a.code == 2);
    CHECK(a.text.find("has no highlights, so --lights changes nothing") != std::string::npos);
}
