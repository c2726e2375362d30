// SPDX-License-Identifier: Apache-2.0
/// data/gaze_dots.hpp: dots on a screen that a person looked at while a camera filmed, as
/// docs/gaze_dots.html shows them and writes their times.
///
/// CSV: a line `begin_s,end_s,right_mm,up_mm`, then one line per dot in the order of their times, by
/// the page's own clock; where the dot is from the camera's lens, in the plane of the screen, as the
/// person sees it.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <rye/math/linalg.hpp>

namespace rye::trainer {

struct GazeDot {
    double begin = 0, end = 0;                    ///< by the page's clock [s]
    Vec2<double> right_up = Vec2<double>::Zero(); ///< from the camera [mm]
};

/// Returns the dots of a CSV; errors begin with `name` and the line, as below.
std::vector<GazeDot> parse_gaze_dots(std::string_view text, const std::string& name);

/// Reads a CSV of dots. Throws an Error for what is none: another first line, numbers that are not
/// finite, a dot that ends before it begins or begins before the last ended, one beyond 5 m, none.
std::vector<GazeDot> read_gaze_dots(const std::filesystem::path& path);

/// Returns the dot that is shown at a time [s], for `settled` seconds or longer.
std::optional<GazeDot> dot_at(const std::vector<GazeDot>& dots, double time, double settled = 0);

} // namespace rye::trainer
