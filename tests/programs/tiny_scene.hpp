// SPDX-License-Identifier: Apache-2.0
/// tests/programs/tiny_scene.hpp: a folder with a run of random numbers and a capture that fits it.
#pragma once

#include <filesystem>

#include "../support/hostile.hpp"
#include "tiny_capture.hpp"
#include "tiny_run.hpp"

namespace rye::trainer {

struct TinyScene {
    TemporaryFolder folder;
    TinyCapture capture{folder.path / "capture"};
    std::filesystem::path run = folder.path / "run";

    TinyScene() {
        capture.set_expressions();
        TrainState state = tiny_state();
        state.step = 1;
        state.capture = capture.folder.string();
        std::filesystem::create_directories(run);
        save_checkpoint(run, state);
    }
};

} // namespace rye::trainer
