// SPDX-License-Identifier: Apache-2.0
/// rye/io/image8.hpp: images of 8 bits as pictures on disk hold them, between a decoder and
/// rye's float images. Values are the file's own (sRGB for colour, no linearisation); 255 becomes 1
/// in float images.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>

namespace rye {

/// Image as stored in the file: row by row, channels interleaved.
struct Image8 {
    int width = 0;                     ///< [px]
    int height = 0;                    ///< [px]
    int channels = 0;                  ///< 1 grey, 2 grey + alpha, 3 RGB, 4 RGBA
    std::vector<std::uint8_t> values;  ///< channels * width * height
};

/// Size and channels, from the header alone.
struct ImageHeader {
    int width = 0, height = 0, channels = 0;
};

/// Largest side of an image that is read [px]; larger headers are rejected before decoding.
inline constexpr int max_image_edge = 16384;

/// Throws an Error, which begins with `who`, unless both sides are 1 to max_image_edge.
inline void check_image_size(const ImageHeader& h, const std::string& who) {
    require(h.width > 0 && h.height > 0 && h.width <= max_image_edge && h.height <= max_image_edge,
            who, "got an image of ", h.width, " x ", h.height, " pixels, expected 1 to ",
            max_image_edge, " a side");
}

/// Returns the image in 1 or 3 channels, or as it is for 0: grey from colour by the weights of
/// BT.601, colour from grey by repetition, without alpha.
inline Image8 with_channels(Image8 image, int channels) {
    if (channels == 0 || channels == image.channels) return image;
    Image8 out{image.width, image.height, channels, {}};
    const std::size_t pixels = std::size_t(image.width) * std::size_t(image.height);
    const auto from_channels = static_cast<std::size_t>(image.channels);
    out.values.resize(pixels * static_cast<std::size_t>(channels));
    std::uint8_t* to = out.values.data();
    for (std::size_t i = 0; i < pixels; ++i) {
        const std::uint8_t* const from = image.values.data() + i * from_channels;
        const bool grey = from_channels < 3;
        if (channels == 1)
            *to++ = grey ? from[0]
                         : static_cast<std::uint8_t>(
                               (77 * from[0] + 150 * from[1] + 29 * from[2]) >> 8);
        else
            for (std::size_t c = 0; c < 3; ++c) *to++ = from[grey ? 0 : c];
    }
    return out;
}

/// Returns channels x pixels in [0, 1].
inline Image<float> to_float(const Image8& image) {
    Image<float> out;
    out.width = image.width;
    out.height = image.height;
    out.pixels.resize(image.channels, out.size());
    for (std::size_t i = 0; i < image.values.size(); ++i)
        out.pixels.data()[i] = static_cast<float>(image.values[i]) / 255.0f;
    return out;
}

} // namespace rye
