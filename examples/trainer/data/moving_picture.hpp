// SPDX-License-Identifier: Apache-2.0
/// data/moving_picture.hpp: a sequence of pictures of one size as a folder of numbered PNG files,
/// an animated PNG, or Y4M for video programs. Files appear complete or not at all.
///
/// APNG: the chunks acTL, fcTL and fdAT of the PNG specification's third edition, around images
/// that libpng encodes: lossless, all colours, endless repetition; programs that only know PNG show
/// the first picture. Y4M: YUV4MPEG2, C444 (no loss of resolution, odd sides allowed), luma and
/// chroma by Rec. 601 in the limited range, as video programs assume for Y4M.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "data/out_format.hpp"
#include "data/picture.hpp"

namespace rye::trainer {

/// Pictures per second, as a fraction.
struct FrameRate {
    int pictures = 25, seconds = 1;
};

inline double pictures_a_second(const FrameRate& rate) {
    return static_cast<double>(rate.pictures) / rate.seconds;
}

/// Parses "25" or "30000/1001": 1 to 1000 pictures per second, of whole numbers up to 65535; throws
/// an Error that begins with `who` for anything else.
FrameRate parsed_rate(const std::string& text, const std::string& who);

/// Writer of pictures of three channels, of the size of the first.
class MovingPicture {
  public:
    virtual ~MovingPicture() = default;
    virtual void add(const Image8& picture) = 0;
    /// Completes the file after the last picture. Without it no file is left (pictures of a folder
    /// stay).
    virtual void finish() = 0;
};

/// Returns a writer of `count` pictures in this format, for which moves() is true. Creates a
/// folder; throws an Error if it contains frame_* files already.
std::unique_ptr<MovingPicture> moving_picture(const std::filesystem::path& path, OutFormat format,
                                              FrameRate rate, int count);

/// Returns the name of a numbered picture of `count`: frame_0000.png, with more digits for more
/// than 10000 pictures.
std::string numbered_picture(int number, int count);

} // namespace rye::trainer
