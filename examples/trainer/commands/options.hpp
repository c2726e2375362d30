// SPDX-License-Identifier: Apache-2.0
/// commands/options.hpp: options shared by commands: threads, frames and cameras by name.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <rye/core/error.hpp>

#include "data/out_format.hpp"
#include "drawing/shown.hpp"
#include "model/run.hpp"

namespace CLI {
class App;
}

namespace rye::trainer {

/// Returns the index of a frame by its id; for an empty id the first test frame, or else the first
/// frame.
int frame_index(const Capture& capture, const std::string& id);

/// Returns the id of that frame in a capture whose frames are not read yet.
std::string frame_id(const CaptureContents& contents, const std::string& id);

/// Returns the candidates of camera_index: all cameras for an empty id, else that camera; throws an
/// Error if it does not exist.
std::vector<std::string> camera_choices(const CaptureContents& contents, const std::string& id);

/// Returns the index of a camera by its id; for an empty id the one that sees the face most
/// frontally.
int camera_index(const Capture& capture, const std::string& id, int frame);

/// Returns PITCH,YAW in degrees as a unit vector of the head frame; throws an Error beyond +-70
/// degrees.
Vec3<float> gaze_option(const std::vector<double>& pitch_yaw_deg, const std::string& option);

/// Parses a whole number below 2^64; throws an Error with the option for anything else.
std::uint64_t parsed_seed(const std::string& text, const std::string& option);

/// Parses "0.004" or "1/255", between 0 and 1; throws an Error with the option for anything else.
double parsed_error(const std::string& text, const std::string& option);

/// Largest number of threads: each costs memory, and systems fail late if there are too many.
inline constexpr int most_threads = 1024;

/// Adds --threads, 0 (all) to most_threads.
void add_threads(CLI::App& command, int& threads, const std::string& help = "Threads (0: all)");

/// Adds --memory: memory_limit() (data/memory_limit.hpp).
void add_memory(CLI::App& command);

/// Returns a check of an option by the function that reads it, f(text, option), which throws an
/// Error.
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

/// Returns a check that an option's number is at least `least` and at most `most`, in words that do
/// not depend on CLI11's version. CLI11 itself rejects text that is no number.
std::function<std::string(const std::string&)> from_to(int least, int most);
std::function<std::string(const std::string&)> from_to(double least, double most);

/// Adds --device: auto, cpu or cuda; `device` has its default (device/choice.hpp).
void add_device(CLI::App& command, std::string& device, const std::string& help);
/// Help of --device for commands that draw a run.
inline constexpr const char* drawing_device_help =
    "Where pictures are drawn; auto: a CUDA device where this build has kernels and a device is "
    "there";

/// Returns the folder of the capture with its photographs: `option` if given, else the capture of
/// the training; throws an Error that states its use if that no longer exists.
std::filesystem::path capture_folder(const std::filesystem::path& run, const TrainState& state,
                                     const std::filesystem::path& option, const std::string& use);

/// Returns frames, drivers and cameras for drawing the run's head, without images: those of
/// `option`, a capture, if given; else the run's own; else, for a run older than its own frames,
/// those of the capture it was trained on. Throws an Error unless they fit the trained avatar.
Capture driving_capture(const std::filesystem::path& run, const TrainState& state,
                        const std::filesystem::path& option);

/// Capture, frame and camera to show, by the ids of frame_index and camera_index. With a capture,
/// only files of that frame are read. `frame` and `camera` index the result.
struct ShownView {
    Capture capture;
    int frame = 0, camera = 0;
};
ShownView shown_view(const std::filesystem::path& run, const TrainState& state,
                     const std::filesystem::path& option, const std::string& frame,
                     const std::string& camera);

/// Returns how many times as high as the run's own a capture's pictures are; 1 for a run of an older
/// version, which has none.
double share_of_trained(const std::filesystem::path& run, const TrainState& state,
                        const Capture& capture);
/// Returns the dilation of pictures like a capture's [px^2]: as wide on the head as training had it
/// if they are larger or smaller than the run's own.
double dilation_of(const std::filesystem::path& run, const TrainState& state,
                   const Capture& capture);
/// Sets the dilations of frames by cameras of one's own, so that Gaussians are as wide on the head
/// as in `view`, the head by a camera of the capture.
void take_size(const std::filesystem::path& run, const TrainState& state, const ShownView& view,
               std::vector<DrawnFrame>& frames);

/// Returns a check of an --out: its name must ask for one of these formats (out_format.hpp).
std::function<std::string(const std::string&)> out_check(std::vector<OutFormat> known);

/// Returns a check of a --capture or --run: the folder must exist. `what` says what it should hold.
std::function<std::string(const std::string&)> folder_check(const std::string& what);

/// Throws an Error unless the capture's drivers fit the trained avatar.
void require_same_subject(const TrainState& state, const Capture& capture);

} // namespace rye::trainer
