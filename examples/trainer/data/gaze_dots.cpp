// SPDX-License-Identifier: Apache-2.0
#include "data/gaze_dots.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>

#include <rye/io/bytes.hpp>
#include <rye/core/error.hpp>
#include <rye/core/parse.hpp>

namespace rye::trainer {
namespace {

constexpr std::string_view header = "begin_s,end_s,right_mm,up_mm";
constexpr double farthest_mm = 5000;

/// Returns the four numbers of a line.
std::array<double, 4> numbers_of(const std::string& line, const std::string& who) {
    std::array<double, 4> all{};
    std::istringstream in(line);
    std::size_t count = 0;
    for (std::string field; std::getline(in, field, ','); ++count) {
        if (count >= all.size()) continue;
        const std::optional<double> x = parse_double(field);
        require(x && std::isfinite(*x), who, "got '", field.substr(0, 40),
                "', expected a finite number");
        all[count] = *x;
    }
    require(count == all.size(), who, "got ", count, " fields, expected 4: ", header);
    return all;
}

} // namespace

std::vector<GazeDot> parse_gaze_dots(std::string_view text, const std::string& name) {
    std::istringstream in{std::string(text)};
    std::vector<GazeDot> dots;
    std::string line;
    for (int number = 1; std::getline(in, line); ++number) {
        const std::string who = name + ": line " + std::to_string(number);
        if (!line.empty() && line.back() == '\r') line.pop_back();
        if (number == 1) {
            require(line == header, who, "got '", line.substr(0, 80), "', expected '", header, "'");
            continue;
        }
        if (line.empty()) continue;
        const std::array<double, 4> x = numbers_of(line, who);
        require(x[1] > x[0], who, "its end, ", x[1], " s, is not after its begin, ", x[0], " s");
        require(dots.empty() || x[0] >= dots.back().end, who, "it begins at ", x[0],
                " s, before the last dot ended");
        require(std::max(std::abs(x[2]), std::abs(x[3])) <= farthest_mm, who, "got a dot ", x[2],
                " mm to the right and ", x[3], " mm above the camera, expected at most ", farthest_mm);
        dots.push_back({x[0], x[1], {x[2], x[3]}});
    }
    require(!dots.empty(), name, "has no dots");
    return dots;
}

std::vector<GazeDot> read_gaze_dots(const std::filesystem::path& path) {
    constexpr std::uint64_t most_bytes = 1 << 24;
    const Bytes bytes = read_file(path, most_bytes);
    return parse_gaze_dots(as_text(bytes), path.string());
}

std::optional<GazeDot> dot_at(const std::vector<GazeDot>& dots, double time, double settled) {
    const auto after = std::upper_bound(dots.begin(), dots.end(), time,
                                        [](double t, const GazeDot& d) { return t < d.begin; });
    if (after == dots.begin()) return std::nullopt;
    const GazeDot& dot = *(after - 1);
    if (time >= dot.end || time < dot.begin + settled) return std::nullopt;
    return dot;
}

} // namespace rye::trainer
