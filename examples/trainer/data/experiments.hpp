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

/// A number of results.json (of `rye evaluate`) that a table has as a column.
struct Metric {
    std::string name;    ///< in lists and CSV files
    std::string title;   ///< in tables
    std::string pointer; ///< where it is in a group of results.json; empty: found of visible eyes
    int digits;          ///< after the point
};
const std::vector<Metric>& all_metrics();

/// A row of a table: one configuration.
struct ExperimentRow {
    std::string name;              ///< in the table
    std::string run;               ///< of the folder of its runs; rows may share one
    nlohmann::ordered_json config; ///< fields that replace those of preset and base
    TrainConfig effective = {};    ///< of preset, base and config; with the first seed
};

/// A table: rows, the first of which the others are compared with.
struct Experiment {
    std::string name; ///< of its files
    std::string title;
    std::string preset = "cpu";
    nlohmann::ordered_json base = nlohmann::ordered_json::object();
    std::vector<ExperimentRow> rows = {};
    std::vector<std::string> columns = {};            ///< names of metrics
    std::vector<std::filesystem::path> captures = {}; ///< of a file; those of the command line win
    std::vector<std::uint64_t> seeds = {};            ///< the same
};

/// "mechanisms", "losses" and "deformation": tables 1, 2 and 3 of the paper.
const std::vector<std::string>& built_in_experiments();
Experiment built_in_experiment(const std::string& name);

/// From a JSON file (docs/evaluation.md); Error with file and field for what is wrong in it.
Experiment read_experiment(const std::filesystem::path& path);
/// As read_experiment, from the text of the list at `path`.
Experiment parse_experiment(std::string_view text, const std::filesystem::path& path);

/// The list as such a file.
nlohmann::ordered_json to_json(const Experiment& experiment);

/// Settings that all rows of an experiment share.
struct ExperimentSettings {
    std::string preset;          ///< instead of the list's; empty: the list's
    nlohmann::ordered_json base; ///< after the list's base; null: nothing
    std::string base_source;     ///< named in errors
    std::uint64_t seed = 1;
};

/// Sets the effective configurations; Error that names row and field for one that is not valid, and
/// for two rows of one run that differ.
void configure(Experiment& experiment, const ExperimentSettings& settings);

/// Letters, digits, '-' and '.' of a name, others as '_': fit for a folder.
std::string folder_name(const std::string& name);

} // namespace rye::trainer
