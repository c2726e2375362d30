// SPDX-License-Identifier: Apache-2.0
#include "commands/info_effects.hpp"

#include <filesystem>
#include <fstream>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>
#include <rye/io/ply.hpp>

#include "../support/hostile.hpp"
#include "tiny_capture.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

std::string explained(const fs::path& scene, const std::string& bound = "1/255") {
    return explain_effects({scene.string(), "", bound, ""});
}

/// "yes" or "no": the decision for an effect.
std::string verdict(const std::string& text, const std::string& effect) {
    for (const std::string word : {"yes", "no "})
        if (text.find("  " + word + "  " + effect + " ") != std::string::npos)
            return word == "yes" ? "yes" : "no";
    return "nothing";
}

/// A cloud with bands of harmonics of a given size.
fs::path cloud_file(const fs::path& folder, const std::array<double, 3>& bands, double log_scale) {
    const Random random{8, 1};
    std::uint64_t k = 0;
    GaussianCloud<float> cloud(200, 3);
    GaussianCloud<float>::fields([&](const std::string&, Columns<float>& a) {
        for (Index i = 0; i < a.size(); ++i) a(i) = static_cast<float>(random.normal(k++));
    }, cloud);
    cloud.log_scale.array() = cloud.log_scale.array() * 0.1f + static_cast<float>(log_scale);
    for (Index c = 0; c < 3; ++c)
        for (Index j = 0; j < 15; ++j)
            cloud.sh_rest.row(15 * c + j) *=
                static_cast<float>(bands[j < 3 ? 0 : j < 8 ? 1 : 2]);
    const fs::path file = folder / "cloud.ply";
    std::ofstream out(file, std::ios::binary);
    write_ply(out, cloud);
    return file;
}

} // namespace

TEST_CASE("info --effects: a cloud drawn by the chosen effects is that of all, within the bound") {
    const TemporaryFolder folder;
    struct Case {
        std::array<double, 3> bands;
        std::string sh1, sh2, sh3;
    };
    for (const Case& c : {Case{{0, 0, 0}, "no", "no", "no"}, Case{{2e-4, 1e-4, 1e-4}, "no", "no", "no"},
                          Case{{0.1, 1e-4, 1e-4}, "yes", "no", "no"},
                          Case{{0.1, 0.1, 1e-4}, "yes", "yes", "no"},
                          Case{{0, 0, 0.1}, "yes", "yes", "yes"}})
        for (const double log_scale : {-1.5, -7.0}) {
            const std::string text = explained(cloud_file(folder.path, c.bands, log_scale));
            INFO(text);
            CHECK(verdict(text, "sh 1") == c.sh1);
            CHECK(verdict(text, "sh 2") == c.sh2);
            CHECK(verdict(text, "sh 3") == c.sh3);
            CHECK(verdict(text, "expression") == "no");
            CHECK(text.find(", within the bound\n") != std::string::npos);
        }
    // A coarse bound drops bands that a fine one keeps.
    const fs::path file = cloud_file(folder.path, {0.1, 0.02, 0.01}, -2);
    CHECK(verdict(explained(file, "1/1000"), "sh 3") == "yes");
    const std::string coarse = explained(file, "0.9");
    CHECK(verdict(coarse, "sh 1") == "no");
    CHECK(coarse.find(", within the bound\n") != std::string::npos);
}

TEST_CASE("info --effects: photographs call for their lens alone") {
    const TemporaryFolder folder;
    const auto with = [&](const std::string& k1) {
        std::ofstream(folder.path / "transforms.json")
            << R"({"w": 64, "h": 48, "k1": )" << k1 << R"(, "frames": [{}, {}]})";
        return explained(folder.path);
    };
    CHECK(verdict(with("0"), "lens distortion") == "no");
    const std::string text = with("-0.02");
    CHECK(verdict(text, "lens distortion") == "yes");
    CHECK(verdict(text, "left gaze") == "no");
    CHECK(text.find("2 photographs") != std::string::npos);
    CHECK(text.find("rye render --cameras") != std::string::npos);
    std::ofstream(folder.path / "transforms.json") << "{";
    CHECK_THROWS_AS(explained(folder.path), Error);
}

TEST_CASE("info --effects: a capture") {
    const TemporaryFolder folder;
    const TinyCapture capture(folder.path);
    const std::string text = explained(capture.folder);
    INFO(text);
    CHECK(verdict(text, "head pose") == "yes");
    CHECK(verdict(text, "sh 1") == "no");
    CHECK(verdict(text, "kappa") == "no");
    CHECK_THROWS_AS(explain_effects({}), Error);
    CHECK_THROWS_AS(explained(capture.folder, "2"), Error);
}
