// SPDX-License-Identifier: Apache-2.0
#include "data/panel.hpp"

#include <algorithm>

#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

constexpr int gap = 2;             // [px]
constexpr float gap_color = 1.0f;  // white

void paste(const Image<float>& from, Image<float>& to, int left, int top) {
    for (int y = 0; y < from.height; ++y)
        for (int x = 0; x < from.width; ++x) to.at(left + x, top + y) = from.at(x, y);
}

Image<float> joined_images(const std::vector<Image<float>>& images, bool across) {
    require(!images.empty(), "joined_images", "no images given");
    int width = 0, height = 0;
    for (const Image<float>& i : images) {
        width = across ? width + i.width : std::max(width, i.width);
        height = across ? std::max(height, i.height) : height + i.height;
    }
    (across ? width : height) += gap * (static_cast<int>(images.size()) - 1);
    Image<float> out(width, height, images.front().channels(), gap_color);
    int at = 0;
    for (const Image<float>& i : images) {
        paste(i, out, across ? at : 0, across ? 0 : at);
        at += (across ? i.width : i.height) + gap;
    }
    return out;
}

} // namespace

Image<float> enlarged(const Image<float>& image, int width) {
    const int factor = std::max(1, width / std::max(1, image.width));
    if (factor == 1) return image;
    Image<float> out(image.width * factor, image.height * factor, image.channels());
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) out.at(x, y) = image.at(x / factor, y / factor);
    return out;
}

Image<float> side_by_side(const std::vector<Image<float>>& images) {
    return joined_images(images, true);
}

Image<float> row_part(const Image<float>& row, int part, int count) {
    const int all = row.width - gap * (count - 1);
    require(count > 0 && all >= count && all % count == 0, "row_part", "got a picture of width ",
            row.width, ", expected ", count, " pictures of one width side by side");
    const int width = all / count;
    return cropped(row, part * (width + gap), 0, width, row.height);
}

Image<float> stacked(const std::vector<Image<float>>& images) { return joined_images(images, false); }

Image<float> cropped(const Image<float>& image, int x, int y, int w, int h) {
    const int x0 = std::clamp(x, 0, image.width - 1), y0 = std::clamp(y, 0, image.height - 1);
    const int x1 = std::clamp(x + w, x0 + 1, image.width), y1 = std::clamp(y + h, y0 + 1, image.height);
    Image<float> out(x1 - x0, y1 - y0, image.channels());
    for (int j = y0; j < y1; ++j)
        for (int i = x0; i < x1; ++i) out.at(i - x0, j - y0) = image.at(i, j);
    return out;
}

} // namespace rye::trainer
