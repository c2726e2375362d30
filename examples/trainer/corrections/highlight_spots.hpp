// SPDX-License-Identifier: Apache-2.0
/// corrections/highlight_spots.hpp: highlights on irises as spots, in photographs and in renders of
/// the same views: where each lies, and which of them the other picture has too.
/// Frames: pixels from the picture's left upper corner.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include <nlohmann/json.hpp>

#include "corrections/reflections.hpp"

namespace rye::trainer {

/// A bright spot on an iris.
struct HighlightSpot {
    int picture;        ///< number of the picture of an eye
    Vec2<double> at;    ///< middle by brightness [px]
    double brightness;  ///< the most that it adds to the iris there, mean of the channels
    double noise;       ///< standard deviation of what the iris shows without spots, by its median
    bool peaks;         ///< false if it is brightest at the rim of what is seen of the iris
    double iris_radius; ///< of that picture's iris [px]
    std::vector<std::size_t> pixels = {}; ///< numbers of its pixels in the list it was found in

    /// Returns true if it is clear enough to be counted: it peaks, and is brighter by 0.1 and by 5
    /// times the noise.
    bool clear() const { return peaks && brightness >= std::max(0.1, 5 * noise); }
};

/// Returns the spots, by picture, the brightest of each first. A spot is a group of at least 3
/// adjacent pixels that are brighter by 0.05 and by twice the picture's noise, in the mean of the
/// channels, than irises are there by themselves; `pixels` are less these colours already
/// (subtract_own_colours).
std::vector<HighlightSpot> highlight_spots(const std::vector<MirroredPixel>& pixels);

/// Spots of renders beside those of photographs.
struct HighlightMatch {
    int pictures = 0;             ///< of an eye
    int photographs = 0;          ///< of them, whose photograph has a clear spot
    int found = 0;                ///< of them, whose brightest clear spot the render has
    int renders = 0;              ///< clear spots of renders
    int unlike = 0;               ///< of them, that the photograph does not have
    std::vector<double> distance; ///< of each found spot from the photograph's [px]

    /// Returns the median of the distances [px]; NaN without any.
    double median_distance() const;
    /// Returns the counts and the median of the distances; null for fewer than 12 pictures, whose
    /// irises' own colours are not known.
    nlohmann::ordered_json json() const;
};

/// Returns which spots both pictures of an eye have: a clear spot of one that lies less than a
/// quarter of the iris' radius from a spot of the other. The photograph has a render's clear spot
/// also if, over its pixels, it is brighter in the mean by a third of what the render is: noise
/// hides spots, not their sum. Both lists have the same pixels.
HighlightMatch match_highlights(const Reflections& r);

} // namespace rye::trainer
