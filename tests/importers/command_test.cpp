// SPDX-License-Identifier: Apache-2.0
// `rye import` as a user runs it: its summary ends with the verdict of `rye info`.
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

#include <doctest/doctest.h>
#include <CLI/CLI.hpp>

#include <rye/core/error.hpp>

#include "../support/hostile.hpp"
#include "commands/commands.hpp"
#include "comparison.hpp"
#include "data/folder_lock.hpp"
#include "data/json.hpp"
#include "sources.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

struct Outcome {
    std::string printed, fault;
    int code = 0; ///< of an error that is not a fault
};

Outcome run(std::vector<std::string> words) {
    CLI::App app{"rye"};
    add_import(app);
    std::reverse(words.begin(), words.end());
    std::ostringstream text;
    std::streambuf* const before = std::cout.rdbuf(text.rdbuf());
    Outcome o;
    try {
        app.parse(words);
    } catch (const CLI::RuntimeError& e) {
        o.code = e.get_exit_code();
    } catch (const CLI::ParseError& e) {
        o.fault = e.what();
    } catch (const Error& e) {
        o.fault = e.what();
    }
    std::cout.rdbuf(before);
    o.printed = text.str();
    return o;
}

/// A small capture of one camera as VHAP writes it, and a folder to import it to.
struct VhapSource {
    TemporaryFolder folder;
    std::string source = (folder.path / "source").string(), out = (folder.path / "out").string();

    VhapSource() {
        CaptureSettings s = small_settings();
        s.cameras = 1;
        write_vhap_source(true_scene(folder.path / "truth", s), source);
    }
};

} // namespace

TEST_CASE("import: the summary has what was found, derived and missing, and the verdict") {
    const VhapSource vhap;
    const std::string &source = vhap.source, &out = vhap.out;
    const Outcome o = run({"import", "vhap", source, "--out", out});
    INFO(o.fault, o.printed);
    CHECK(o.fault.empty());
    for (const char* words :
         {"frames    4 (4 written now, 0 complete before), 1 cameras\n", "found     4 pictures",
          "derived   gaze of both eyes from eyes_pose\n", "angle kappa between optical and visual axis\n",
          "warning   ", "1 camera: sides of the head that no image shows", "verdict   usable\n"})
        CHECK(o.printed.find(words) != std::string::npos);
    CHECK(run({"import", "vhap", source, "--out", out})
              .printed.find("frames    4 (0 written now, 4 complete before)") == 0);
    CHECK(run({"import", "vhap", source, "--out", out, "--quiet"}).printed.empty());
}

TEST_CASE("import: a verdict of errors is an exit code of 1, quiet or not") {
    const VhapSource vhap;
    const std::string &source = vhap.source, &out = vhap.out;
    CHECK(run({"import", "vhap", source, "--out", out, "--quiet"}).code == 0);
    fs::remove(fs::path(out) / "params/00000/lmk_3d.npy"); // complete frames are not written again
    const Outcome o = run({"import", "vhap", source, "--out", out});
    INFO(o.printed);
    CHECK(o.fault.empty());
    CHECK(o.printed.find(": not usable") != std::string::npos);
    CHECK(o.code == 1);
    CHECK(run({"import", "vhap", source, "--out", out, "--quiet"}).code == 1);
}

TEST_CASE("import: into a folder that another import has it writes nothing, and says who has it") {
    const VhapSource vhap;
    const std::vector<std::string> words{"import", "vhap", vhap.source, "--out", vhap.out, "--quiet"};
    fs::create_directories(vhap.out);
    {
        const FolderLock other(vhap.out, {"rye import"});
        CHECK(run(words).fault.find("out: is in use by rye import, process ") != std::string::npos);
        CHECK_FALSE(fs::exists(fs::path(vhap.out) / "import.json"));
    }
    const Outcome o = run(words);
    CHECK(o.fault == "");
    CHECK(o.code == 0);
}

TEST_CASE("import: what its own record holds is refused by file, frame and fact") {
    const VhapSource vhap;
    const std::string &source = vhap.source, &out = vhap.out;
    run({"import", "vhap", source, "--out", out, "--quiet"});
    const fs::path record = fs::path(out) / "import.json";
    nlohmann::json json = read_json(record);
    json.at("frames").at("00000")["off"] = "much";
    std::ofstream(record) << json;
    CHECK(run({"import", "vhap", source, "--out", out}).fault.find(
              "import.json: field 'checksum': is not that of the other fields") !=
          std::string::npos);
    json.erase("checksum"); // as a file of an older version
    std::ofstream(record) << json;
    CHECK(run({"import", "vhap", source, "--out", out}).fault.find(
              "import.json: frames.\"00000\".\"off\": got \"much\", expected a number from 0 to "
              "below 1e9") != std::string::npos);
}

TEST_CASE("import: wrong words on the command line") {
    const TemporaryFolder folder;
    const std::string out = (folder.path / "out").string();
    CHECK(run({"import"}).fault == "rye import: a kind of source is missing, expected vhap, gha, "
                                   "xgaze, colmap or transforms");
    // The kind is blamed, not the option after it.
    const std::string kinds = "for the kind of source, expected vhap, gha, xgaze, colmap or "
                              "transforms";
    CHECK(run({"import", "flame", "x", "--out", out}).fault ==
          "rye import: got 'flame' " + kinds);
    CHECK(run({"import", "--out", out}).fault == "rye import: got '--out' " + kinds);
    CHECK(run({"import", "--bogus", "vhap", "x", "--out", out}).fault ==
          "rye import: got '--bogus' " + kinds);
    CHECK(run({"import", "vhap", "x", "more", "--out", out}).fault.find("more") !=
          std::string::npos);
    CHECK(run({"import", "vhap", "x"}).fault.find("--out is required") != std::string::npos);
    CHECK(run({"import", "vhap", "x", "--out", out, "--gaze", "g.csv"}).fault.find("--gaze") !=
          std::string::npos);
    for (const char* kind : {"vhap", "gha", "xgaze", "colmap", "transforms"}) {
        const Outcome o = run({"import", kind, (folder.path / "none").string(), "--out", out});
        CHECK(o.fault.find("none: no such file or folder") != std::string::npos);
        CHECK(!fs::exists(out));
    }
}
