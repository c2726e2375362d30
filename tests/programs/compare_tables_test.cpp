// SPDX-License-Identifier: Apache-2.0
#include "commands/compare_tables.hpp"

#include <algorithm>
#include <fstream>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"
#include "data/panel.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

/// results.json as far as tables read it, of eyes that all count.
nlohmann::json results(double psnr, double gaze, int found, int visible) {
    const nlohmann::json group = {{"head", {{"psnr", psnr}, {"ssim", nullptr}}},
                                  {"gaze", {{"render", {{"degrees", gaze}, {"found", found}}}}},
                                  {"lpips", nullptr},
                                  {"eyes_visible", visible}};
    return {{"all", group}, {"novel gaze", group}};
}

/// Two rows, two seeds, one capture; the second row's second run failed.
struct Example {
    Experiment experiment{"mine", "Mine"};
    std::vector<ComparedRun> runs;
    Example() {
        experiment.rows = {{"first", "a", {}}, {"second, \"so\"", "b", {}}};
        experiment.columns = {"head_psnr", "head_ssim", "lpips", "gaze", "irises"};
        runs = {{0, "cap", 1, "", results(20, 4, 8, 10), ""},
                {0, "cap", 2, "", results(22, 7, 10, 10), ""},
                {1, "cap", 1, "", results(19.5, 10, 5, 10), ""},
                {1, "cap", 2, "", nullptr, "rye train: no"}};
    }
};

bool has(const std::string& text, const std::string& words) {
    INFO(text);
    const bool found = text.find(words) != std::string::npos;
    CHECK_MESSAGE(found, words);
    return found;
}

} // namespace

TEST_CASE("tables: the gaze error where irises are found has a column of its own") {
    const nlohmann::json group = {
        {"gaze", {{"render", {{"degrees", 48}, {"degrees_where_found", 6}}}}}};
    const nlohmann::json none = {
        {"gaze", {{"render", {{"degrees", 90}, {"degrees_where_found", nullptr}}}}}};
    bool there = false;
    for (const Metric& m : all_metrics()) {
        if (m.name != "gaze_where_found") continue;
        there = true;
        CHECK(metric_of(group, m) == std::vector<double>{6});
        CHECK(metric_of(none, m).empty());
    }
    CHECK(there);
}

TEST_CASE("tables: means, deviations and paired differences by hand") {
    const Example e;
    const ExperimentTables tables(e.experiment, e.runs);
    const std::string text = tables.markdown();
    has(text, "# Mine\n");
    has(text, "## cap, all frames");
    has(text, "## cap, new directions");
    CHECK(text.find("eyes apart") == std::string::npos);
    // Of 20 and 22: 21 and sqrt(2). Columns that no run has are left out, and named below.
    has(text,
        "| | PSNR, head [dB] | gaze error [deg] | irises found [%] | gaze error beyond the "
        "first row's [deg] | runs |");
    has(text, "| first | 21.00 ± 1.41 | 5.50 ± 2.12 | 90.0 ± 14.1 | | 2 |");
    // Of one run: no spread; its difference to the run with the same seed, 10 - 4.
    has(text, "| second, \"so\" | 19.50 | 10.00 | 50.0 | 6.00 | 1 |");
    has(text, "not run: SSIM, head, LPIPS, which needs --perceptual-weights");
    has(text, "not run: second, \"so\", cap, seed 2: rye train: no");

    has(tables.csv(), "\nmine,cap,all,first,head_psnr,21.0,1.4142135623730951,2\n");
    has(tables.csv(), "\nmine,cap,novel gaze,\"second, \"\"so\"\"\",gaze,10.0,0.0,1\n");
    has(tables.runs_csv(), "\nmine,cap,first,2,all,gaze,7.0\n");
    const nlohmann::ordered_json json = tables.json();
    CHECK(json["tables"].size() == 2);
    CHECK(json["tables"][0]["rows"][0]["metrics"]["gaze"]["mean"] == 5.5);
    CHECK(json["tables"][0]["rows"][1]["gaze_beyond_first"]["mean"] == 6.0);
    CHECK(json["tables"][0]["rows"][0]["metrics"]["lpips"]["mean"].is_null());
    CHECK(json["failed"].size() == 1);
}

TEST_CASE("tables: several captures have a table each, and one together") {
    Example e;
    e.runs[3] = {0, "other", 1, "", results(30, 1, 10, 10), ""};
    const nlohmann::ordered_json json = ExperimentTables(e.experiment, e.runs).json();
    REQUIRE(json["tables"].size() == 6);
    CHECK(json["tables"][0]["capture"].is_null());
    CHECK(json["tables"][0]["rows"][0]["metrics"]["head_psnr"]["mean"] == 24.0);
    CHECK(json["tables"][0]["rows"][0]["metrics"]["head_psnr"]["runs"] == 3);
    CHECK(json["tables"][4]["capture"] == "other");
    CHECK(json["tables"][4]["rows"][1]["gaze_beyond_first"]["runs"] == 0);
}

TEST_CASE("tables: the judge's numbers are columns where there is a judge.json") {
    const TemporaryFolder folder;
    const auto write = [&](const char* name, const std::string& text) {
        std::ofstream(folder.path / name) << text;
    };
    Example e;
    e.experiment.columns = {"head_psnr", "judge_gaze", "judge_landmarks"};
    write("results.json", results(20, 4, 8, 10).dump());
    e.runs.resize(1);
    e.runs[0].results = read_results(folder.path);
    has(ExperimentTables(e.experiment, e.runs).markdown(),
        "not run: judge: gaze [deg], judge: landmarks [% of the eyes' distance]: sh ");

    // Of the groups that both have; a number that was not measured is a missing column.
    write("judge.json", R"({"split": "test", "not_run": [], "all":
        {"gaze": {"degrees": 6.25, "eyes": 3}, "landmarks": null}, "eyes": {"gaze": 1}})");
    e.runs[0].results = read_results(folder.path);
    CHECK(e.runs[0].results["all"]["judge"]["gaze"]["degrees"] == 6.25);
    CHECK_FALSE(e.runs[0].results["novel gaze"].contains("judge"));
    CHECK_FALSE(e.runs[0].results.contains("eyes"));
    const std::string text = ExperimentTables(e.experiment, e.runs).markdown();
    has(text, "| | PSNR, head [dB] | judge: gaze [deg] | runs |");
    has(text, "| first | 20.00 | 6.25 | 1 |");
    has(text, "not run: judge: landmarks [% of the eyes' distance]: sh ");

    write("judge.json", "[1]");
    CHECK_THROWS_WITH_AS(read_results(folder.path),
                         doctest::Contains("judge.json: got [1], expected an object"), Error);
}

TEST_CASE("contact sheet: the photograph, then each row's render") {
    const TemporaryFolder folder;
    const auto grey = [](float v) { return Image<float>(6, 4, 3, v); };
    Example e;
    for (std::size_t k = 0; k < 4; ++k) {
        e.runs[k].folder = folder.path / std::to_string(k);
        std::filesystem::create_directories(e.runs[k].folder / "evaluate_test");
        write_png(e.runs[k].folder / "evaluate_test" / "frame_7.png",
                  side_by_side({grey(1), grey(0.2f * static_cast<float>(k)), grey(0.9f)}));
    }
    const ContactSheet sheet = contact_sheet(e.experiment, e.runs, "cap", "evaluate_test");
    CHECK(sheet.columns == std::vector<std::string>{"photograph", "first", "second, \"so\""});
    CHECK(sheet.frames == std::vector<std::string>{"frame_7.png"});
    CHECK(sheet.picture.height == 4);
    for (int k = 0; k < 3; ++k)
        CHECK(row_part(sheet.picture, k, 3).at(2, 2)(0) == doctest::Approx(k == 0   ? 1
                                                                           : k == 1 ? 0
                                                                                    : 0.4)
                                                               .epsilon(0.01));
    CHECK(contact_sheet(e.experiment, e.runs, "nowhere", "x").picture.size() == 0);
    // With the place of the eyes there is a line of close-ups: 2 of 6 columns, three times as large.
    std::ofstream(e.runs[0].folder / "per_view.json")
        << R"([{"picture": "frame_7.png", "eyes_box": [3, 1, 2, 1]}, {"frame": "7"}])";
    const ContactSheet close = contact_sheet(e.experiment, e.runs, "cap", "evaluate_test");
    CHECK(close.picture.width == sheet.picture.width);
    CHECK(close.picture.height == 4 + 2 + 12);
    CHECK(row_part(close.picture, 2, 3).at(2, 10)(0) == doctest::Approx(0.4).epsilon(0.01));
    CHECK_FAULT(row_part(Image<float>(8, 2, 3), 0, 3), "width 8");
}

TEST_CASE("lists: the built-in ones are valid for each preset, and come back from JSON") {
    const TemporaryFolder folder;
    for (const std::string& name : built_in_experiments()) {
        INFO(name);
        Experiment e = built_in_experiment(name);
        for (const std::string& preset : preset_names()) {
            configure(e, {preset, nullptr, "", 7});
            for (const ExperimentRow& row : e.rows) CHECK(row.effective.seed == 7);
        }
        const std::filesystem::path path = folder.path / (name + ".json");
        std::ofstream(path) << to_json(e).dump();
        CHECK(to_json(read_experiment(path)) == to_json(e));
    }
    // Rows differ from each other in what their run trains.
    Experiment losses = built_in_experiment("losses");
    configure(losses, {"cpu", nullptr, "", 1});
    for (std::size_t i = 0; i < losses.rows.size(); ++i)
        for (std::size_t k = 0; k < i; ++k) {
            INFO(losses.rows[i].name << " and " << losses.rows[k].name);
            CHECK(to_json(losses.rows[i].effective) != to_json(losses.rows[k].effective));
        }
    CHECK(losses.rows[0].effective.gaussians.weights.blank == 1);
    CHECK(losses.rows[2].effective.gaussians.weights.blank == 0);
    CHECK(losses.rows[3].effective.gaussians.weights.eye_low == 0);
    CHECK(losses.rows.back().effective.gaussians.weights.face_alone == 1);
    Experiment deformation = built_in_experiment("deformation");
    configure(deformation, {"cpu", nullptr, "", 1});
    CHECK(deformation.rows[1].effective.avatar.gaze_far == 0);
}

TEST_CASE("lists: what all rows are given is given before what the row says") {
    Experiment e = built_in_experiment("deformation");
    const nlohmann::ordered_json base = {{"avatar", {{"gaze_far", 0.5}}},
                                         {"gaussians", {{"steps", 9}}}};
    configure(e, {"tiny", base, "base.json", 1});
    CHECK(e.rows[0].effective.avatar.gaze_far == 0.5);
    CHECK(e.rows[1].effective.avatar.gaze_far == 0);
    CHECK(e.rows[1].effective.gaussians.steps == 9);
    CHECK_FAULT(configure(e, {"tiny", {{"avatar", {{"gaze_fra", 1}}}}, "base.json", 1}),
                "base.json: field 'avatar.gaze_fra' is unknown");
    e.rows[1].run = e.rows[0].run;
    CHECK_FAULT(configure(e, {"tiny", nullptr, "", 1}), "its run 'rye' is that of row 'with'");
}
