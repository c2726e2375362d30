// SPDX-License-Identifier: Apache-2.0
/// training/run_folder.hpp: the files that a training run writes: config.json, frames.safetensors,
/// cameras.json if cameras were corrected, log.jsonl, panels and the checkpoint. A run that
/// replaces another one leaves all of these unchanged until its own first checkpoint is complete.
/// If a checkpoint cannot be written, the run ends with an Error and the previous one is kept; a
/// log line or a panel that cannot be written is omitted, with a warning.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include <nlohmann/json.hpp>

#include "data/system.hpp"
#include "model/run.hpp"

namespace rye::trainer {

enum class Beginning { fresh, resumed, replacing };

/// Creates the folder; throws an Error on failure.
void make_run_folder(const std::filesystem::path& folder);

/// Returns the lines of a log.jsonl that a run continuing from `state` keeps: drops lines written
/// after its checkpoint, and damaged lines, whose number is added to `damaged`. An unfinished last
/// line, as left by a killed run, is not counted. Empty without a file.
std::string kept_log(const std::filesystem::path& log, const TrainState& state, int& damaged);

/// Folder of a training run. One thread may log while another saves or makes a panel, unless the
/// save replaces a run.
class RunFolder {
  public:
    /// Creates the folder; throws an Error if it cannot be written to. Writes config.json,
    /// frames.safetensors and log.jsonl, unless a run is replaced. Without a capture there is no
    /// frames.safetensors; with one, it must outlive the folder.
    RunFolder(std::filesystem::path folder, const TrainState& state, Beginning beginning,
              const Capture* capture = nullptr);
    RunFolder(const RunFolder&) = delete;
    RunFolder& operator=(const RunFolder&) = delete;

    void log(const nlohmann::ordered_json& line);
    void log_lines(const std::string& text); ///< whole lines, with their line ends
    void save(const TrainState& state);
    /// Writes a panel of the picture that `draw` returns; turns what it throws into a warning.
    void panel(const std::string& name, const std::function<Image<float>()>& draw);

  private:
    void write_inputs(const TrainState& state) const;
    /// Writes cameras.json: the corrected cameras, as the training has corrected them further.
    void save_cameras(const TrainState& state) const;
    void open_log(const std::string& lines);
    void append(const std::string& text);
    void replace_old_run(const TrainState& state);
    void warn(bool& told, const std::string& sentence) const;

    std::filesystem::path folder_;
    const Capture* capture_;
    bool replacing_;
    std::string pending_;  ///< lines of a run that has not replaced the old one yet
    std::optional<AppendedFile> log_;
    bool log_warned_ = false, panel_warned_ = false;
};

} // namespace rye::trainer
