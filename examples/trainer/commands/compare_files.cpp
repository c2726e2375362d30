// SPDX-License-Identifier: Apache-2.0
/// Files of a ComparePlan's tables.
#include <iostream>

#include "commands/compare_plan.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

std::vector<ComparedRun> results_of(ComparePlan& plan, const Experiment& e) {
    std::vector<ComparedRun> all;
    for (std::size_t row = 0; row < e.rows.size(); ++row)
        for (const fs::path& capture : plan.captures_of(e))
            for (const std::uint64_t seed : plan.seeds_of(e)) {
                const std::string name = name_of(capture);
                const PlannedRun& run = plan.run_of(name, e.rows[row], seed);
                ComparedRun c{row,     name,       seed, plan.evaluation_folder(run.folder),
                              nullptr, run.failure};
                if (run.failure.empty() && plan.is_complete(run))
                    c.results = read_results(plan.evaluation_folder(run.folder));
                all.push_back(c);
            }
    return all;
}

/// Writes the sheet; returns the table's text about it, or nothing without a picture.
std::string write_sheet(const CompareOptions& o, const Experiment& e,
                        const std::vector<ComparedRun>& results, const std::string& capture) {
    const ContactSheet sheet = contact_sheet(e, results, capture, "evaluate_" + o.split);
    if (sheet.picture.size() == 0) return "";
    const std::string file = e.name + "_" + capture + ".png";
    write_png(o.out / file, sheet.picture);
    std::string columns, frames;
    for (const std::string& c : sheet.columns) columns += (columns.empty() ? "" : ", ") + c;
    for (const std::string& f : sheet.frames) frames += (frames.empty() ? "" : ", ") + f;
    return "\n![" + e.title + ", " + capture + "](" + file + ")\n\nFrom the left: " + columns +
           ". From the top: " + frames + ".\n";
}

} // namespace

void write_tables(ComparePlan& plan, bool last) {
    const CompareOptions& o = plan.options();
    for (const Experiment& e : plan.lists().experiments) {
        const std::vector<ComparedRun> results = results_of(plan, e);
        const ExperimentTables tables(e, results);
        std::string text = tables.markdown();
        if (last)
            for (const fs::path& capture : plan.captures_of(e))
                text += write_sheet(o, e, results, name_of(capture));
        write_text(o.out / (e.name + ".md"), text);
        write_text(o.out / (e.name + ".csv"), tables.csv());
        write_text(o.out / (e.name + "_runs.csv"), tables.runs_csv());
        if (last && !o.json)
            std::cout << text << "\n" << (o.out / (e.name + ".md")).string() << "\n";
    }
}

Json tables_json(ComparePlan& plan) {
    Json all = Json::array();
    for (const Experiment& e : plan.lists().experiments)
        all.push_back(ExperimentTables(e, results_of(plan, e)).json());
    return {{"split", plan.options().split}, {"experiments", all}};
}

} // namespace rye::trainer
