// SPDX-License-Identifier: Apache-2.0
/// commands/options.hpp: options that commands share: threads, frames and cameras by name.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <rye/core/error.hpp>

#include "data/out_format.hpp"
#include "training/run.hpp"

namespace CLI {
class App;
}

namespace rye::trainer {

/// Index of a frame by its id; for an empty id the first test frame, or else the first frame.
int frame_index(const Capture& capture, const std::string& id);

/// The same in a capture whose frames are not read yet.
std::string frame_id(const CaptureContents& contents, const std::string& id);

/// Candidates of camera_index: all cameras for an empty id, else that camera; throws Error if it
/// does not exist.
std::vector<std::string> camera_choices(const CaptureContents& contents, const std::string& id);

/// Index of a camera by its id; for an empty id the one that sees the face most frontally.
int camera_index(const Capture& capture, const std::string& id, int frame);

/// PITCH,YAW in degrees as a unit vector of the head frame; throws Error beyond +-70 degrees.
Vec3<float> gaze_option(const std::vector<double>& pitch_yaw_deg, const std::string& option);

/// A whole number below 2^64; throws Error with the option for anything else.
std::uint64_t parsed_seed(const std::string& text, const std::string& option);

/// "0.004" or "1/255", between 0 and 1; throws Error with the option for anything else.
double parsed_error(const std::string& text, const std::string& option);

/// Limit on threads: each costs memory, and systems fail late when there are too many.
inline constexpr int most_threads = 1024;

/// --threads, 0 (all) to most_threads.
void add_threads(CLI::App& command, int& threads, const std::string& help = "Threads (0: all)");

/// --memory: memory_limit() (data/memory_limit.hpp).
void add_memory(CLI::App& command);

/// A check of an option by the function that reads it, f(text, option), which throws Error.
template <class F>
std::function<std::string(const std::string&)> read_check(F f) {
    return [f](const std::string& text) -> std::string {
        try {
            f(text, "");
        } catch (const Error& e) {
            return std::string(e.what()).substr(2); // the caller names the option
        }
        return "";
    };
}

/// Return a check that an option's number is at least `least` and at most `most`, in words that do
/// not change with CLI11's version. Text that is no number is left to CLI11, which says so.
std::function<std::string(const std::string&)> from_to(int least, int most);
std::function<std::string(const std::string&)> from_to(double least, double most);

/// --device: auto, cpu or cuda; `device` has its default (device_choice.hpp).
void add_device(CLI::App& command, std::string& device, const std::string& help);
/// Its text for commands that draw a run.
inline constexpr const char* drawing_device_help =
    "Where pictures are drawn; auto: a CUDA device where this build has kernels and a device is "
    "there";

/// The folder of the capture with its photographs: `option` if given, or else where the run was
/// trained; throws Error, which says what is done with it, where that is not there any more.
std::filesystem::path capture_folder(const std::filesystem::path& run, const TrainState& state,
                                     const std::filesystem::path& option, const std::string& use);

/// Frames, drivers and cameras that the run's head is drawn by, without images: of `option`, a
/// capture, if given; or else the run's own; or else, for a run that was trained before runs kept
/// them, those of the capture it was trained on. Throws Error unless they fit the trained avatar.
Capture driving_capture(const std::filesystem::path& run, const TrainState& state,
                        const std::filesystem::path& option);

/// The same for one frame, by the ids of frame_index and camera_index. With a capture, only files
/// of that frame are read. `frame` and `camera` index the result.
struct ShownView {
    Capture capture;
    int frame = 0, camera = 0;
};
ShownView shown_view(const std::filesystem::path& run, const TrainState& state,
                     const std::filesystem::path& option, const std::string& frame,
                     const std::string& camera);

/// A check of an --out: its name asks for one of these formats (out_format.hpp).
std::function<std::string(const std::string&)> out_check(std::vector<OutFormat> known);

/// A check of a --capture or --run: a folder is there. `what` says what it is expected to hold.
std::function<std::string(const std::string&)> folder_check(const std::string& what);

/// Throws Error unless the capture's drivers fit the trained avatar.
void require_same_subject(const TrainState& state, const Capture& capture);

} // namespace rye::trainer
