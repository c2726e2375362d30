// SPDX-License-Identifier: Apache-2.0
#include "data/experiments.hpp"

#include <algorithm>
#include <functional>
#include <map>

#include <rye/core/error.hpp>

#include "data/json.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;

/// Returns the paper's losses alone, as fields of a configuration.
Json paper_losses() {
    const Json all = to_json(preset("paper"))["gaussians"]["weights"];
    return {{"gaussians", {{"weights", all}}}};
}

/// Returns the losses with some weights of stage 2 replaced.
Json with_weights(Json losses, const Json& weights) {
    losses["gaussians"]["weights"].update(weights);
    return losses;
}

Experiment mechanisms() {
    Experiment e{"mechanisms", "Gaze mechanisms, all else the same (table 1 of the paper)"};
    const auto row = [&](const char* name, const char* mechanism) {
        e.rows.push_back({name, mechanism, {{"avatar", {{"gaze_mechanism", mechanism}}}}});
    };
    row("explicit rotation", "rotation");
    row("rotated features", "feature_rotation");
    row("gaze as a condition", "condition");
    row("rotated latent code", "latent_rotation");
    row("learned quaternion", "learned_quaternion");
    row("none", "none");
    e.base = {{"avatar", {{"eye_appearance", "free"}}}}; // other mechanisms have no driven eyes
    e.columns = {"head_ssim",           "head_psnr", "lpips",      "face_ssim",
                 "face_psnr",           "eyes_psnr", "gaze",       "gaze_where_found",
                 "gaze_without_labels", "irises",    "judge_gaze", "judge_identity"};
    return e;
}

Experiment losses() {
    Experiment e{"losses",
                 "Losses of stage 2 (table 2 of the paper), and additions to the paper's"};
    const Json paper = paper_losses();
    const auto row = [&](const std::string& name, const std::string& run, const Json& weights) {
        e.rows.push_back({name, run, with_weights(paper, weights)});
    };
    const Json no_eyeball = {{"eye_low", 0}, {"eye_high", 0}};
    row("losses of the paper", "losses_paper", Json::object());
    row("without eyeball loss", "losses_no_eyeball", no_eyeball);
    row("without blank loss", "losses_no_blank", {{"blank", 0}});
    Json neither = no_eyeball;
    neither["blank"] = 0;
    row("without both", "losses_neither", neither);
    // Additions to the paper, each alone: those of the preset.
    const Json ours = to_json(preset("cpu"))["gaussians"]["weights"];
    const auto added = [&](const std::string& name, const std::string& field) {
        row("paper's + " + name, "losses_and_" + field, {{field, ours[field]}});
    };
    added("structure of the final image", "dssim");
    added("face alone", "face_alone");
    added("smooth eyes", "eye_smooth");
    added("high-resolution eye term in every third step", "eye_high_every");
    e.rows.push_back({"the preset", "rye", Json::object()});
    e.columns = {"head_ssim",        "head_psnr",           "eyes_psnr", "gaze",
                 "gaze_where_found", "gaze_without_labels", "irises",    "judge_gaze"};
    return e;
}

Experiment deformation() {
    Experiment e{"deformation",
                 "Gaze-guided deformation of the skin (table 3 of the paper), on eye "
                 "crops with the eyeballs painted white"};
    e.rows.push_back({"with", "rye", Json::object()});
    e.rows.push_back(
        {"without", "no_deformation", {{"avatar", {{"gaze_near", 0}, {"gaze_far", 0}}}}});
    e.columns = {"skin_ssim",        "skin_psnr",           "eyes_psnr", "gaze",
                 "gaze_where_found", "gaze_without_labels", "irises",    "judge_gaze",
                 "judge_blink",      "judge_coefficients"};
    return e;
}

struct BuiltIn {
    const char* name;
    Experiment (*make)();
};
constexpr BuiltIn built_in[] = {
    {"mechanisms", mechanisms}, {"losses", losses}, {"deformation", deformation}};

std::string listed(const std::vector<std::string>& words) {
    std::string text;
    for (std::size_t i = 0; i < words.size(); ++i)
        text += (i == 0 ? "" : i + 1 == words.size() ? " or " : ", ") + words[i];
    return text;
}

/// Fields of a JSON object, all of which must be known.
class Fields {
  public:
    Fields(const Json& json, std::string who, std::string path)
        : json_(json),
          who_(std::move(who)),
          path_(std::move(path)) {
        if (!json.is_object()) fail("", json, "an object");
    }
    /// Calls read(value, where) if the field is there.
    template <class F>
    bool read(const std::string& name, F&& read) {
        known_.push_back(name);
        const auto found = json_.find(name);
        if (found == json_.end()) return false;
        read(*found, path_ + name);
        return true;
    }
    void text(const std::string& name, std::string& to, bool needed = false) {
        const bool there = read(name, [&](const Json& v, const std::string&) {
            if (!v.is_string() || v.get<std::string>().empty()) fail(name, v, "a word");
            to = v.get<std::string>();
        });
        require(there || !needed, who_, "field '", path_, name, "' is missing");
    }
    void object(const std::string& name, Json& to) {
        read(name, [&](const Json& v, const std::string&) {
            if (!v.is_object()) fail(name, v, "an object");
            to = v;
        });
    }
    template <class F>
    void list(const std::string& name, F&& each, bool needed = false) {
        const bool there = read(name, [&](const Json& v, const std::string& where) {
            if (!v.is_array() || v.empty()) fail(name, v, "a list that is not empty");
            for (std::size_t i = 0; i < v.size(); ++i)
                each(v[i], where + "[" + std::to_string(i) + "]");
        });
        require(there || !needed, who_, "field '", path_, name, "' is missing");
    }
    void all_known() const {
        for (const auto& [key, value] : json_.items())
            require(std::find(known_.begin(), known_.end(), key) != known_.end(), who_, "field '",
                    path_, key, "' is unknown, expected ", [&] { return listed(known_); });
    }
    [[noreturn]] void fail(const std::string& name, const Json& got,
                           const std::string& expected) const {
        const std::string text = got.is_structured()
                                     ? (got.is_array() ? "a list" : "an object")
                                     : got.dump(-1, ' ', true, Json::error_handler_t::replace);
        throw Error(who_ + ": field '" + path_ + name + "': got " + text.substr(0, 60) +
                    ", expected " + expected);
    }

  private:
    const Json& json_;
    std::string who_, path_;
    std::vector<std::string> known_;
};

void check_names(const Experiment& e, const std::string& who) {
    for (std::size_t i = 0; i < e.rows.size(); ++i)
        for (std::size_t k = 0; k < i; ++k)
            require(e.rows[i].name != e.rows[k].name, who, "field 'rows[", i, "].name': got '",
                    e.rows[i].name, "', which rows[", k, "] has already");
}

} // namespace

const std::vector<Metric>& all_metrics() {
    static const std::vector<Metric> all{
        {"head_ssim", "SSIM, head", "/head/ssim", 3},
        {"head_psnr", "PSNR, head [dB]", "/head/psnr", 2},
        {"head_psnr_full_image", "PSNR, white outside the head [dB]", "/head/psnr_full_image", 2},
        {"face_ssim", "SSIM, face", "/face/ssim", 3},
        {"face_psnr", "PSNR, face [dB]", "/face/psnr", 2},
        {"eyes_ssim", "SSIM, eyes", "/eyes/ssim", 3},
        {"eyes_psnr", "PSNR, eyes [dB]", "/eyes/psnr", 2},
        {"skin_ssim", "SSIM, eye crops, eyeballs white", "/eyes_painted_white/ssim", 3},
        {"skin_psnr", "PSNR, eye crops, eyeballs white [dB]", "/eyes_painted_white/psnr", 2},
        {"lids_psnr", "PSNR, lids' margins [dB]", "/lid_margins/psnr", 2},
        {"lpips", "LPIPS", "/lpips", 3},
        {"gaze", "gaze error [deg]", "/gaze/render/degrees", 2},
        {"gaze_where_found", "gaze error where found [deg]", "/gaze/render/degrees_where_found", 2},
        {"gaze_to_label", "gaze to label [deg]", "/gaze/render/degrees_to_label", 2},
        {"gaze_without_labels", "gaze error without labels [deg]",
         "/gaze_without_labels/render/degrees", 2},
        {"irises", "irises found [%]", "", 1},
        {"judge_gaze", "judge: gaze [deg]", "/judge/gaze/degrees", 2},
        {"judge_irises", "judge: irises [% of an eye's width]", "/judge/irises", 2},
        {"judge_blink", "judge: eyeBlink", "/judge/blink", 3},
        {"judge_landmarks", "judge: landmarks [% of the eyes' distance]", "/judge/landmarks", 2},
        {"judge_coefficients", "judge: 52 coefficients", "/judge/coefficients", 3},
        {"judge_identity", "judge: identity", "/judge/identity", 3},
    };
    return all;
}

const std::vector<std::string>& built_in_experiments() {
    static const std::vector<std::string> names = [] {
        std::vector<std::string> n;
        for (const BuiltIn& b : built_in) n.emplace_back(b.name);
        return n;
    }();
    return names;
}

Experiment built_in_experiment(const std::string& name) {
    for (const BuiltIn& b : built_in)
        if (name == b.name) return b.make();
    throw Error("--table: got '" + name + "', expected " + listed(built_in_experiments()));
}

std::string folder_name(const std::string& name) {
    std::string folder = name;
    for (char& c : folder)
        if (!((c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
              c == '-' || c == '.'))
            c = '_';
    return folder;
}

Experiment read_experiment(const std::filesystem::path& path) {
    return parse_experiment(as_text(read_file(path, max_json_bytes)), path);
}

Experiment parse_experiment(std::string_view text, const std::filesystem::path& path) {
    const std::string who = path.string();
    const Json json = parse_json_text<Json>(text, who, JsonComments::skipped);
    Experiment e;
    e.name = folder_name(path.stem().string());
    e.title = path.stem().string();
    Fields f(json, who, "");
    f.text("title", e.title);
    f.text("preset", e.preset);
    try {
        preset(e.preset);
    } catch (const Error& error) {
        throw Error(who + ": " + error.what());
    }
    f.object("base", e.base);
    f.list("captures", [&](const Json& v, const std::string& where) {
        require(
            v.is_string(), who, "field '", where, "': got ", [&] { return v.dump(); },
            ", expected a folder");
        const std::filesystem::path folder = v.get<std::string>();
        e.captures.push_back(folder.is_absolute() ? folder : path.parent_path() / folder);
    });
    f.list("seeds", [&](const Json& v, const std::string& where) {
        require(
            v.is_number_unsigned(), who, "field '", where, "': got ", [&] { return v.dump(); },
            ", expected a whole number below 2^64");
        e.seeds.push_back(v.get<std::uint64_t>());
    });
    f.list("columns", [&](const Json& v, const std::string& where) {
        std::vector<std::string> names;
        for (const Metric& m : all_metrics()) names.push_back(m.name);
        const auto name = v.is_string() ? v.get<std::string>() : std::string();
        require(
            std::find(names.begin(), names.end(), name) != names.end(), who, "field '", where,
            "': got ", [&] { return v.dump(); }, ", expected ", [&] { return listed(names); });
        e.columns.push_back(name);
    });
    f.list(
        "rows",
        [&](const Json& v, const std::string& where) {
            ExperimentRow row{"", "", Json::object()};
            Fields r(v, who, where + ".");
            r.text("name", row.name, true);
            row.run = folder_name(row.name);
            r.text("run", row.run);
            require(row.run == folder_name(row.run) && row.run.front() != '.', who, "field '",
                    where, ".run': got '", row.run,
                    "', expected letters, digits, '-', '_' and '.', no '.' first");
            r.object("config", row.config);
            r.all_known();
            e.rows.push_back(row);
        },
        true);
    f.all_known();
    if (e.columns.empty())
        for (const Metric& m : all_metrics()) e.columns.push_back(m.name);
    check_names(e, who);
    return e;
}

Json to_json(const Experiment& e) {
    Json rows = Json::array(), captures = Json::array();
    for (const ExperimentRow& r : e.rows)
        rows.push_back({{"name", r.name}, {"run", r.run}, {"config", r.config}});
    for (const std::filesystem::path& c : e.captures) captures.push_back(c.string());
    Json json = {{"title", e.title}, {"preset", e.preset}, {"base", e.base}};
    if (!captures.empty()) json["captures"] = captures;
    if (!e.seeds.empty()) json["seeds"] = e.seeds;
    json["columns"] = e.columns;
    json["rows"] = rows;
    return json;
}

void configure(Experiment& e, const ExperimentSettings& settings) {
    if (!settings.preset.empty()) e.preset = settings.preset;
    std::map<std::string, std::pair<std::string, std::string>> runs; // configuration, row
    for (ExperimentRow& row : e.rows) {
        const std::string who = e.name + ": row '" + row.name + "'";
        row.effective = preset(e.preset);
        from_json(e.base, e.name + ": base", row.effective);
        if (!settings.base.is_null()) from_json(settings.base, settings.base_source, row.effective);
        from_json(row.config, who, row.effective);
        row.effective.seed = settings.seed;
        const std::string text = to_json(row.effective).dump();
        const auto [other, fresh] = runs.try_emplace(row.run, text, row.name);
        require(fresh || other->second.first == text, who, "its run '", row.run,
                "' is that of row '", other->second.second, "', whose configuration differs");
    }
}

} // namespace rye::trainer
