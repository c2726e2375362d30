// SPDX-License-Identifier: Apache-2.0
/// commands/film.hpp: the pictures of a synthetic capture as a video, for `rye capture --video`.
#pragma once

#include <filesystem>

#include "synthetic_capture/video_scene.hpp"

namespace rye::trainer {

/// How a head is filmed.
struct FilmSettings {
    int rate = 10;              ///< pictures a second
    bool auto_exposure = false; ///< by data/auto_exposure.hpp
};

/// Writes the pictures of a capture's first camera, before a plain wall, as a video: by ffmpeg in
/// H.264, or where the name ends in .y4m as it is. Throws an Error that names ffmpeg's package where
/// it is needed and missing.
void write_film(const std::filesystem::path& capture, const CaptureScene& scene,
                const FilmSettings& settings, const std::filesystem::path& file);

/// Throws that Error before anything is drawn.
void check_film(const std::filesystem::path& file);

} // namespace rye::trainer
