// SPDX-License-Identifier: Apache-2.0
#include "video_tracks_source.hpp"

#include <cmath>
#include <fstream>

#include <nlohmann/json.hpp>

#include <rye/core/random.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/picture.hpp"
#include "importers/face_geometry.hpp"
#include "importers/face_mesh.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

constexpr double degree = 0.017453292519943295;
constexpr double radius = 0.12, iris_plane = 0.1048, limbus = 0.0585; // [dm]

Vec3<double> eye_centre(std::size_t eye) { return {eye == 0 ? 0.31 : -0.31, 0.3, 0.5}; }

/// The middle of the lids, from which an import places an average eye.
Vec3<double> lids_middle(std::size_t eye) {
    return eye_centre(eye) - radius * Vec3<double>(0, 0.13, -0.88);
}

/// Landmarks at rest, without the irises.
Columns<double> head_at_rest() {
    Columns<double> x(3, skin_landmarks);
    const Random r{5, 1};
    for (Index i = 0; i < skin_landmarks; ++i) {
        const auto key = static_cast<std::uint64_t>(4 * i);
        const double yaw = 75 * degree * (2 * r.uniform(key) - 1),
                     pitch = 60 * degree * (2 * r.uniform(key + 1) - 1);
        const double nose = 0.25 * std::exp(-(yaw * yaw + pitch * pitch) / 0.06);
        x.col(i) << 0.75 * std::sin(yaw) * std::cos(pitch), 0.95 * std::sin(pitch),
            0.05 + (0.6 + nose) * std::cos(yaw) * std::cos(pitch);
    }
    for (std::size_t e = 0; e < 2; ++e)
        for (std::size_t k = 0; k < 16; ++k) {
            const double turn = std::acos(-1.0) * (1 - static_cast<double>(k) / 8);
            x.col(face_lids[e][k]) = lids_middle(e) +
                Vec3<double>(0.14 * std::cos(turn), 0.055 * std::sin(turn), 0);
        }
    x.col(152) << 0, -0.85, 0.55; // the chin
    return x;
}

/// How far the jaw and the brow are moved.
Vec2<double> expression_of(int picture) {
    return {0.25 * (1 + std::sin(1.7 * picture)), 0.25 * (1 + std::sin(2.9 * picture + 1))};
}

Columns<double> landmarks_in_head(int picture, const KnownPicture& known) {
    const Vec2<double> moved = expression_of(picture);
    Columns<double> x(3, face_landmarks);
    x.leftCols<skin_landmarks>() = head_at_rest();
    for (Index i = 0; i < skin_landmarks; ++i) {
        if (x(1, i) < -0.4) x.col(i) += moved[0] * Vec3<double>(0, -0.25, -0.05);
        if (x(1, i) > 0.65) x.col(i) += moved[1] * Vec3<double>(0, 0.08, 0);
    }
    for (std::size_t e = 0; e < 2; ++e) {
        const Vec3<double> g = known.gaze[e], side = normalized(cross(Vec3<double>(0, 1, 0), g));
        const Vec3<double> up = cross(g, side), middle = eye_centre(e) + iris_plane * g;
        const Index at = face_iris[e];
        x.col(at) = middle;
        for (Index k = 0; k < 4; ++k)
            x.col(at + 1 + k) = middle + limbus * (k % 2 == 0 ? side : up) * (k < 2 ? 1.0 : -1.0);
    }
    return x;
}

} // namespace

std::vector<KnownPicture> known_pictures(const KnownVideo& video) {
    const Mat3<double> axes = Vec3<double>(1, -1, -1).asDiagonal();
    std::vector<KnownPicture> all;
    const Random r{7, 2};
    for (int i = 0; i < video.pictures; ++i) {
        const double t = 2 * std::acos(-1.0) * i / video.pictures;
        const Vec3<double> turn(12 * degree * std::sin(2 * t + 1), video.turn_deg * degree * std::sin(t),
                                6 * degree * std::sin(3 * t));
        KnownPicture p;
        p.head = {axes * so3_exp(turn), {0.2 * std::sin(t), 0.1 * std::cos(2 * t), 5 + 0.3 * std::sin(3 * t)}};
        const auto key = static_cast<std::uint64_t>(2 * i);
        const double pitch = 15 * degree * (2 * r.uniform(key) - 1),
                     yaw = 22 * degree * (2 * r.uniform(key + 1) - 1);
        p.look = {pitch, yaw};
        std::array<Vec2<double>, 2> looks{p.look, p.look};
        if (video.target)
            for (std::size_t e = 0; e < 2; ++e)
                looks[e] = pitch_yaw(normalized(Vec3<double>(
                    p.head.rotation.transpose() * (video.target(i) - p.head.translation) -
                    eye_centre(e))));
        p.look = 0.5 * (looks[0] + looks[1]);
        if (!video.target) { // lines of sight meet at 8 dm
            const Vec3<double> between = 0.5 * (eye_centre(0) + eye_centre(1));
            for (std::size_t e = 0; e < 2; ++e)
                looks[e] = pitch_yaw(normalized(Vec3<double>(
                    between + 8 * gaze_vector(pitch, yaw) - eye_centre(e))));
        }
        for (std::size_t e = 0; e < 2; ++e)
            p.gaze[e] = gaze_vector(looks[e][0] - 1.5 * degree,
                                    looks[e][1] + (e == 0 ? 5 : -5) * degree);
        all.push_back(p);
    }
    return all;
}

std::vector<std::string> known_tracks(const KnownVideo& video) {
    using Json = nlohmann::json;
    const std::vector<KnownPicture> known = known_pictures(video);
    const Mat3<double> axes = Vec3<double>(1, -1, -1).asDiagonal();
    const Random r{9, 3};
    std::vector<std::string> lines;
    for (int i = 0; i < video.pictures; ++i) {
        const KnownPicture& k = known[static_cast<std::size_t>(i)];
        const Columns<double> x = landmarks_in_head(i, k);
        Json landmarks = Json::array();
        for (Index l = 0; l < x.cols(); ++l) {
            const Vec3<double> turned = k.head.turn(Vec3<double>(x.col(l)));
            const Vec3<double> p = turned + k.head.translation;
            const auto key = static_cast<std::uint64_t>(3 * (l + i * face_landmarks));
            landmarks.push_back(
                {video.focal * p.x() / p.z() + 0.5 * video.size + video.noise * r.normal(key),
                 video.focal * p.y() / p.z() + 0.5 * video.size + video.noise * r.normal(key + 1),
                 video.focal * turned.z() / k.head.translation.z() + video.noise * r.normal(key + 2)});
        }
        // As the tracker has it: its own field of view of 63 degrees, centimetres, y up, z back.
        const double own_focal = 0.5 * video.size / std::tan(31.5 * degree);
        const Mat3<double> rotation = axes * k.head.rotation;
        Vec3<double> shift = 10 * k.head.translation;
        shift.z() *= own_focal / video.focal;
        shift = axes * shift;
        Json matrix = Json::array();
        for (Index c = 0; c < 3; ++c)
            for (Index row = 0; row < 4; ++row) matrix.push_back(row < 3 ? rotation(row, c) : 0.0);
        for (Index row = 0; row < 4; ++row) matrix.push_back(row < 3 ? shift[row] : 1.0);
        // The tracker takes eyes to look towards the camera.
        const Vec3<double> to_camera = -(k.head.rotation.transpose() * k.head.translation);
        const double drawn = k.look[1] + 0.2 * pitch_yaw(normalized(to_camera))[1];
        const Vec2<double> look(k.look[0] / (30 * degree), drawn / (27 * degree));
        const Vec2<double> moved = expression_of(i);
        const auto part = [](double value) { return std::min(1.0, std::max(0.0, value)); };
        const Json line = {
            {"picture", "frames/" + std::to_string(i) + ".png"},
            {"mask", "masks/" + std::to_string(i) + ".png"},
            {"number", i},
            {"time", 0.1 * i},
            {"size", {video.size, video.size}},
            {"faces", 1},
            {"sharpness", 10},
            {"matrix", matrix},
            {"landmarks", landmarks},
            {"coefficients",
             {{"_neutral", 0.0},
              {"browInnerUp", moved[1]},
              {"jawOpen", moved[0]},
              {"eyeLookUpLeft", part(look[0])},
              {"eyeLookUpRight", part(look[0])},
              {"eyeLookDownLeft", part(-look[0])},
              {"eyeLookDownRight", part(-look[0])},
              {"eyeLookOutLeft", part(look[1])},
              {"eyeLookInRight", part(look[1])},
              {"eyeLookInLeft", part(-look[1])},
              {"eyeLookOutRight", part(-look[1])}}}};
        lines.push_back(line.dump());
    }
    return lines;
}

void write_known_video(const KnownVideo& video, const fs::path& folder) {
    fs::create_directories(folder / "frames");
    fs::create_directories(folder / "masks");
    std::ofstream tracks(folder / "tracks.jsonl");
    const std::vector<std::string> lines = known_tracks(video);
    const std::vector<KnownPicture> known = known_pictures(video);
    for (std::size_t i = 0; i < lines.size(); ++i) {
        tracks << lines[i] << "\n";
        const Vec3<double> at = known[i].head.translation;
        const double u = video.focal * at.x() / at.z() + 0.5 * video.size,
                     v = video.focal * at.y() / at.z() + 0.5 * video.size, r = video.focal / at.z();
        Image8 mask = plain_image(video.size, video.size, 0);
        for (int y = 0; y < video.size; ++y)
            for (int x = 0; x < video.size; ++x)
                if (std::hypot((x + 0.5 - u) / 0.9, y + 0.5 - v) < 1.1 * r)
                    mask.values[static_cast<std::size_t>(y * video.size + x)] = 255;
        const std::string name = std::to_string(i) + ".png";
        write_png(folder / "masks" / name, mask);
        write_png(folder / "frames" / name,
                  Image8{video.size, video.size, 3,
                         std::vector<std::uint8_t>(3 * mask.values.size(), 120)});
    }
}

void paint_eyes(const KnownVideo& video, const fs::path& folder) {
    const std::vector<KnownPicture> known = known_pictures(video);
    const double rim = std::atan2(limbus, iris_plane), half = 0.5 * video.size;
    for (std::size_t i = 0; i < known.size(); ++i) {
        const KnownPicture& k = known[i];
        const Columns<double> x = landmarks_in_head(static_cast<int>(i), k);
        Image8 picture{video.size, video.size, 3,
                       std::vector<std::uint8_t>(
                           3 * static_cast<std::size_t>(video.size) * static_cast<std::size_t>(video.size))};
        for (std::size_t p = 0; p < picture.values.size(); p += 3) {
            picture.values[p] = 190;
            picture.values[p + 1] = 140;
            picture.values[p + 2] = 110;
        }
        for (std::size_t e = 0; e < 2; ++e) {
            Columns<double> lids(2, 16);
            for (std::size_t l = 0; l < 16; ++l) {
                const Vec3<double> at = k.head.apply(Vec3<double>(x.col(face_lids[e][l])));
                lids.col(static_cast<Index>(l)) << video.focal * at.x() / at.z() + half,
                    video.focal * at.y() / at.z() + half;
            }
            const Image8 inside = hull_mask(lids, {video.size, video.size});
            const Vec3<double> centre = k.head.apply(eye_centre(e)), gaze = k.head.turn(k.gaze[e]);
            for (int v = 0; v < video.size; ++v)
                for (int u = 0; u < video.size; ++u) {
                    const auto p = static_cast<std::size_t>(v * video.size + u);
                    if (inside.values[p] == 0) continue;
                    const Vec3<double> ray =
                        normalized(Vec3<double>((u + 0.5 - half) / video.focal, (v + 0.5 - half) / video.focal, 1));
                    const double along = ray.dot(centre);
                    const Vec3<double> miss = along * ray - centre;
                    const double depth = std::sqrt(std::max(0.0, radius * radius - miss.squaredNorm()));
                    const Vec3<double> hit = normalized(Vec3<double>(miss - depth * ray));
                    const bool iris = std::acos(std::min(1.0, hit.dot(gaze))) < rim;
                    for (std::size_t c = 0; c < 3; ++c)
                        picture.values[3 * p + c] = iris ? 50 : 225;
                }
        }
        write_png(folder / "frames" / (std::to_string(i) + ".png"), picture);
    }
}

} // namespace rye::trainer
