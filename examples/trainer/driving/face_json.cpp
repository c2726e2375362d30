// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>

#include <Eigen/LU>

#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>

#include "data/csv.hpp"
#include "data/json_fields.hpp"
#include "data/memory_limit.hpp"
#include "driving/face_names.hpp"
#include "driving/face_track.hpp"
#include "driving/openxr_face.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::json;

constexpr double mm_per_cm = 10;
constexpr double largest_number = 1e6;

/// Returns the first of these fields that an object has, or null.
const Json* field_of(const Json& object, std::initializer_list<const char*> names) {
    for (const char* name : names)
        if (object.contains(name)) return &object.at(name);
    return nullptr;
}

/// Returns the value of the first face in a list; null if the list is empty.
const Json* first_face(const Json& list, const std::string& who) {
    require(
        list.is_array(), who, "got ", [&] { return json_excerpt(list); },
        ", expected a list with a value for each face");
    return list.empty() ? nullptr : &list.front();
}

double coefficient(const Json& value, const std::string& who) {
    const double x = json_number(value, who);
    require(std::abs(x) <= 2, who, "got ", x, ", expected 0 to 1");
    return x;
}

/// Coefficients by name, in the order of a file's first picture with any.
class Names {
  public:
    explicit Names(std::vector<std::string>& names) : names_(names) {}

    void set(VecX<double>& all, std::size_t position, const std::string& name, double x,
             const std::string& who) {
        if (!complete_) names_.push_back(name);
        require(position < names_.size() && names_[position] == name, who, "got the coefficient ",
                name, " at place ", position + 1,
                ", expected those of the pictures before, in "
                "their order");
        all.conservativeResize(static_cast<Index>(position) + 1);
        all[static_cast<Index>(position)] = x;
    }
    void finish(const VecX<double>& all, const std::string& who) {
        complete_ = true;
        require(all.size() == static_cast<Index>(names_.size()), who, "got ", all.size(),
                " coefficients, expected ", names_.size(), " as in the pictures before");
    }

  private:
    std::vector<std::string>& names_;
    bool complete_ = false;
};

/// Reads [[{categoryName, score}, ...]] or [{categories: [...]}] of the first face.
bool read_categories(const Json& list, TrackedFace& f, Names& names, const std::string& who) {
    const Json* face = first_face(list, who);
    if (face == nullptr) return false;
    if (face->is_object() && face->contains("categories")) face = &face->at("categories");
    require(
        face->is_array() && !face->empty(), who, "got ", [&] { return json_excerpt(*face); },
        ", expected a list of categories");
    for (std::size_t i = 0; i < face->size(); ++i) {
        const Json& c = face->at(i);
        const std::string at = who + ": category " + std::to_string(i);
        require(
            c.is_object(), at, "got ", [&] { return json_excerpt(c); }, ", expected an object");
        std::string name = json_text(c, "categoryName", "", at);
        if (name.empty()) name = json_text(c, "category_name", "", at);
        require(!name.empty(), at + ": categoryName", "is missing, expected a name");
        require(c.contains("score"), at + ": score", "is missing, expected a number");
        names.set(f.coefficients, i, name, coefficient(c.at("score"), at + ": score"), at);
    }
    names.finish(f.coefficients, who);
    return true;
}

/// Reads a matrix of 4 x 4: its columns or rows one after the other, rows as lists, or an object
/// with `data`. Its place is in centimetres.
void read_matrix(const Json& value, TrackedFace& f, const std::string& who) {
    const Json& list =
        value.is_object() ? json_list(value, "data", who, "a list of 16 numbers") : value;
    std::vector<double> all;
    const auto add = [&](const Json& x) {
        all.push_back(json_number(x, who));
        require(std::abs(all.back()) <= largest_number, who, "got ", all.back(),
                ", expected at most 1e6");
    };
    require(
        list.is_array() && (list.size() == 16 || list.size() == 4), who, "got ",
        [&] { return json_excerpt(list); }, ", expected 16 numbers, or 4 rows of 4");
    for (const Json& each : list)
        if (each.is_array())
            for (const Json& x : each) add(x);
        else
            add(each);
    require(all.size() == 16, who, "got ", all.size(), " numbers, expected 16");
    Mat<double, 4, 4> m;
    for (std::size_t i = 0; i < 16; ++i)
        m(static_cast<Index>(i / 4), static_cast<Index>(i % 4)) = all[i];
    const auto zero_row = [](const Mat<double, 4, 4>& x) {
        return x.row(3).head<3>().cwiseAbs().maxCoeff() == 0 && x(3, 3) == 1;
    };
    if (!zero_row(m)) m.transposeInPlace();
    require(zero_row(m), who, "is no motion: neither its last row nor its last column is 0 0 0 1");
    const Mat3<double> turned = m.topLeftCorner<3, 3>();
    const double scale = std::cbrt(turned.determinant());
    const Mat3<double> turn = turned / scale;
    require(scale > 1e-3 &&
                (turn * turn.transpose() - Mat3<double>::Identity()).cwiseAbs().maxCoeff() < 0.05,
            who, "is no rotation with a translation");
    f.turn = turn;
    f.place = mm_per_cm * m.topRightCorner<3, 1>() / scale;
}

/// Reads a picture. Returns false if it shows no face.
bool read_picture(const Json& e, FaceTrack& track, TrackedFace& f, Names& names,
                  const std::string& who) {
    require(
        e.is_object(), who, "got ", [&] { return json_excerpt(e); },
        ", expected an object for each picture");
    const auto kind = [&](const char* found) {
        require(track.kind.empty() || track.kind == found, who, "is of ", found,
                ", expected as before of ", track.kind);
        track.kind = found;
    };
    const bool has_ms = field_of(e, {"timestampMs", "timestamp_ms"}) != nullptr;
    const Json* const time = field_of(e, {"time", "timestampMs", "timestamp_ms"});
    if (e.contains("gaze") || e.contains("weights")) {
        kind("OpenXR");
        if (time != nullptr) f.time = 1e-9 * json_number(*time, who + ": time");
        const bool seen = read_openxr(e, f, who);
        if (track.names.empty() && f.coefficients.size() > 0) track.names = openxr_names();
        return seen;
    }
    if (time != nullptr)
        f.time =
            (has_ms ? 1e-3 : 1) * json_number(*time, who + (has_ms ? ": timestampMs" : ": time"));
    if (e.contains("coefficients") || e.contains("faces")) {
        kind("rye import video");
        if (!e.contains("coefficients")) return false;
        const Json& all = e.at("coefficients");
        const std::string at = who + ": coefficients";
        require(
            all.is_object() && !all.empty(), at, "got ", [&] { return json_excerpt(all); },
            ", expected numbers by their names");
        std::size_t i = 0;
        for (const auto& [name, value] : all.items())
            names.set(f.coefficients, i++, name, coefficient(value, at + "." + name), at);
        names.finish(f.coefficients, at);
        if (e.contains("matrix")) read_matrix(e.at("matrix"), f, who + ": matrix");
        return true;
    }
    const Json* const shapes = field_of(e, {"faceBlendshapes", "face_blendshapes"});
    require(shapes != nullptr, who,
            "has neither faceBlendshapes (MediaPipe), coefficients (rye "
            "import video) nor gaze and weights (OpenXR)");
    kind("MediaPipe");
    if (!read_categories(*shapes, f, names, who + ": faceBlendshapes")) return false;
    if (const Json* const m =
            field_of(e, {"facialTransformationMatrixes", "facial_transformation_matrixes"}))
        if (const Json* const face = first_face(*m, who + ": facialTransformationMatrixes"))
            read_matrix(*face, f, who + ": facialTransformationMatrixes");
    return true;
}

/// Reader of pictures one after the other.
class Pictures {
  public:
    explicit Pictures(const std::string& who) : who_(who), names_(track_.names) {}

    void add(const Json& picture, const std::string& at) {
        require_memory(
            (2 * sizeof(TrackedFace) + 8 * track_.names.size() + 128) * (track_.faces.size() + 1),
            memory_limit(), at, "the pictures to here");
        TrackedFace f;
        const bool seen = read_picture(picture, track_, f, names_, at);
        timed_ = timed_ && field_of(picture, {"time", "timestampMs", "timestamp_ms"}) != nullptr;
        if (!seen && track_.faces.empty()) return; // left out
        if (!seen) {
            ++track_.lost;
            const double time = f.time;
            f = track_.faces.back();
            f.time = time;
        }
        require(!timed_ || track_.faces.empty() || f.time >= track_.faces.back().time,
                at + ": time", "got ", f.time, " s, expected not before the picture before, at ",
                track_.faces.empty() ? 0.0 : track_.faces.back().time);
        track_.faces.push_back(std::move(f));
    }
    FaceTrack finish() {
        require(!track_.faces.empty(), who_, "has no picture with a face");
        track_.timed = timed_ && track_.faces.back().time > track_.faces.front().time;
        const double begin = track_.faces.front().time;
        for (TrackedFace& f : track_.faces) f.time -= begin;
        return std::move(track_);
    }

  private:
    const std::string& who_;
    FaceTrack track_;
    Names names_;
    bool timed_ = true;
};

/// Returns true if the first line is a whole object.
bool has_lines(std::string_view text) {
    const std::string_view line = take_line(text);
    const std::size_t last = line.find_last_not_of(" \t");
    return line.starts_with('{') && last != std::string_view::npos && line[last] == '}' &&
           text.find('{') != std::string_view::npos;
}

} // namespace

FaceTrack parse_face_json(std::string_view text, const std::string& who) {
    text = without_mark(text);
    Pictures pictures(who);
    if (has_lines(text)) {
        for (int line = 1; !text.empty(); ++line) {
            const std::string_view each = take_line(text);
            if (each.empty()) continue;
            const std::string at = who + ": line " + std::to_string(line);
            pictures.add(parse_json_text(each, at), at);
        }
        return pictures.finish();
    }
    const Json whole = parse_json_text(text, who);
    const Json* list = &whole;
    if (whole.is_object())
        if (const Json* const inside = field_of(whole, {"frames", "results"})) list = inside;
    if (!list->is_array()) {
        pictures.add(*list, who);
        return pictures.finish();
    }
    for (std::size_t i = 0; i < list->size(); ++i)
        pictures.add(list->at(i), who + ": picture " + std::to_string(i));
    return pictures.finish();
}

} // namespace rye::trainer
