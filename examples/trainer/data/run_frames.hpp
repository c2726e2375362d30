// SPDX-License-Identifier: Apache-2.0
/// data/run_frames.hpp: the frames of the capture that a run was trained on, without pixels:
/// drivers, landmarks, cameras, names. They are stored in the run's folder, so that drawing needs
/// no capture: one safetensors file, with the capture's numbers, so that pictures have the bits of
/// those drawn from the capture. The layout is in docs/runs.md.
#pragma once

#include <filesystem>
#include <string>

#include <rye/io/bytes.hpp>

#include "data/capture.hpp"

namespace rye::trainer {

inline std::filesystem::path frames_path(const std::filesystem::path& run) {
    return run / "frames.safetensors";
}

/// Returns a text that differs for captures whose stored frames differ; the checkpoint keeps it, to
/// detect frames of another run. It does not depend on paths.
std::string frames_mark(const Capture& capture);

/// Replaces frames.safetensors atomically. The capture must have the gaze of every frame. Throws an
/// Error, before anything is written, if a number is not finite.
void save_frames(const std::filesystem::path& run, const Capture& capture);

/// Returns a capture without images, whose folder is the file (for messages). Throws an Error that
/// names file and field for anything missing, of another version, type or shape, out of range or
/// not finite, and if `mark` is neither empty nor the file's.
Capture load_frames(const std::filesystem::path& run, const std::string& mark);

/// Returns the capture in the bytes of a file, of any mark; errors begin with `who`.
Capture parse_frames(ByteSpan bytes, const std::string& who);

} // namespace rye::trainer
