// SPDX-License-Identifier: Apache-2.0
/// data/moving_picture.hpp: pictures of one size in their order, as a folder of numbered PNG files,
/// an animated PNG, or Y4M for video programs. Files appear whole or not at all.
///
/// APNG: the chunks acTL, fcTL and fdAT of the PNG specification's third edition, around images
/// that libpng encodes: without loss, all colours, endless repetition; programs that know PNG alone
/// show the first picture. Y4M: YUV4MPEG2, C444 (no loss of resolution, odd sides allowed), luma
/// and chroma by Rec. 601 in the limited range, as video programs assume of Y4M.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "data/out_format.hpp"
#include "data/picture.hpp"

namespace rye::trainer {

/// Pictures a second, as a fraction.
struct FrameRate {
    int pictures = 25, seconds = 1;
};

/// "25" or "30000/1001", 1 to 1000 pictures a second of whole numbers up to 65535; Error, which
/// begins with `who`, for anything else.
FrameRate parsed_rate(const std::string& text, const std::string& who);

/// Takes pictures of three channels, of the size of the first.
class MovingPicture {
  public:
    virtual ~MovingPicture() = default;
    virtual void add(const Image8& picture) = 0;
    /// After the last one. Without it no file is left (pictures of a folder stay).
    virtual void finish() = 0;
};

/// A writer of `count` pictures in this format, which moves(). A folder is made; Error if it holds
/// frame_* files already.
std::unique_ptr<MovingPicture> moving_picture(const std::filesystem::path& path, OutFormat format,
                                              FrameRate rate, int count);

/// Name of a numbered picture of `count`: frame_0000.png, with more digits from 10001 pictures on.
std::string numbered_picture(int number, int count);

} // namespace rye::trainer
