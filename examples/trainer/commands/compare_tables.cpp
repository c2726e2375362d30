// SPDX-License-Identifier: Apache-2.0
#include "commands/compare_tables.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <string_view>

#include <rye/core/checksum.hpp>
#include <rye/core/error.hpp>

#include "commands/number.hpp"
#include "data/checksums.hpp"
#include "data/json_fields.hpp"
#include "data/panel.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

/// Returns a word for a CSV file, quoted if necessary.
std::string csv_word(const std::string& word) {
    if (word.find_first_of(",\"\n") == std::string::npos) return word;
    std::string out = "\"";
    for (const char c : word) out += c == '"' ? "\"\"" : std::string(1, c);
    return out + "\"";
}

const Metric& metric_named(std::string_view name) {
    for (const Metric& m : all_metrics())
        if (m.name == name) return m;
    throw Error("rye compare: got the column '" + std::string(name) + "', which is no metric");
}

/// Groups of results.json, with their names in a table.
constexpr std::array<std::array<const char*, 2>, 3> metric_groups{
    {{"all", "all frames"}, {"novel gaze", "new directions"}, {"independent eyes", "eyes apart"}}};

const nlohmann::json* group_of(const ComparedRun& run, const std::string& group) {
    if (!run.results.is_object()) return nullptr;
    const auto found = run.results.find(group);
    return found == run.results.end() ? nullptr : &*found;
}

/// Returns the photograph and the render of a picture that rye evaluate put side by side.
std::array<Image<float>, 2> photograph_and_render(const fs::path& path) {
    const Image<float> all = to_float(read_image8(path, 3));
    return {row_part(all, 0, 3), row_part(all, 1, 3)};
}

/// Returns a picture's part around a rectangle, enlarged to the picture's width.
Image<float> close_up(const Image<float>& picture, const std::array<int, 4>& box) {
    const auto [x, y, w, h] = box;
    const int zoom = std::clamp(picture.width / std::max(w, 1), 1, 8);
    const int width = picture.width / zoom, height = std::min(h + 4, picture.height);
    const int left = std::clamp(x + w / 2 - width / 2, 0, picture.width - width);
    const int top = std::clamp(y + h / 2 - height / 2, 0, picture.height - height);
    const Image<float> part = enlarged(cropped(picture, left, top, width, height), width * zoom);
    Image<float> out(picture.width, part.height, part.channels(), 1.0f);
    for (int row = 0; row < part.height; ++row)
        for (int column = 0; column < part.width; ++column)
            out.at(column, row) = part.at(column, row);
    return out;
}

} // namespace

std::map<std::string, std::array<int, 4>> eye_boxes(const fs::path& evaluation) {
    std::map<std::string, std::array<int, 4>> boxes;
    const fs::path path = evaluation / "per_view.json";
    if (!fs::exists(path)) return boxes;
    const std::string name = path.string();
    const Bytes bytes = read_file(path, max_json_bytes);
    const fs::path stated = evaluation / "results.json";
    const nlohmann::json results = fs::exists(stated) ? read_json(stated) : nlohmann::json();
    if (results.is_object() && results.contains("per_view_checksum"))
        require(results.at("per_view_checksum") == checksum_text(crc32(bytes)), name,
                "its checksum is not the one in ", stated.string(), ": the file is damaged");
    for (const nlohmann::json& view : parse_json_text(as_text(bytes), name)) {
        if (!view.contains("picture") || !view.contains("eyes_box")) continue;
        const nlohmann::json& numbers = json_list(view, "eyes_box", name, "4 numbers");
        require(
            numbers.size() == 4, name + ": eyes_box", "got ", [&] { return json_excerpt(numbers); },
            ", expected 4 numbers");
        std::array<int, 4> box{};
        for (std::size_t i = 0; i < 4; ++i) {
            const double x = json_number(numbers.at(i), name + ": eyes_box");
            require(
                std::abs(x) <= max_image_edge, name + ": eyes_box", "got ",
                [&] { return json_excerpt(numbers); }, ", expected pixels of a picture");
            box[i] = static_cast<int>(x);
        }
        if (box[2] > 0) boxes[json_text(view, "picture", "", name)] = box;
    }
    return boxes;
}

nlohmann::json read_results(const fs::path& evaluation) {
    const fs::path path = evaluation / "results.json", judge = evaluation / "judge.json";
    nlohmann::json results =
        parse_checked_json(as_text(read_file(path, max_json_bytes)), path.string());
    if (!results.is_object() || !fs::exists(judge)) return results;
    const nlohmann::json judged = read_json(judge);
    require(
        judged.is_object(), judge.string(), "got ", [&] { return json_excerpt(judged); },
        ", expected an object");
    for (const auto& group : metric_groups)
        if (results.contains(group[0]) && results[group[0]].is_object() &&
            judged.contains(group[0]))
            results[group[0]]["judge"] = judged[group[0]];
    return results;
}

double Spread::mean() const {
    double sum = 0;
    for (const double v : values) sum += v;
    return values.empty() ? std::nan("") : sum / static_cast<double>(values.size());
}
double Spread::deviation() const {
    if (values.size() < 2) return 0;
    const double m = mean();
    double sum = 0;
    for (const double v : values) sum += (v - m) * (v - m);
    return std::sqrt(sum / static_cast<double>(values.size() - 1));
}
std::string Spread::text(int digits) const {
    if (values.empty()) return "-";
    const std::string m = number(mean(), digits);
    return values.size() < 2 ? m : m + " ± " + number(deviation(), digits);
}
Json Spread::json() const {
    if (values.empty()) return {{"mean", nullptr}, {"deviation", nullptr}, {"runs", 0}};
    return {{"mean", mean()}, {"deviation", deviation()}, {"runs", values.size()}};
}

std::vector<double> metric_of(const nlohmann::json& group, const Metric& metric) {
    const auto value = [&](const std::string& pointer) -> std::vector<double> {
        const nlohmann::json::json_pointer at(pointer);
        if (!group.contains(at) || !group.at(at).is_number()) return {};
        return {group.at(at).get<double>()};
    };
    if (!metric.pointer.empty()) return value(metric.pointer);
    const std::vector<double> found = value("/gaze/render/found"), of = value("/eyes_visible");
    if (found.empty() || of.empty() || of[0] <= 0) return {};
    return {100 * found[0] / of[0]};
}

ExperimentTables::ExperimentTables(const Experiment& experiment, std::vector<ComparedRun> runs)
    : experiment_(experiment),
      runs_(std::move(runs)) {}

std::vector<ExperimentTables::Part> ExperimentTables::parts() const {
    std::vector<std::string> captures;
    for (const ComparedRun& r : runs_)
        if (std::find(captures.begin(), captures.end(), r.capture) == captures.end())
            captures.push_back(r.capture);
    if (captures.size() > 1) captures.insert(captures.begin(), "");
    std::vector<Part> parts;
    for (const std::string& capture : captures)
        for (const auto& group : metric_groups)
            if (std::any_of(runs_.begin(), runs_.end(), [&](const ComparedRun& r) {
                    return (capture.empty() || r.capture == capture) &&
                           group_of(r, group[0]) != nullptr;
                }))
                parts.push_back({capture, group[0]});
    return parts;
}

Spread ExperimentTables::spread(const Part& part, std::size_t row, const Metric& metric) const {
    Spread s;
    for (const ComparedRun& r : runs_) {
        if (r.row != row || (!part.capture.empty() && r.capture != part.capture)) continue;
        if (const nlohmann::json* group = group_of(r, part.group))
            for (const double v : metric_of(*group, metric)) s.values.push_back(v);
    }
    return s;
}

Spread ExperimentTables::difference(const Part& part, std::size_t row, const Metric& metric) const {
    Spread s;
    const auto value = [&](const ComparedRun& r) -> std::vector<double> {
        const nlohmann::json* group = group_of(r, part.group);
        return group == nullptr ? std::vector<double>{} : metric_of(*group, metric);
    };
    for (const ComparedRun& r : runs_) {
        if (r.row != row || (!part.capture.empty() && r.capture != part.capture)) continue;
        for (const ComparedRun& first : runs_) {
            if (first.row != 0 || first.capture != r.capture || first.seed != r.seed) continue;
            const std::vector<double> here = value(r), there = value(first);
            if (!here.empty() && !there.empty()) s.values.push_back(here[0] - there[0]);
        }
    }
    return s;
}

std::string ExperimentTables::markdown() const {
    std::string out = "# " + experiment_.title + "\n";
    const Metric& gaze = metric_named("gaze");
    for (const Part& part : parts()) {
        const auto title = std::find_if(metric_groups.begin(), metric_groups.end(),
                                        [&](const auto& g) { return g[0] == part.group; });
        out += "\n## " + (part.capture.empty() ? "all captures" : part.capture) + ", " +
               (*title)[1] + "\n\n| |";
        std::string line = "|---|";
        std::vector<const Metric*> columns;
        for (const std::string& name : experiment_.columns) {
            const Metric& m = metric_named(name);
            bool any = false;
            for (std::size_t row = 0; row < experiment_.rows.size(); ++row)
                any = any || !spread(part, row, m).values.empty();
            if (any) columns.push_back(&m);
        }
        const bool gazes = std::find(columns.begin(), columns.end(), &gaze) != columns.end();
        for (const Metric* m : columns) out += " " + m->title + " |", line += "---|";
        if (gazes) out += " gaze error beyond the first row's [deg] |", line += "---|";
        out += " runs |\n" + line + "---|\n";
        for (std::size_t row = 0; row < experiment_.rows.size(); ++row) {
            std::size_t most = 0;
            out += "| " + experiment_.rows[row].name + " |";
            for (const Metric* m : columns) {
                const Spread s = spread(part, row, *m);
                most = std::max(most, s.values.size());
                out += " " + s.text(m->digits) + " |";
            }
            if (gazes)
                out += row == 0 ? " |" : " " + difference(part, row, gaze).text(gaze.digits) + " |";
            out += " " + std::to_string(most) + " |\n";
        }
    }
    out +=
        "\nMean ± sample standard deviation over the runs of a row: seeds, and captures where "
        "there are several. Differences are of runs with the same seed and capture. An eye in "
        "which no iris is found counts 90 degrees in a gaze error.\n";
    std::string absent, unjudged;
    for (const std::string& name : experiment_.columns) {
        bool any = false;
        for (const ComparedRun& r : runs_)
            for (const auto& g : metric_groups)
                if (const nlohmann::json* group = group_of(r, g[0]))
                    any = any || !metric_of(*group, metric_named(name)).empty();
        std::string& list = name.starts_with("judge_") ? unjudged : absent;
        if (!any) list += (list.empty() ? "" : ", ") + metric_named(name).title;
    }
    out += "\n";
    if (!absent.empty())
        out += "not run: " + absent +
               (absent.find("LPIPS") != std::string::npos ? ", which needs --perceptual-weights"
                                                          : "") +
               "\n";
    if (!unjudged.empty())
        out += "not run: " + unjudged + ": sh benchmarks/judge/judge.sh OUT, then this again\n";
    out += "not run: FID and the gaze network of the paper, whose weights are not rye's\n";
    for (const ComparedRun& r : runs_)
        if (!r.failure.empty())
            out += "not run: " + experiment_.rows[r.row].name + ", " + r.capture + ", seed " +
                   std::to_string(r.seed) + ": " + r.failure + "\n";
    return out;
}

std::string ExperimentTables::csv() const {
    std::string out = "table,capture,group,row,metric,mean,deviation,runs\n";
    for (const Part& part : parts())
        for (std::size_t row = 0; row < experiment_.rows.size(); ++row)
            for (const std::string& name : experiment_.columns) {
                const Spread s = spread(part, row, metric_named(name));
                if (s.values.empty()) continue;
                out += experiment_.name + "," +
                       csv_word(part.capture.empty() ? "all" : part.capture) + "," + part.group +
                       "," + csv_word(experiment_.rows[row].name) + "," + name + "," +
                       Json(s.mean()).dump() + "," + Json(s.deviation()).dump() + "," +
                       std::to_string(s.values.size()) + "\n";
            }
    return out;
}

std::string ExperimentTables::runs_csv() const {
    std::string out = "table,capture,row,seed,group,metric,value\n";
    for (const ComparedRun& r : runs_)
        for (const auto& g : metric_groups)
            if (const nlohmann::json* group = group_of(r, g[0]))
                for (const Metric& m : all_metrics())
                    for (const double v : metric_of(*group, m))
                        out += experiment_.name + "," + csv_word(r.capture) + "," +
                               csv_word(experiment_.rows[r.row].name) + "," +
                               std::to_string(r.seed) + "," + g[0] + "," + m.name + "," +
                               Json(v).dump() + "\n";
    return out;
}

Json ExperimentTables::json() const {
    Json tables = Json::array();
    for (const Part& part : parts()) {
        Json rows = Json::array();
        for (std::size_t row = 0; row < experiment_.rows.size(); ++row) {
            Json metrics = Json::object();
            for (const std::string& name : experiment_.columns)
                metrics[name] = spread(part, row, metric_named(name)).json();
            rows.push_back(
                {{"name", experiment_.rows[row].name},
                 {"metrics", metrics},
                 {"gaze_beyond_first", difference(part, row, metric_named("gaze")).json()}});
        }
        tables.push_back({{"capture", part.capture.empty() ? Json(nullptr) : Json(part.capture)},
                          {"group", part.group},
                          {"rows", rows}});
    }
    Json failed = Json::array();
    for (const ComparedRun& r : runs_)
        if (!r.failure.empty())
            failed.push_back({{"row", experiment_.rows[r.row].name},
                              {"capture", r.capture},
                              {"seed", r.seed},
                              {"reason", r.failure}});
    return {{"name", experiment_.name},
            {"title", experiment_.title},
            {"tables", tables},
            {"failed", failed}};
}

ContactSheet contact_sheet(const Experiment& experiment, const std::vector<ComparedRun>& runs,
                           const std::string& capture, const fs::path& pictures) {
    std::vector<fs::path> folders;
    ContactSheet sheet;
    for (std::size_t row = 0; row < experiment.rows.size(); ++row)
        for (const ComparedRun& r : runs) {
            if (r.row != row || r.capture != capture || !r.results.is_object()) continue;
            folders.push_back(r.folder / pictures);
            sheet.columns.push_back(experiment.rows[row].name);
            break;
        }
    if (folders.empty()) return sheet;
    sheet.columns.insert(sheet.columns.begin(), "photograph");
    std::error_code ignored;
    for (const fs::directory_entry& entry : fs::directory_iterator(folders.front(), ignored))
        sheet.frames.push_back(entry.path().filename().string());
    std::sort(sheet.frames.begin(), sheet.frames.end());
    const std::map<std::string, std::array<int, 4>> boxes = eye_boxes(folders.front().parent_path());
    std::vector<Image<float>> lines;
    for (const std::string& frame : sheet.frames) {
        std::vector<Image<float>> line;
        for (const fs::path& folder : folders) {
            auto [photograph, render] = photograph_and_render(folder / frame);
            if (line.empty()) line.push_back(std::move(photograph));
            line.push_back(std::move(render));
        }
        lines.push_back(side_by_side(line));
        const auto box = boxes.find(frame);
        if (box == boxes.end()) continue;
        for (Image<float>& picture : line) picture = close_up(picture, box->second);
        lines.push_back(side_by_side(line));
    }
    if (!lines.empty()) sheet.picture = stacked(lines);
    return sheet;
}

} // namespace rye::trainer
