// SPDX-License-Identifier: Apache-2.0
/// commands/video_options.hpp: the options by which `rye import video` and `rye avatar` read
/// videos.
#pragma once

#include "importers/import_folder.hpp"

namespace CLI {
class App;
}

namespace rye::trainer {

/// Adds FILE... and all options of a video's import but the size of the capture's pictures; `video`
/// has their defaults.
void add_video_options(CLI::App& command, VideoImport& video);

} // namespace rye::trainer
