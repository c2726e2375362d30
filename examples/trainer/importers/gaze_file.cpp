// SPDX-License-Identifier: Apache-2.0
#include "importers/gaze_file.hpp"

#include <cmath>
#include <optional>
#include <sstream>

#include <rye/io/npz.hpp>
#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>
#include <rye/core/parse.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "data/memory_limit.hpp"

namespace rye::trainer {
namespace {

constexpr const char* header = "frame,left_pitch,left_yaw,right_pitch,right_yaw";

std::vector<std::string> fields(std::string line) {
    if (!line.empty() && line.back() == '\r') line.pop_back();
    std::vector<std::string> all;
    std::istringstream in(line);
    for (std::string field; std::getline(in, field, ',');) {
        const std::size_t begin = field.find_first_not_of(" \t");
        const std::size_t end = field.find_last_not_of(" \t");
        all.push_back(begin == std::string::npos ? "" : field.substr(begin, end - begin + 1));
    }
    return all;
}

Vec3<double> in_range(const Vec3<double>& gaze, const std::string& who) {
    const Vec3<double> ahead(0, 0, 1);
    require(
        !beyond_gaze_range(gaze), who, "got ",
        [&] { return std::to_string(degrees * angular_error(gaze, ahead)); },
        " degrees from straight ahead, expected at most ",
        [&] { return std::to_string(degrees * gaze_range); });
    return gaze;
}

} // namespace

std::map<std::string, GazeRow> parse_gaze_csv(std::string_view text, const std::string& name) {
    std::istringstream in{std::string(text)};
    std::map<std::string, GazeRow> rows;
    std::string line;
    for (int number = 1; std::getline(in, line); ++number) {
        const std::string who = name + ": line " + std::to_string(number);
        const std::vector<std::string> field = fields(line);
        if (number == 1) {
            require(field == fields(header), who, "got '", line.substr(0, 80), "', expected '",
                    header, "'");
            continue;
        }
        if (field.empty()) continue;
        require(field.size() == 5, who, "got ", field.size(), " fields, expected 5: ", header);
        std::array<double, 4> angle{};
        for (std::size_t i = 0; i < 4; ++i) {
            const std::optional<double> x = parse_double(field[i + 1]);
            require(x && std::isfinite(*x) && std::abs(*x) <= 90,
                    who + ": " + fields(header)[i + 1], "got '", field[i + 1],
                    "', expected degrees, -90 to 90");
            angle[i] = *x / degrees;
        }
        const GazeRow row{in_range(gaze_vector(angle[0], angle[1]), who + ": left"),
                          in_range(gaze_vector(angle[2], angle[3]), who + ": right")};
        require_memory((rows.size() + 1) * (2 * sizeof(GazeRow) + field[0].size() + 64),
                       memory_limit(), who, "the rows to here");
        require(rows.emplace(field[0], row).second, who, "names the frame '", field[0], "' twice");
    }
    return rows;
}

namespace {

std::map<std::string, GazeRow> from_csv(const std::filesystem::path& path) {
    const Bytes bytes = read_file(path, 1ULL << 26U);
    return parse_gaze_csv(as_text(bytes), path.string());
}

std::map<std::string, GazeRow> from_npz(const std::filesystem::path& path,
                                        const std::vector<std::string>& frames) {
    const NpzArrays arrays = read_npz(path, memory_limit());
    std::map<std::string, GazeRow> rows;
    const auto count = static_cast<Index>(frames.size());
    for (std::size_t e = 0; e < 2; ++e) {
        const std::string name = e == 0 ? "gaze_left" : "gaze_right";
        const std::string who = path.string() + ": " + name;
        const auto found = arrays.find(name);
        require(found != arrays.end(), who, "is missing");
        const std::vector<Index> shape{count, 3};
        require(
            found->second.shape == shape, who, "got shape ",
            [&] { return shape_text(found->second.shape); }, ", expected ",
            [&] { return shape_text(shape); }, ", one row a frame");
        const std::vector<double> v = found->second.values<double>(who);
        for (std::size_t i = 0; i < frames.size(); ++i) {
            const Vec3<double> gaze(v[3 * i], v[3 * i + 1], v[3 * i + 2]);
            const std::string row = who + ": row " + std::to_string(i);
            require(
                gaze.allFinite() && std::abs(gaze.norm() - 1) < 1e-3, row,
                "got a vector of length ", [&] { return std::to_string(gaze.norm()); },
                ", expected a unit vector");
            rows[frames[i]][e] = in_range(normalized(gaze), row);
        }
    }
    return rows;
}

} // namespace

std::map<std::string, GazeRow> read_gaze_file(const std::filesystem::path& path,
                                              const std::vector<std::string>& frames) {
    const std::string suffix = path.extension().string();
    require(suffix == ".csv" || suffix == ".npz", path.string(), "got the ending '", suffix,
            "', expected .csv or .npz");
    auto rows = suffix == ".csv" ? from_csv(path) : from_npz(path, frames);
    for (const std::string& frame : frames)
        require(rows.contains(frame), path.string(), "has no line for the frame '", frame,
                "', expected every frame of the source");
    return rows;
}

} // namespace rye::trainer
