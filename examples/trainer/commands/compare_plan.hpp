// SPDX-License-Identifier: Apache-2.0
/// commands/compare_plan.hpp: what `rye compare` is to train and measure: the runs of its tables,
/// their folders, and which of them share a stage 1.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "commands/child_jobs.hpp"
#include "commands/compare_tables.hpp"
#include "data/experiments.hpp"

namespace rye::trainer {

struct CompareOptions {
    std::vector<std::string> tables, captures, seeds, with;
    std::filesystem::path list, out, config, perceptual_weights;
    std::string preset, split = "test", device = "auto", memory, emit;
    std::optional<std::int64_t> steps;
    std::optional<int> task;
    int jobs = 1, threads = 0;
    bool jobs_given = false, json = false, quiet = false, print_list = false, collect = false,
         stage_one = false;
};

/// Configuration, seed and capture, which rows of several tables may share.
struct PlannedRun {
    std::filesystem::path folder, capture_folder;
    std::string capture, name; ///< for messages
    TrainConfig config;
    std::string failure;
    const PlannedRun* first = nullptr; ///< run whose stage 1 it shares; null: its own
    bool ended = false;                ///< true also if there was nothing to do
};

/// Tables, and fields that all their rows have.
struct CompareLists {
    std::vector<Experiment> experiments;
    nlohmann::ordered_json base; ///< as of ExperimentSettings
    std::string base_source;
};

/// Returns the tables that the options name; throws an Error without any, for two of one name, and
/// for a file with faults.
CompareLists lists_of(const CompareOptions& options);

/// Runs of all tables.
class ComparePlan {
  public:
    /// Sets the effective configurations of all rows; runs are known after add_runs.
    ComparePlan(CompareOptions options, CompareLists lists);

    const CompareOptions& options() const { return o_; }
    const CompareLists& lists() const { return lists_; }

    /// Finds the runs; throws an Error for captures that are not there, or that agree in name, and
    /// for tables whose runs differ in configuration but not in name.
    void add_runs();
    /// Runs in the order of the tables, or as order() has put them.
    const std::vector<PlannedRun*>& runs() const { return order_; }
    void order(std::vector<PlannedRun*> runs) { order_ = std::move(runs); }
    PlannedRun& run_of(const std::string& capture, const ExperimentRow& row, std::uint64_t seed);

    std::vector<std::filesystem::path> captures_of(const Experiment& e) const;
    std::vector<std::uint64_t> seeds_of(const Experiment& e) const;

    /// Throws an Error if the folder holds a run of another configuration.
    void check_there(const PlannedRun& run) const;
    /// Lets runs that agree in all fields that stage 1 reads share it: that of the first run that
    /// has one, or else of the first run.
    void share_stage_one();

    std::filesystem::path evaluation_folder(const std::filesystem::path& run) const;
    /// Returns true if the run is trained and measured; throws an Error for a damaged file.
    bool is_complete(const PlannedRun& run) const;
    /// Notes that it is.
    void complete(const PlannedRun& run) const;

    /// Returns the commands that train and measure a run, from where it is. Makes its folder, with
    /// its configuration.
    ChildJob job_of(const PlannedRun& run) const;

  private:
    std::filesystem::path folder_of(const std::string& capture, const ExperimentRow& row,
                                    std::uint64_t seed) const;
    std::filesystem::path complete_path(const PlannedRun& run) const;

    CompareOptions o_;
    CompareLists lists_;
    std::map<std::filesystem::path, PlannedRun> runs_;
    std::vector<PlannedRun*> order_;
};

/// Returns the name of a capture in folders and tables.
std::string name_of(const std::filesystem::path& capture);

/// Writes the tables of what is complete; `last`: with contact sheets, and to standard output.
void write_tables(ComparePlan& plan, bool last);

/// Returns the tables as `rye compare --json` prints them.
nlohmann::ordered_json tables_json(ComparePlan& plan);

/// Returns the path that names the file from every folder, without "." and "..".
std::filesystem::path whole_path(const std::filesystem::path& path);

/// Replaces a file by a text.
void write_text(const std::filesystem::path& path, const std::string& text);

} // namespace rye::trainer
