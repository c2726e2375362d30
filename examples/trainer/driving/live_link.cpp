// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <functional>
#include <map>

#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>
#include <rye/core/parse.hpp>
#include <rye/math/rotation.hpp>

#include "data/csv.hpp"
#include "data/degrees.hpp"
#include "data/memory_limit.hpp"
#include "driving/face_names.hpp"
#include "driving/face_track.hpp"

namespace rye::trainer {
namespace {

/// Angles of a line in the order of these names; not all files have them.
constexpr std::array<const char*, 9> angle_names{"headyaw",     "headpitch",     "headroll",
                                                 "lefteyeyaw",  "lefteyepitch",  "lefteyeroll",
                                                 "righteyeyaw", "righteyepitch", "righteyeroll"};
constexpr std::size_t head_angles = 3;
constexpr double most_coefficient = 2, most_angle = 360;
/// Largest angle of a table in radians.
constexpr double most_radians = 1.6;

struct Line {
    double time = 0;
    VecX<double> coefficients;
    std::array<double, angle_names.size()> angles{};
};

struct Table {
    std::vector<std::string> names;
    std::array<bool, angle_names.size()> has{};
    std::vector<Line> lines;
    double frames = 0; ///< largest number of frames in a time
    int lost = 0;
};

/// Parses HOURS:MINUTES:SECONDS:FRAMES, or with ; before the frames. Times of the line are those of
/// frames 0; `frames` receives the frames, with a fraction.
double seconds_of(std::string_view text, double& frames, const std::string& who) {
    std::array<double, 4> part{};
    std::string_view rest = text;
    for (std::size_t k = 0; k < 4; ++k) {
        const std::size_t end = k < 3 ? rest.find_first_of(":;") : rest.size();
        const std::optional<double> x =
            end == std::string_view::npos ? std::nullopt : parse_double(rest.substr(0, end));
        constexpr std::array<double, 4> most{1000, 60, 61, 1000};
        require(x && *x >= 0 && *x < most[k], who + ": column 'Timecode'", "got '", text,
                "', expected HOURS:MINUTES:SECONDS:FRAMES");
        part[k] = *x;
        rest.remove_prefix(std::min(rest.size(), end + 1));
    }
    frames = part[3];
    return 3600 * part[0] + 60 * part[1] + part[2];
}

/// Destination of a column's number.
struct Column {
    std::string name;
    double most = 0;
    std::function<void(Line&, double)> set; ///< empty for what is not read
};

std::vector<Column> columns_of(std::string_view header, Table& table, const std::string& who) {
    std::vector<Column> columns;
    std::map<std::string, int> seen;
    for (const std::string_view field : fields_of(header)) {
        const std::string name(field), plain = plain_name(field);
        require(seen.emplace(plain, 0).second, who + ": line 1", "names '", name, "' twice");
        const auto angle = std::find(angle_names.begin(), angle_names.end(), plain);
        if (plain == "timecode" || plain == "blendshapecount" || plain.empty()) {
            columns.push_back({name, 0, {}});
        } else if (angle != angle_names.end()) {
            const auto k = static_cast<std::size_t>(angle - angle_names.begin());
            table.has[k] = true;
            columns.push_back({name, most_angle, [k](Line& l, double x) { l.angles[k] = x; }});
        } else {
            const auto k = static_cast<Index>(table.names.size());
            table.names.push_back(name);
            columns.push_back(
                {name, most_coefficient, [k](Line& l, double x) { l.coefficients[k] = x; }});
        }
    }
    require(!table.names.empty(), who + ": line 1",
            "has no coefficients after Timecode, expected "
            "columns such as EyeBlinkLeft and JawOpen");
    return columns;
}

/// Reads a line. Returns false for one without numbers: no face was seen.
bool read_line(std::string_view text, const std::vector<Column>& columns, Line& line,
               const std::string& who) {
    const std::vector<std::string_view> fields = fields_of(text);
    const bool empty = std::all_of(fields.begin() + std::min<std::ptrdiff_t>(2, std::ssize(fields)),
                                   fields.end(), [](std::string_view f) { return f.empty(); });
    if (empty) return false;
    require(fields.size() == columns.size(), who, "got ", fields.size(), " fields, expected ",
            columns.size(), " as line 1 has");
    for (std::size_t i = 1; i < columns.size(); ++i) {
        const Column& c = columns[i];
        if (!c.set) continue;
        const std::optional<double> x = parse_double(fields[i]);
        require(x && std::abs(*x) <= c.most, who, "column '", c.name, "': got '", fields[i],
                "', expected a number from ", -c.most, " to ", c.most);
        c.set(line, *x);
    }
    return true;
}

Table read_table(std::string_view text, const std::string& who) {
    Table table;
    text = without_mark(text);
    const std::vector<Column> columns = columns_of(take_line(text), table, who);
    const auto count = static_cast<Index>(table.names.size());
    std::vector<double> frames;
    int before = 0; // lines without a face before the first with one
    for (std::size_t number = 2; !text.empty(); ++number) {
        const std::string_view each = take_line(text);
        if (each.empty()) continue;
        const std::string at = who + ": line " + std::to_string(number);
        require_memory((2 * sizeof(Line) + 8 * static_cast<std::uint64_t>(count) + 64) *
                           (table.lines.size() + 1),
                       memory_limit(), at, "the pictures to here");
        Line line;
        line.coefficients = VecX<double>::Zero(count);
        double frame = 0;
        line.time = seconds_of(fields_of(each).front(), frame, at);
        table.frames = std::max(table.frames, frame);
        if (!read_line(each, columns, line, at)) {
            ++table.lost;
            if (table.lines.empty()) {
                ++before;
                continue;
            }
            line.coefficients = table.lines.back().coefficients;
            line.angles = table.lines.back().angles;
        }
        frames.push_back(frame);
        table.lines.push_back(std::move(line));
    }
    table.lost -= before; // they are left out
    require(!table.lines.empty(), who, "has no picture with a face, expected a line for each");
    // Frames a second: Live Link Face records 60, others the least usual rate that holds them.
    double rate = 60;
    if (table.lines.back().time > table.lines.front().time)
        for (const double usual : {60.0, 50.0, 30.0, 25.0, 24.0})
            if (table.frames < usual) rate = usual;
    if (table.frames >= rate) rate = std::floor(table.frames) + 1;
    for (std::size_t i = 0; i < table.lines.size(); ++i) table.lines[i].time += frames[i] / rate;
    return table;
}

/// The sign and unit of an angle, by a coefficient of looking that it follows.
struct Agreement {
    double correlation = 0, slope = 0;
};

/// Compares a column of angles with looks in the direction that is + in the head frame.
Agreement agreement(const Table& t, std::size_t angle, const VecX<double>& looks) {
    const auto n = static_cast<Index>(t.lines.size());
    VecX<double> a(n);
    for (Index i = 0; i < n; ++i) a[i] = t.lines[static_cast<std::size_t>(i)].angles[angle];
    const VecX<double> x = a.array() - a.mean(), y = looks.array() - looks.mean();
    const double xx = x.squaredNorm(), yy = y.squaredNorm(), xy = x.dot(y);
    constexpr double least = 0.02; // of looks' deviation, below which they are noise
    if (yy < least * least * static_cast<double>(n) || xx <= 0) return {};
    return {xy / std::sqrt(xx * yy), xy / yy};
}

/// Returns the sum of the coefficients `plus` less those of `minus` in each picture; empty without
/// these.
VecX<double> looks_of(const Table& t, const std::string& plus, const std::string& minus) {
    const std::optional<Index> p = index_of_name(t.names, plus), m = index_of_name(t.names, minus);
    if (!p || !m) return {};
    VecX<double> r(static_cast<Index>(t.lines.size()));
    for (std::size_t i = 0; i < t.lines.size(); ++i)
        r[static_cast<Index>(i)] = t.lines[i].coefficients[*p] - t.lines[i].coefficients[*m];
    return r;
}

double largest(const Table& t, std::size_t from, std::size_t to) {
    double most = 0;
    for (const Line& l : t.lines)
        for (std::size_t k = from; k < to; ++k) most = std::max(most, std::abs(l.angles[k]));
    return most;
}

} // namespace

bool is_live_link(std::string_view text) {
    text = without_mark(text);
    return plain_name(fields_of(take_line(text)).front()) == "timecode";
}

FaceTrack parse_live_link(std::string_view text, const std::string& who) {
    const Table t = read_table(text, who);
    FaceTrack track;
    track.kind = "Live Link Face";
    track.names = t.names;
    track.timed = true;
    track.lost = t.lost;

    // The angles of eyes, and looks that are + where the head frame's angle is.
    struct Eye {
        std::size_t angle, eye;
        bool yaw;
        const char *plus, *minus;
        double unreal; ///< sign of Unreal's rotators in the head frame
    };
    const std::array<Eye, 4> eyes{{{3, 0, true, "eyeLookOutLeft", "eyeLookInLeft", -1},
                                   {4, 0, false, "eyeLookUpLeft", "eyeLookDownLeft", 1},
                                   {6, 1, true, "eyeLookInRight", "eyeLookOutRight", -1},
                                   {7, 1, false, "eyeLookUpRight", "eyeLookDownRight", 1}}};
    const bool has_eyes =
        std::all_of(eyes.begin(), eyes.end(), [&](const Eye& e) { return t.has[e.angle]; });
    std::array<double, 4> sign{};
    bool degrees_of_eyes = largest(t, head_angles, angle_names.size()) > most_radians;
    if (has_eyes) {
        constexpr double sure = 0.5;     // correlation
        constexpr double most_slope = 5; // a look of 1 is 0.6 radians or 35 degrees
        std::string turned;
        for (std::size_t k = 0; k < eyes.size(); ++k) {
            sign[k] = eyes[k].unreal;
            const VecX<double> looks = looks_of(t, eyes[k].plus, eyes[k].minus);
            if (looks.size() == 0) continue;
            const Agreement a = agreement(t, eyes[k].angle, looks);
            if (std::abs(a.correlation) < sure) continue;
            degrees_of_eyes = degrees_of_eyes || std::abs(a.slope) > most_slope;
            const double found = a.correlation > 0 ? 1 : -1;
            if (found != sign[k])
                turned += std::string(turned.empty() ? "" : ", ") + angle_names[eyes[k].angle];
            sign[k] = found;
        }
        if (!turned.empty())
            track.notes.push_back("signs of " + turned +
                                  " are turned, as the coefficients of looking say");
    }
    const bool has_head = t.has[0] && t.has[1] && t.has[2];
    const bool degrees_of_head =
        largest(t, 0, head_angles) > most_radians || (has_eyes && degrees_of_eyes);
    if (has_eyes || has_head)
        track.notes.push_back(std::string("angles are ") +
                              (degrees_of_eyes == degrees_of_head || !has_eyes
                                   ? (degrees_of_head ? "degrees" : "radians")
                                   : "of the eyes radians, of the head degrees"));
    const double eye_unit = degrees_of_eyes ? degree : 1, head_unit = degrees_of_head ? degree : 1;
    const double begin = t.lines.front().time;
    for (const Line& l : t.lines) {
        TrackedFace f;
        f.time = l.time - begin;
        f.coefficients = l.coefficients;
        if (has_eyes)
            for (std::size_t k = 0; k < eyes.size(); ++k) {
                std::optional<Vec2<double>>& gaze = f.gaze[eyes[k].eye];
                if (!gaze) gaze = Vec2<double>::Zero();
                (*gaze)[eyes[k].yaw ? 1 : 0] = sign[k] * eye_unit * l.angles[eyes[k].angle];
            }
        if (has_head)
            f.turn = head_turn(-head_unit * l.angles[0], head_unit * l.angles[1],
                               head_unit * l.angles[2]);
        track.faces.push_back(std::move(f));
    }
    return track;
}

} // namespace rye::trainer
