// SPDX-License-Identifier: Apache-2.0
/// tests/capture_scene/right_capture.hpp: a rendered capture without errors, for copies with errors
/// put in.
#pragma once

#include <filesystem>

#include "../support/hostile.hpp"
#include "data/capture.hpp"
#include "synthetic_capture/scene.hpp"

namespace rye::trainer {

/// The procedural head by six cameras. An iris has 80 pixels and more.
struct RightCapture {
    TemporaryFolder folder;
    std::filesystem::path path = folder.path / "right";
    Capture capture;

    explicit RightCapture(int train_frames,
                          const std::optional<std::vector<Softbox>>& softboxes = {}) {
        const CaptureSettings settings{.size = 256,
                                       .cameras = 6,
                                       .train_frames = train_frames,
                                       .novel_frames = 2,
                                       .independent_frames = 0,
                                       .samples = 1,
                                       .softboxes = softboxes};
        const HeadModel head = procedural_head(1);
        write_capture(head, capture_scene(head, settings), path, [](int, int) {});
        capture = read_capture(path);
    }
    const CaptureFrame& frame(int f) const { return capture.frames[static_cast<std::size_t>(f)]; }
};

/// Returns the one of 12 training frames, which is made once for all tests of the program; no test
/// changes its files.
inline const RightCapture& right_capture() {
    static const RightCapture made(12);
    return made;
}

} // namespace rye::trainer
