// SPDX-License-Identifier: Apache-2.0
#include "data/driver_table.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <set>

#include <rye/io/bytes.hpp>
#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/core/memory.hpp>
#include <rye/core/parse.hpp>
#include <rye/rig/pupil.hpp>

#include "data/csv.hpp"
#include "data/degrees.hpp"
#include "data/memory_limit.hpp"

namespace rye::trainer {
namespace {

constexpr std::uint64_t most_bytes = 1ULL << 30U;
constexpr double most_pitch = 90, most_yaw = 180; // of any direction
constexpr double most_number = 1e9;

constexpr const char* sides[] = {"left", "right"};
constexpr const char* axes[] = {"x", "y", "z"};

std::string gaze_column(std::size_t eye, bool yaw) {
    return std::string("gaze_") + sides[eye] + (yaw ? "_yaw" : "_pitch");
}

std::string pupil_column(std::size_t eye) { return std::string("pupil_") + sides[eye]; }

/// Pitch and yaw of both eyes [deg].
struct Angles {
    double pitch[2], yaw[2];
};

struct Row {
    Drivers<float> drivers;
    Angles gaze;
    std::array<float, 2> pupil{1, 1};
};

/// Destination of a column's number, and its bounds.
struct Column {
    std::string name;
    double least = -most_number, most = most_number;
    std::function<void(Row&, double)> set; ///< empty for text that is not read
};

std::map<std::string, Column> known_columns(const DriverNames& names, bool pupils) {
    std::map<std::string, Column> all;
    const auto add = [&](Column c) { all.emplace(c.name, std::move(c)); };
    add({"frame", 0, 0, {}});
    for (int k = 0; k < names.expression; ++k) {
        const auto set = [k](Row& r, double x) { r.drivers.expression[k] = static_cast<float>(x); };
        add({"expression_" + std::to_string(k), -most_number, most_number, set});
        if (static_cast<std::size_t>(k) < names.coefficients.size())
            add({names.coefficients[static_cast<std::size_t>(k)], -most_number, most_number, set});
    }
    for (int k = 0; k < 3; ++k) {
        const std::string axis = axes[k];
        add({"rotation_" + axis, -10, 10,
             [k](Row& r, double x) { r.drivers.pose[k] = static_cast<float>(x); }});
        add({"translation_" + axis, -most_number, most_number,
             [k](Row& r, double x) { r.drivers.pose[3 + k] = static_cast<float>(x); }});
    }
    add({"scale", 1e-9, most_number,
         [](Row& r, double x) { r.drivers.scale = static_cast<float>(x); }});
    for (std::size_t e = 0; e < 2; ++e) {
        add({gaze_column(e, false), -most_pitch, most_pitch,
             [e](Row& r, double x) { r.gaze.pitch[e] = x; }});
        add({gaze_column(e, true), -most_yaw, most_yaw,
             [e](Row& r, double x) { r.gaze.yaw[e] = x; }});
        if (pupils)
            add({pupil_column(e), least_pupil, most_pupil,
                 [e](Row& r, double x) { r.pupil[e] = static_cast<float>(x); }});
    }
    return all;
}

/// Returns the columns that the first line names.
std::vector<Column> header_of(std::string_view line, const std::string& who,
                              const DriverNames& names, bool pupils) {
    const std::map<std::string, Column> known = known_columns(names, pupils);
    std::vector<Column> columns;
    std::set<std::string> seen;
    for (const std::string_view field : fields_of(line)) {
        const std::string name(field);
        const auto found = known.find(name);
        require(found != known.end(), who + ": line 1", "column ", columns.size() + 1, " is '",
                name, "', expected frame, expression_0 to expression_",
                std::max(0, names.expression - 1),
                (names.coefficients.empty() ? "" : " (or the coefficients' names)"),
                ", rotation_x, _y, _z, translation_x, _y, _z, scale, gaze_left_pitch, "
                "gaze_left_yaw, gaze_right_pitch or gaze_right_yaw",
                (pupils ? ", pupil_left or pupil_right" : ""));
        require(seen.insert(name).second, who + ": line 1", "names '", name, "' twice");
        columns.push_back(found->second);
    }
    const auto together = [&](const std::vector<std::string>& group) {
        std::size_t there = 0;
        std::string missing;
        for (const std::string& name : group) {
            there += seen.count(name);
            if (!seen.contains(name) && missing.empty()) missing = name;
        }
        require(there == 0 || there == group.size(), who + ": line 1", "the column '", missing,
                "' is missing beside ", (group.front() == missing ? group.back() : group.front()));
    };
    together({"rotation_x", "rotation_y", "rotation_z"});
    together({"translation_x", "translation_y", "translation_z"});
    for (std::size_t e = 0; e < 2; ++e) together({gaze_column(e, false), gaze_column(e, true)});
    return columns;
}

Row row_of(std::string_view line, const std::string& who,
           const std::vector<Column>& columns, const Row& otherwise) {
    const std::vector<std::string_view> fields = fields_of(line);
    require(fields.size() == columns.size(), who, "got ", fields.size(), " fields, expected ",
            columns.size(), " as line 1 has");
    Row row = otherwise;
    std::array<bool, 2> looks{};
    for (std::size_t i = 0; i < columns.size(); ++i) {
        const Column& c = columns[i];
        if (!c.set) continue;
        const std::optional<double> x = parse_double(fields[i]);
        require(x && *x >= c.least && *x <= c.most, who, "column '", c.name, "': got '", fields[i],
                "', expected a number from ", c.least, " to ", c.most);
        c.set(row, *x);
        for (std::size_t e = 0; e < 2; ++e) looks[e] = looks[e] || c.name == gaze_column(e, true);
    }
    for (std::size_t e = 0; e < 2; ++e)
        if (looks[e])
            row.drivers.gaze[e] =
                gaze_vector(row.gaze.pitch[e] * degree, row.gaze.yaw[e] * degree).cast<float>();
    return row;
}

Angles angles_of(const Drivers<float>& d) {
    Angles a{};
    for (std::size_t e = 0; e < 2; ++e) {
        const Vec2<double> angles = pitch_yaw(Vec3<double>(d.gaze[e].cast<double>()));
        a.pitch[e] = angles[0] / degree;
        a.yaw[e] = angles[1] / degree;
    }
    return a;
}

} // namespace

std::vector<Drivers<float>> parse_drivers(std::string_view text, const std::string& name,
                                          const DriverNames& names,
                                          const Drivers<float>& otherwise,
                                          std::vector<std::array<float, 2>>* pupils) {
    text = without_mark(text);
    require(!text.empty(), name, "is empty, expected a line of names of columns");
    const std::vector<Column> columns = header_of(take_line(text), name, names, pupils != nullptr);
    const bool dilates = std::any_of(columns.begin(), columns.end(), [](const Column& c) {
        return c.name == pupil_column(0) || c.name == pupil_column(1);
    });
    const Row usual{otherwise, angles_of(otherwise)};
    std::vector<Drivers<float>> frames;
    // Memory per frame in a list that has grown to twice its length.
    const std::uint64_t each =
        2 * sizeof(Drivers<float>) + 4 * static_cast<std::uint64_t>(names.expression) + 32;
    for (std::size_t number = 2; !text.empty(); ++number) {
        const std::string_view line = take_line(text);
        if (line.empty()) continue;
        require_memory(each * (frames.size() + 1), memory_limit(),
                       name + ": line " + std::to_string(number), "the frames to here");
        Row row = row_of(line, name + ": line " + std::to_string(number), columns, usual);
        frames.push_back(std::move(row.drivers));
        if (dilates) pupils->push_back(row.pupil);
    }
    require(!frames.empty(), name, "has no line after its names of columns, expected one a frame");
    return frames;
}

std::vector<Drivers<float>> read_drivers(const std::filesystem::path& path,
                                         const DriverNames& names,
                                         const Drivers<float>& otherwise,
                                         std::vector<std::array<float, 2>>* pupils) {
    const Bytes bytes = read_file(path, most_bytes);
    return parse_drivers(as_text(bytes), path.string(), names, otherwise, pupils);
}

std::string text_of_drivers(const std::vector<Drivers<float>>& frames,
                            const std::vector<std::string>& ids,
                            const std::vector<std::array<float, 2>>& pupils) {
    RYE_ASSERT(!frames.empty() && frames.size() == ids.size(),
               "text_of_drivers: no frames, or not an id for each");
    std::string text = "frame";
    for (Index k = 0; k < frames.front().expression.size(); ++k)
        text += ",expression_" + std::to_string(k);
    for (const char* what : {"rotation_", "translation_"})
        for (const char* axis : axes) text += std::string(",") + what + axis;
    text += ",scale";
    for (std::size_t e = 0; e < 2; ++e)
        text += "," + gaze_column(e, false) + "," + gaze_column(e, true);
    for (std::size_t e = 0; !pupils.empty() && e < 2; ++e) text += "," + pupil_column(e);
    text += "\n";
    const auto add = [&](auto x) { text += "," + number_text(x); };
    const auto add_angle = [&](double angle) { add(std::round(angle * 1e7) / 1e7 + 0.0); };
    for (std::size_t f = 0; f < frames.size(); ++f) {
        const Drivers<float>& d = frames[f];
        std::string id = ids[f];
        std::replace(id.begin(), id.end(), ',', '_');
        text += id;
        for (Index k = 0; k < d.expression.size(); ++k)
            add(d.expression[k]);
        for (Index k = 0; k < 6; ++k) add(d.pose[k]);
        add(d.scale);
        const Angles a = angles_of(d);
        for (std::size_t e = 0; e < 2; ++e) add_angle(a.pitch[e]), add_angle(a.yaw[e]);
        for (std::size_t e = 0; !pupils.empty() && e < 2; ++e) add(pupils[f][e]);
        text += "\n";
    }
    return text;
}

} // namespace rye::trainer
