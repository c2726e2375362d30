// SPDX-License-Identifier: Apache-2.0
/// data/run_frames.hpp: the frames of the capture that a run was trained on, without pixels:
/// drivers, landmarks, cameras, names. They lie in the run's folder, so that drawing needs no
/// capture. One safetensors file, of numbers as the capture has them: a picture drawn from it has
/// the bits of one drawn from the capture. The layout is in docs/runs.md.
#pragma once

#include <filesystem>
#include <string>

#include <rye/capture/bytes.hpp>

#include "data/capture.hpp"

namespace rye::trainer {

inline std::filesystem::path frames_path(const std::filesystem::path& run) {
    return run / "frames.safetensors";
}

/// Text that differs for captures whose stored frames differ; the checkpoint keeps it, so that
/// frames of another run are noticed. It does not depend on paths.
std::string frames_mark(const Capture& capture);

/// Replaces frames.safetensors atomically. The capture has the gaze of every frame. Error, before
/// anything is written, if a number is not finite.
void save_frames(const std::filesystem::path& run, const Capture& capture);

/// A capture without images, whose folder is the file (for messages). Error naming file and field
/// for anything missing, of another version, type or shape, out of range or not finite, and if
/// `mark` is not empty and not that of the file.
Capture load_frames(const std::filesystem::path& run, const std::string& mark);

/// The same from the bytes of a file, of any mark; errors begin with `who`.
Capture parse_frames(ByteSpan bytes, const std::string& who);

} // namespace rye::trainer
