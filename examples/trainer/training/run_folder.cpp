// SPDX-License-Identifier: Apache-2.0
#include "training/run_folder.hpp"

#include <fstream>
#include <iostream>
#include <iterator>
#include <span>
#include <sstream>
#include <utility>
#include <vector>

#include <rye/io/atomic_file.hpp>

#include "corrections/cameras.hpp"
#include "data/checksums.hpp"
#include "data/corrected_cameras.hpp"
#include "data/json.hpp"
#include "data/picture.hpp"
#include "data/run_frames.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

ByteSpan bytes_of(const std::string& text) { return std::as_bytes(std::span(text)); }

} // namespace

void make_run_folder(const fs::path& folder) {
    std::error_code fault;
    require(!fs::exists(folder, fault) || fs::is_directory(folder, fault), folder.string(),
            "is a file, expected a folder or nothing");
    fs::create_directories(folder, fault);
    require(!fault, folder.string(), "cannot be made: " + fault.message());
}

std::string kept_log(const fs::path& log, const TrainState& state, int& damaged) {
    std::ifstream file(log, std::ios::binary);
    const std::string text{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
    // Logs of an older program have no checksums, and each line gets one; otherwise a line without
    // one is damaged.
    const bool checked = text.find("\"checksum\":") != std::string::npos;
    std::istringstream old(text);
    std::string kept;
    for (std::string line; std::getline(old, line);) {
        const bool complete = !old.eof();  // its line end was read
        auto json = json_or_discarded(line);
        const Checked sum = take_checksum(json);
        const auto is = [&](const char* key, auto type) {
            return json.contains(key) && (json.at(key).*type)();
        };
        if (!json.is_object() || sum == Checked::wrong || (checked && sum == Checked::none) ||
            !is("stage", &nlohmann::json::is_string) ||
            !is("step", &nlohmann::json::is_number_integer)) {
            // A line that a killed run left unfinished has no whole checksum.
            if (complete || line.find("\"checksum\":") != std::string::npos) ++damaged;
            continue;
        }
        // A run still in stage 1 repeats the fit after its last step.
        if (state.stage == Stage::mesh && json.contains("landmark_rms")) continue;
        const bool mesh = json.at("stage") == "mesh";
        const bool before = json.at("stage") == "labels" || (mesh && state.stage == Stage::avatar) ||
                            (mesh == (state.stage == Stage::mesh) &&
                             json.at("step").get<std::int64_t>() <= state.step);
        if (before)
            kept += checked ? line + "\n"
                            : checked_text(
                                  parse_json_text<nlohmann::ordered_json>(line, log.string()), -1);
    }
    return kept;
}

RunFolder::RunFolder(fs::path folder, const TrainState& state, Beginning beginning,
                     const Capture* capture)
    : folder_(std::move(folder)),
      capture_(capture),
      replacing_(beginning == Beginning::replacing) {
    make_run_folder(folder_);
    make_run_folder(folder_ / "panels");
    AtomicFile(checkpoint_path(folder_)).write(bytes_of("trial"));  // removed without a commit
    if (replacing_) return;
    std::string lines;
    if (beginning == Beginning::resumed) {
        int damaged = 0;
        const fs::path log = folder_ / "log.jsonl";
        lines = kept_log(log, state, damaged);
        if (damaged > 0)
            std::cerr << "rye: warning: " << log.string() << ": " << damaged
                      << " lines are damaged and are left out\n";
    }
    write_inputs(state);
    open_log(lines);
}

void RunFolder::write_inputs(const TrainState& state) const {
    const std::string text = to_json(state.config).dump(2) + "\n";
    write_atomic(folder_ / "config.json", bytes_of(text));
    std::error_code ignored;
    if (capture_ != nullptr)
        save_frames(folder_, *capture_);
    else
        fs::remove(frames_path(folder_), ignored); // of an earlier run
    save_cameras(state);
}

void RunFolder::save_cameras(const TrainState& state) const {
    std::vector<CorrectedCamera> all;
    if (capture_ != nullptr) all = trained_cameras(*capture_, state.avatar.delta_view);
    save_corrected_cameras(folder_, all);
}

void RunFolder::open_log(const std::string& lines) {
    const fs::path path = folder_ / "log.jsonl";
    write_atomic(path, bytes_of(lines));
    log_.emplace(path);
}

void RunFolder::warn(bool& told, const std::string& sentence) const {
    if (!std::exchange(told, true)) std::cerr << "rye: warning: " << sentence << "\n";
}

void RunFolder::append(const std::string& text) {
    if (const auto failure = log_->append(text))
        warn(log_warned_, (folder_ / "log.jsonl").string() + ": cannot be written: " +
                              failure->reason + "; lines of it are left out" +
                              (failure->undone ? "" : ", one of them half"));
}

void RunFolder::log(const nlohmann::ordered_json& line) { log_lines(checked_text(line, -1)); }

void RunFolder::log_lines(const std::string& text) {
    if (replacing_) pending_ += text;
    else append(text);
}

void RunFolder::replace_old_run(const TrainState& state) {
    // Removes the old log first: none of its lines may pass for one of the new run.
    std::error_code ignored;
    fs::remove(folder_ / "log.jsonl", ignored);
    std::vector<fs::path> panels;
    for (const fs::directory_entry& entry : fs::directory_iterator(folder_ / "panels", ignored))
        if (entry.path().filename().string().starts_with("step_")) panels.push_back(entry.path());
    for (const fs::path& panel : panels) fs::remove(panel, ignored);
    write_inputs(state);
    open_log(pending_);
    pending_.clear();
}

void RunFolder::save(const TrainState& state) {
    try {
        save_checkpoint(folder_, state);
    } catch (const Error& e) {
        std::error_code ignored;
        const bool there = fs::exists(checkpoint_path(folder_), ignored);
        throw Error(std::string(e.what()) +
                    (replacing_ ? "; the run that is there stays as it was"
                     : there    ? "; go on from the checkpoint before it with `rye train --out " +
                                   folder_.string() + " --resume`"
                                : "; there is no checkpoint before it"));
    }
    if (!replacing_) { // log() may read `replacing_` meanwhile, so it is not written
        if (state.avatar.delta_view.size() > 0) save_cameras(state);
        return;
    }
    replacing_ = false;
    replace_old_run(state);
}

void RunFolder::panel(const std::string& name, const std::function<Image<float>()>& draw) {
    try {
        write_png(folder_ / "panels" / name, draw());
    } catch (const Error& e) {
        warn(panel_warned_, std::string(e.what()) + "; panels are left out");
    }
}

} // namespace rye::trainer
