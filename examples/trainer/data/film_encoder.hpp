// SPDX-License-Identifier: Apache-2.0
/// data/film_encoder.hpp: videos by ffmpeg, a program that is no part of rye, from the Y4M of
/// moving_picture.hpp.
#pragma once

#include <filesystem>

namespace rye::trainer {

/// Throws an Error that states how to install ffmpeg if it is not there.
void require_ffmpeg(const std::filesystem::path& file);

/// Makes a video of a Y4M, which is removed: H.264 in MP4, or VP9 for a name that ends in .webm, of
/// Rec. 709 with sides made even, without sound. Throws an Error with what ffmpeg says; then no
/// file is left.
void encode_film(const std::filesystem::path& y4m, const std::filesystem::path& file);

} // namespace rye::trainer
