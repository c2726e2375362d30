// SPDX-License-Identifier: Apache-2.0
/// data/experiments.hpp: lists of configurations that `rye compare` trains and measures side by
/// side, one table each: the built-in ones and those of a JSON file.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "data/config.hpp"

namespace rye::trainer {

/// Number in results.json (of `rye evaluate`), or in judge.json (of benchmarks/judge/judge.sh),
/// that is a column of a table.
struct Metric {
    std::string name;    ///< in lists and CSV files
    std::string title;   ///< in tables
    std::string pointer; ///< in a group (read_results); empty: irises found of visible eyes
    int digits;          ///< after the decimal point
};
const std::vector<Metric>& all_metrics();

/// Row of a table: one configuration.
struct ExperimentRow {
    std::string name;              ///< in the table
    std::string run;               ///< folder name of its runs; rows may share one
    nlohmann::ordered_json config; ///< fields that replace those of preset and base
    TrainConfig effective = {};    ///< preset, base and config together, with the first seed
};

/// Table of rows, which are compared with the first one.
struct Experiment {
    std::string name; ///< name of its files
    std::string title;
    std::string preset = "cpu";
    nlohmann::ordered_json base = nlohmann::ordered_json::object();
    std::vector<ExperimentRow> rows = {};
    std::vector<std::string> columns = {};            ///< names of metrics
    std::vector<std::filesystem::path> captures = {}; ///< the command line's take precedence
    std::vector<std::uint64_t> seeds = {};            ///< likewise
};

/// Returns "mechanisms", "losses" and "deformation": tables 1, 2 and 3 of the paper.
const std::vector<std::string>& built_in_experiments();
Experiment built_in_experiment(const std::string& name);

/// Returns the experiment in a JSON file (docs/evaluation.md); throws an Error with file and field
/// for faults in it.
Experiment read_experiment(const std::filesystem::path& path);
/// Returns the experiment in the text of the file at `path`, as read_experiment.
Experiment parse_experiment(std::string_view text, const std::filesystem::path& path);

/// Returns an experiment as such a file.
nlohmann::ordered_json to_json(const Experiment& experiment);

/// Settings shared by all rows of an experiment.
struct ExperimentSettings {
    std::string preset;          ///< replaces the experiment's, unless empty
    nlohmann::ordered_json base; ///< applied after the experiment's base; null for nothing
    std::string base_source;     ///< named in errors
    std::uint64_t seed = 1;
};

/// Sets the effective configurations; throws an Error that names row and field for an invalid one,
/// and for two rows of one run that differ.
void configure(Experiment& experiment, const ExperimentSettings& settings);

/// Returns a name fit for a folder: letters, digits, '-' and '.' kept, others as '_'.
std::string folder_name(const std::string& name);

} // namespace rye::trainer
