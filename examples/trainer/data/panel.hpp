// SPDX-License-Identifier: Apache-2.0
/// data/panel.hpp: pictures put together from pictures.
#pragma once

#include <vector>

#include <rye/core/columns.hpp>

namespace rye::trainer {

/// Repeats pixels up to about the given width (a whole factor).
Image<float> enlarged(const Image<float>& image, int width);

/// All of one height, with a thin gap.
Image<float> side_by_side(const std::vector<Image<float>>& images);

/// All of one width, with a thin gap.
Image<float> stacked(const std::vector<Image<float>>& images);

/// The rectangle [x, x + w) x [y, y + h), cut to the image.
Image<float> cropped(const Image<float>& image, int x, int y, int w, int h);

} // namespace rye::trainer
