// SPDX-License-Identifier: Apache-2.0
/// commands/compare_tables.hpp: tables of `rye compare`: the numbers of `rye evaluate` of many
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

/// A run that was trained and evaluated, or could not be.
struct ComparedRun {
    std::size_t row; ///< of the experiment
    std::string capture;
    std::uint64_t seed;
    std::filesystem::path folder;
    nlohmann::json results; ///< of results.json; null where there is none
    std::string failure;    ///< why there is none
};

/// Mean and spread over runs.
struct Spread {
    std::vector<double> values;
    double mean() const;
    /// Sample standard deviation; 0 of less than two values.
    double deviation() const;
    /// "1.23 +- 0.04", without the second part for one value, "-" for none.
    std::string text(int digits) const;
    nlohmann::ordered_json json() const;
};

/// A metric of a group of results.json; none if it is null or absent.
std::vector<double> metric_of(const nlohmann::json& group, const Metric& metric);

/// All tables of an experiment, in one document.
class ExperimentTables {
  public:
    ExperimentTables(const Experiment& experiment, std::vector<ComparedRun> runs);

    std::string markdown() const;
    /// One line for each table, row and metric.
    std::string csv() const;
    /// One line for each run, group and metric.
    std::string runs_csv() const;
    nlohmann::ordered_json json() const;

  private:
    /// Runs of one capture, or of all (an empty name), and a group of frames.
    struct Part {
        std::string capture, group;
    };
    std::vector<Part> parts() const;
    Spread spread(const Part& part, std::size_t row, const Metric& metric) const;
    /// Differences of a row's runs to those of the first row with the same capture and seed.
    Spread difference(const Part& part, std::size_t row, const Metric& metric) const;

    const Experiment& experiment_;
    std::vector<ComparedRun> runs_;
};

/// Boxes (x, y, width, height) of the eyes on the pictures of an evaluation [pixels], by their names,
/// from its per_view.json; none without eyes. Throws Error where results.json says another checksum.
std::map<std::string, std::array<int, 4>> eye_boxes(const std::filesystem::path& evaluation);

/// One line of pictures for each frame: the photograph, then the render of each row's first run
/// that has pictures, and below it close-ups of the eyes, from what `rye evaluate` wrote to
/// `pictures` in each run's folder; and the names in that order. Empty without any.
struct ContactSheet {
    Image<float> picture;
    std::vector<std::string> columns, frames;
};
ContactSheet contact_sheet(const Experiment& experiment, const std::vector<ComparedRun>& runs,
                           const std::string& capture, const std::filesystem::path& pictures);

} // namespace rye::trainer
