// SPDX-License-Identifier: Apache-2.0
#include "importers/video_tracks.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

#include <rye/core/error.hpp>

#include "data/json_fields.hpp"
#include "importers/face_mesh.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr int largest_side = 16384, most_faces = 1000;
constexpr double largest_number = 1e6;

int whole(const Json& object, const char* key, int low, int high, const std::string& who) {
    require(object.contains(key), who + ": " + key, "is missing, expected a whole number");
    const Json& value = object.at(key);
    require(
        value.is_number_integer() && value.get<double>() >= low && value.get<double>() <= high,
        who + ": " + key, "got ", [&] { return json_excerpt(value); }, ", expected a whole number from ",
        low, " to ", high);
    return value.get<int>();
}

double bounded(const Json& value, const std::string& who) {
    const double x = json_number(value, who);
    require(std::abs(x) <= largest_number, who, "got ", x, ", expected at most 1e6");
    return x;
}

const Json& list_of(const Json& object, const char* key, std::size_t size, const std::string& who) {
    const std::string expected = "a list of " + std::to_string(size);
    const Json& list = json_list(object, key, who, expected.c_str());
    require(list.size() == size, who + ": " + key, "got ", list.size(), " values, expected ", size);
    return list;
}

/// Reads a path that stays in the tracks' folder.
fs::path path_of(const Json& object, const char* key, const std::string& who) {
    const fs::path path = json_text(object, key, std::string(), who);
    const bool inside = path.is_relative() && !path.empty() &&
                        std::none_of(path.begin(), path.end(),
                                     [](const fs::path& part) { return part == ".."; });
    require(inside, who + ": " + key, "got '", path.string(), "', expected a file in this folder");
    return path;
}

Columns<double> landmarks_of(const Json& json, const std::string& who) {
    const Json& list = list_of(json, "landmarks", face_landmarks, who);
    Columns<double> points(3, face_landmarks);
    for (Index i = 0; i < points.cols(); ++i) {
        const Json& point = list.at(static_cast<std::size_t>(i));
        const std::string at = who + ": landmarks: " + std::to_string(i);
        require(
            point.is_array() && point.size() == 3, at, "got ", [&] { return json_excerpt(point); },
            ", expected 3 numbers");
        for (Index d = 0; d < 3; ++d) points(d, i) = bounded(point.at(static_cast<std::size_t>(d)), at);
    }
    return points;
}

Rigid<double> head_of(const Json& json, const std::string& who) {
    const Json& list = list_of(json, "matrix", 16, who);
    Mat<double, 4, 4> m;
    for (std::size_t i = 0; i < 16; ++i)
        m(static_cast<Index>(i % 4), static_cast<Index>(i / 4)) =
            bounded(list.at(i), who + ": matrix: " + std::to_string(i));
    const Mat3<double> turned = m.topLeftCorner<3, 3>();
    const double scale = std::cbrt(turned.determinant());
    const Mat3<double> rotation = turned / scale;
    require(scale > 1e-3 &&
                (rotation * rotation.transpose() - Mat3<double>::Identity()).cwiseAbs().maxCoeff() <
                    0.05,
            who + ": matrix", "is no rotation with a translation");
    constexpr double dm_per_cm = 0.1;
    return {rotation, dm_per_cm * m.topRightCorner<3, 1>() / scale};
}

void read_coefficients(TrackedPicture& p, Tracks& tracks, const Json& json, const std::string& who) {
    const std::string field = who + ": coefficients";
    require(json.contains("coefficients") && json.at("coefficients").is_object() &&
                !json.at("coefficients").empty(),
            field, "is missing, expected numbers by their names");
    const Json& all = json.at("coefficients");
    if (tracks.names.empty())
        for (const auto& [name, value] : all.items()) tracks.names.push_back(name);
    require(all.size() == tracks.names.size(), field, "got ", all.size(), ", expected ",
            tracks.names.size(), " as in the pictures before");
    p.coefficients.resize(static_cast<Index>(all.size()));
    for (std::size_t i = 0; i < tracks.names.size(); ++i) {
        const std::string& name = tracks.names[i];
        require(all.contains(name), field, "has no ", name, ", which pictures before have");
        const double x = json_number(all.at(name), field + "." + name);
        require(x >= 0 && x <= 1, field + "." + name, "got ", x, ", expected 0 to 1");
        p.coefficients[static_cast<Index>(i)] = x;
    }
}

} // namespace

void add_tracks(Tracks& tracks, std::string_view text, const std::string& who) {
    int number = 0, line = 1;
    for (std::size_t begin = 0; begin < text.size(); ++line) {
        const std::size_t end = std::min(text.find('\n', begin), text.size());
        const std::string at = who + ": line " + std::to_string(line);
        const Json json = parse_json_text<Json>(text.substr(begin, end - begin), at);
        begin = end + 1;
        require(json.is_object(), at, "is no object, expected one of a picture");
        TrackedPicture p;
        p.number = json.contains("number") ? whole(json, "number", 0, 100000000, at) : number;
        number = p.number + 1;
        p.picture = path_of(json, "picture", at);
        p.time = json_number(json, "time", 0.0, at);
        const Json& size = list_of(json, "size", 2, at);
        std::array<int, 2> sides{};
        for (std::size_t k = 0; k < 2; ++k) {
            const double side = json_number(size.at(k), at + ": size");
            require(side >= 16 && side <= largest_side && side == std::floor(side), at + ": size",
                    "got ", side, ", expected 16 to ", largest_side, " pixels");
            sides[k] = static_cast<int>(side);
        }
        if (tracks.width == 0) tracks.width = sides[0], tracks.height = sides[1];
        require(tracks.width == sides[0] && tracks.height == sides[1], at + ": size", "got ",
                sides[0], " x ", sides[1], ", expected ", tracks.width, " x ", tracks.height,
                " as in the pictures before: all videos of one import are of one camera");
        p.faces = whole(json, "faces", 0, most_faces, at);
        if (p.faces > 0) {
            p.landmarks = landmarks_of(json, at);
            p.head = head_of(json, at);
            read_coefficients(p, tracks, json, at);
            p.sharpness = json_number(json, "sharpness", 0.0, at);
            p.mask = path_of(json, "mask", at);
        }
        tracks.pictures.push_back(std::move(p));
    }
}

Tracks read_tracks(const std::vector<fs::path>& folders) {
    Tracks tracks;
    int video = 0;
    for (const fs::path& folder : folders) {
        const fs::path file = folder / "tracks.jsonl";
        require(fs::exists(file), file.string(), "no such file, expected the tracks of a video");
        const std::size_t before = tracks.pictures.size();
        add_tracks(tracks, as_text(read_file(file, std::uint64_t(1) << 32U)), file.string());
        require(tracks.pictures.size() > before, file.string(), "is empty, expected the tracks of a video");
        for (std::size_t i = before; i < tracks.pictures.size(); ++i) {
            TrackedPicture& p = tracks.pictures[i];
            p.video = video;
            p.picture = folder / p.picture;
            if (!p.mask.empty()) p.mask = folder / p.mask;
        }
        ++video;
    }
    return tracks;
}

} // namespace rye::trainer
