// SPDX-License-Identifier: Apache-2.0
#include "driving/face_track.hpp"

#include <algorithm>
#include <cmath>

#include <rye/io/bytes.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>

#include "data/out_format.hpp"
#include "driving/face_names.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t most_bytes = 1ULL << 30U;
/// Pictures that a track may be turned into: an hour at 60 a second.
constexpr double most_pictures = 216000;

/// Returns a turn with other signs of its angles.
Mat3<double> flipped(const Mat3<double>& turn, const Flips& f) {
    Mat3<double> r = turn;
    if (f.sides) {
        const Vec3<double> mirror(-1, 1, 1);
        r = mirror.asDiagonal() * r * mirror.asDiagonal();
    }
    if (!f.head_yaw && !f.head_pitch && !f.head_roll) return r;
    // The angles of head_turn: r = yaw * pitch * roll.
    const double pitch = std::asin(std::clamp(r(1, 2), -1.0, 1.0));
    const double yaw = std::atan2(r(0, 2), r(2, 2));
    const double roll = std::atan2(r(1, 0), r(1, 1));
    return head_turn(f.head_yaw ? -yaw : yaw, f.head_pitch ? -pitch : pitch,
                     f.head_roll ? -roll : roll);
}

/// Returns the place in the list of the coefficient of the other side, or the same.
std::vector<Index> other_sides(const std::vector<std::string>& names) {
    std::vector<Index> other(names.size());
    for (std::size_t i = 0; i < names.size(); ++i) {
        other[i] = static_cast<Index>(i);
        SidedName wanted = sided_name(names[i]);
        if (wanted.side == 0) continue;
        wanted.side = wanted.side == 'l' ? 'r' : 'l';
        for (std::size_t k = 0; k < names.size(); ++k)
            if (sided_name(names[k]) == wanted) other[i] = static_cast<Index>(k);
    }
    return other;
}

/// Returns a face between two.
TrackedFace between(const TrackedFace& a, const TrackedFace& b, double share) {
    if (share <= 0) return a;
    TrackedFace f = a;
    if (b.coefficients.size() == a.coefficients.size())
        f.coefficients += share * (b.coefficients - a.coefficients);
    if (a.turn && b.turn)
        f.turn = Mat3<double>(
            *a.turn *
            so3_exp(Vec3<double>(share * so3_log(Mat3<double>(a.turn->transpose() * *b.turn)))));
    if (a.place && b.place) f.place = Vec3<double>(*a.place + share * (*b.place - *a.place));
    for (std::size_t e = 0; e < 2; ++e)
        if (a.gaze[e] && b.gaze[e])
            f.gaze[e] = Vec2<double>(*a.gaze[e] + share * (*b.gaze[e] - *a.gaze[e]));
    return f;
}

} // namespace

bool is_face_track(const fs::path& path) {
    const std::string extension = extension_of(path);
    if (extension == ".json" || extension == ".jsonl") return true;
    return extension == ".csv" && is_live_link(as_text(read_beginning(path, 64)));
}

FaceTrack read_face_track(const fs::path& path) {
    const Bytes bytes = read_file(path, most_bytes);
    return extension_of(path) == ".csv" ? parse_live_link(as_text(bytes), path.string())
                                        : parse_face_json(as_text(bytes), path.string());
}

Flips parsed_flips(const std::string& text, const std::string& who) {
    Flips f;
    bool* const fields[]{&f.sides,     &f.head_yaw, &f.head_pitch,
                         &f.head_roll, &f.gaze_yaw, &f.gaze_pitch};
    for (std::size_t at = 0; at <= text.size();) {
        const std::size_t end = std::min(text.find(',', at), text.size());
        const std::string name = text.substr(at, end - at);
        at = end + 1;
        std::size_t k = 0;
        while (k < flip_names.size() && name != flip_names[k]) ++k;
        require(k < flip_names.size(), who, "got '", name,
                "', expected sides, head-yaw, head-pitch, head-roll, gaze-yaw or gaze-pitch");
        *fields[k] = true;
    }
    return f;
}

void flip(FaceTrack& track, const Flips& flips) {
    const std::vector<Index> other = other_sides(track.names);
    for (TrackedFace& f : track.faces) {
        if (f.turn) f.turn = flipped(*f.turn, flips);
        if (flips.sides) {
            const VecX<double> before = f.coefficients;
            for (Index i = 0; i < before.size(); ++i)
                f.coefficients[i] = before[other[static_cast<std::size_t>(i)]];
            std::swap(f.gaze[0], f.gaze[1]);
            if (f.place) f.place->x() *= -1;
        }
        for (std::optional<Vec2<double>>& gaze : f.gaze) {
            if (!gaze) continue;
            if (flips.gaze_pitch) (*gaze)[0] *= -1;
            if (flips.gaze_yaw != flips.sides) (*gaze)[1] *= -1;
        }
    }
}

void subtract_neutral(FaceTrack& track, int picture, const std::string& who) {
    require(picture >= 0 && static_cast<std::size_t>(picture) < track.faces.size(), who, "got ",
            picture, ", expected a picture of the track, 0 to ", track.faces.size() - 1);
    const TrackedFace neutral = track.faces[static_cast<std::size_t>(picture)];
    for (TrackedFace& f : track.faces) {
        if (f.turn && neutral.turn) f.turn = Mat3<double>(neutral.turn->transpose() * *f.turn);
        for (Index i = 0; i < f.coefficients.size(); ++i) {
            // The looks of eyes are angles, and so have no neutral but ahead.
            if (sided_name(track.names[static_cast<std::size_t>(i)]).base.starts_with("eyelook"))
                continue;
            const double n = std::clamp(neutral.coefficients[i], 0.0, 0.9);
            f.coefficients[i] = std::max(0.0, (f.coefficients[i] - n) / (1 - n));
        }
    }
}

std::vector<TrackedFace> resampled(const FaceTrack& track, double rate) {
    const std::vector<TrackedFace>& faces = track.faces;
    if (!track.timed || faces.size() < 2) return faces;
    const double length = faces.back().time - faces.front().time;
    require(length * rate < most_pictures, "--driving", "its pictures last ", length,
            " s, expected fewer than ", most_pictures, " pictures: see --range");
    std::vector<TrackedFace> all;
    std::size_t next = 1;
    // A picture that lies within a thousandth of a step is taken as it is.
    const double tolerance = 1e-3 / rate;
    for (int i = 0; static_cast<double>(i) / rate <= length + tolerance; ++i) {
        const double time = static_cast<double>(i) / rate;
        while (next + 1 < faces.size() && faces[next].time < time - tolerance) ++next;
        const TrackedFace &a = faces[next - 1], &b = faces[next];
        const double span = b.time - a.time;
        double share = span > 0 ? std::clamp((time - a.time) / span, 0.0, 1.0) : 1.0;
        if (share * span < tolerance) share = 0;
        TrackedFace f = (1 - share) * span < tolerance ? b : between(a, b, share);
        f.time = time;
        all.push_back(std::move(f));
    }
    return all;
}

} // namespace rye::trainer
