// SPDX-License-Identifier: Apache-2.0
/// commands/compare_tables.hpp: tables of `rye compare`: the numbers of `rye evaluate` for many
/// runs, by rows of an experiment, with mean and spread.
#pragma once

#include <array>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "data/experiments.hpp"
#include "data/picture.hpp"

namespace rye::trainer {

/// Run that was trained and evaluated, or failed.
struct ComparedRun {
    std::size_t row; ///< index in the experiment
    std::string capture;
    std::uint64_t seed;
    std::filesystem::path folder;
    nlohmann::json results; ///< as of read_results, or null
    std::string failure;    ///< reason if there are none
};

/// Returns results.json of an evaluation; where there is a judge.json (of
/// benchmarks/judge/judge.sh), its groups are fields `judge` of the results'. Throws an Error that
/// names a damaged file.
nlohmann::json read_results(const std::filesystem::path& evaluation);

/// Mean and spread over runs.
struct Spread {
    std::vector<double> values;
    double mean() const;
    /// Returns the sample standard deviation; 0 for fewer than two values.
    double deviation() const;
    /// Returns "1.23 +- 0.04", without the second part for one value, "-" for none.
    std::string text(int digits) const;
    nlohmann::ordered_json json() const;
};

/// Returns a metric of a group of results; empty if it is null or absent.
std::vector<double> metric_of(const nlohmann::json& group, const Metric& metric);

/// Tables of an experiment, in one document.
class ExperimentTables {
  public:
    ExperimentTables(const Experiment& experiment, std::vector<ComparedRun> runs);

    std::string markdown() const;
    /// Returns one line for each table, row and metric.
    std::string csv() const;
    /// Returns one line for each run, group and metric.
    std::string runs_csv() const;
    nlohmann::ordered_json json() const;

  private:
    /// Runs of one capture, or of all (an empty name), and a group of frames.
    struct Part {
        std::string capture, group;
    };
    std::vector<Part> parts() const;
    Spread spread(const Part& part, std::size_t row, const Metric& metric) const;
    /// Returns the differences of a row's runs from those of the first row with the same capture
    /// and seed.
    Spread difference(const Part& part, std::size_t row, const Metric& metric) const;

    const Experiment& experiment_;
    std::vector<ComparedRun> runs_;
};

/// Returns the boxes (x, y, width, height) of the eyes in an evaluation's pictures [px], by picture
/// name, from its per_view.json; none without eyes. Throws an Error if results.json states another
/// checksum.
std::map<std::string, std::array<int, 4>> eye_boxes(const std::filesystem::path& evaluation);

/// One line of pictures for each frame: the photograph, then the render of each row's first run
/// that has pictures, and below it close-ups of the eyes, from the pictures that `rye evaluate`
/// wrote to `pictures` in each run's folder; with the names in that order. Empty without any.
struct ContactSheet {
    Image<float> picture;
    std::vector<std::string> columns, frames;
};
ContactSheet contact_sheet(const Experiment& experiment, const std::vector<ComparedRun>& runs,
                           const std::string& capture, const std::filesystem::path& pictures);

} // namespace rye::trainer
