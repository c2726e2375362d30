// SPDX-License-Identifier: Apache-2.0
/// data/panel.hpp: composition of images into panels.
#pragma once

#include <vector>

#include <rye/core/columns.hpp>

namespace rye::trainer {

/// Returns an image enlarged by a whole factor, to about the given width.
Image<float> enlarged(const Image<float>& image, int width);

/// Places images of one height side by side, with a thin gap.
Image<float> side_by_side(const std::vector<Image<float>>& images);

/// Returns one of `count` images of one width from the result of side_by_side; throws an Error if
/// the row has another width.
Image<float> row_part(const Image<float>& row, int part, int count);

/// Stacks images of one width, with a thin gap.
Image<float> stacked(const std::vector<Image<float>>& images);

/// Returns the rectangle [x, x + w) x [y, y + h), clipped to the image.
Image<float> cropped(const Image<float>& image, int x, int y, int w, int h);

} // namespace rye::trainer
