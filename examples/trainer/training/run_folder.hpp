// SPDX-License-Identifier: Apache-2.0
/// training/run_folder.hpp: what a training run writes: config.json, frames.safetensors,
/// cameras.json where cameras were corrected, log.jsonl, panels and the checkpoint. A run that replaces another one leaves all of it as it was until its
/// own first checkpoint is complete. A checkpoint that cannot be written ends the run with an
/// Error, and the one before it stays; a log line or a panel that cannot be written is left out,
/// with a warning.
#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include <nlohmann/json.hpp>

#include "training/run.hpp"

namespace rye::trainer {

enum class Beginning { fresh, resumed, replacing };

/// Makes the folder; Error where that cannot be.
void make_run_folder(const std::filesystem::path& folder);

/// The lines of a log.jsonl that a run which goes on from `state` keeps: what was written after its
/// checkpoint goes, and so do damaged lines, whose number is added to `damaged`. An
/// unfinished last line is what a killed run leaves, and not counted. Empty without a file.
std::string kept_log(const std::filesystem::path& log, const TrainState& state, int& damaged);

/// One thread may log while another saves or makes a panel, unless the save replaces a run.
class RunFolder {
  public:
    /// Makes the folder; Error if it cannot be written to. Writes config.json, frames.safetensors
    /// and log.jsonl, unless a run is replaced. Without a capture there is no frames.safetensors;
    /// else it must outlive the folder.
    RunFolder(std::filesystem::path folder, const TrainState& state, Beginning beginning,
              const Capture* capture = nullptr);
    ~RunFolder();
    RunFolder(const RunFolder&) = delete;
    RunFolder& operator=(const RunFolder&) = delete;

    void log(const nlohmann::ordered_json& line);
    void log_lines(const std::string& text); ///< whole lines, each with its end
    void save(const TrainState& state);
    /// `draw` gives the picture; what it throws is a warning too.
    void panel(const std::string& name, const std::function<Image<float>()>& draw);

  private:
    void write_inputs(const TrainState& state) const;
    void open_log(const std::string& lines);
    void append(const std::string& text);
    void replace_old_run(const TrainState& state);
    void warn(bool& told, const std::string& sentence) const;

    std::filesystem::path folder_;
    const Capture* capture_;
    bool replacing_;
    std::string pending_;  ///< log lines of a run that has not replaced the old one yet
    int log_ = -1;         ///< descriptor
    bool log_warned_ = false, panel_warned_ = false;
};

} // namespace rye::trainer
