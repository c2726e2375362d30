// SPDX-License-Identifier: Apache-2.0
/// driving/face_track.hpp: what a face tracker says, picture by picture, in one form for all kinds
/// of files. Angles and axes are those of the head frame (x the subject's left, y up, z out of the
/// face); coefficients have ARKit's names, whatever their spelling, and are about 0 to 1.
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <rye/math/linalg.hpp>

namespace rye::trainer {

/// Face of one picture.
struct TrackedFace {
    double time = 0;                                 ///< [s]
    VecX<double> coefficients;                       ///< by FaceTrack::names
    std::optional<Mat3<double>> turn;                ///< the head's, from facing the tracker
    std::optional<Vec3<double>> place;               ///< the head's [mm]
    std::array<std::optional<Vec2<double>>, 2> gaze; ///< left, right eye: pitch, yaw [rad]
};

struct FaceTrack {
    std::string kind;               ///< such as "Live Link Face"
    std::vector<std::string> names; ///< of the coefficients
    std::vector<TrackedFace> faces; ///< at least one, at times that grow if `timed`
    bool timed = false;             ///< false: the file has no times
    int lost = 0;                   ///< pictures without a face, which have that of one beside
    std::vector<std::string> notes; ///< what was found out about units and signs
};

/// Returns true if a text is a table of Live Link Face: its first column is Timecode.
bool is_live_link(std::string_view text);

/// Reads the CSV of Live Link Face or a program that writes its columns: Timecode
/// (HH:MM:SS:FRAMES), BlendShapeCount, coefficients, HeadYaw, HeadPitch, HeadRoll, LeftEyeYaw ...
/// Whether angles are degrees, and the signs of the eyes', follow from their sizes and from the
/// coefficients of looking; signs of the head are those of Unreal Engine. Throws an Error with
/// file, line, column and value.
FaceTrack parse_live_link(std::string_view text, const std::string& who);

/// Reads JSON: a list, an object with the list `frames` or `results`, or a line for each picture,
/// of
/// - results of MediaPipe's Face Landmarker (faceBlendshapes, facialTransformationMatrixes, in the
///   spelling of JavaScript or Python) with time [s] or timestampMs;
/// - pictures of `rye import video` (coefficients, matrix);
/// - OpenXR's structs: gaze, of two XrEyeGazeFB, weights, those of XR_FB_face_tracking2, head, an
///   XrPosef, time [ns].
/// Throws an Error with file, picture, field and value.
FaceTrack parse_face_json(std::string_view text, const std::string& who);

/// Returns true for names of files that read_face_track reads: .csv of Live Link Face, .json and
/// .jsonl.
bool is_face_track(const std::filesystem::path& path);

/// Reads either, told by the name and the content.
FaceTrack read_face_track(const std::filesystem::path& path);

/// Parts of a track whose sign or side is another one than assumed.
struct Flips {
    bool sides = false; ///< left and right: the tracker saw a mirror picture
    bool head_yaw = false, head_pitch = false, head_roll = false, gaze_yaw = false,
         gaze_pitch = false;
};
/// Names of flips for a user, in the order of the fields: "sides", "head-yaw", ...
inline constexpr std::array flip_names{"sides",     "head-yaw", "head-pitch",
                                       "head-roll", "gaze-yaw", "gaze-pitch"};
/// Returns the flips of a list such as "sides,head-yaw"; throws an Error that begins with `who` for
/// another name.
Flips parsed_flips(const std::string& text, const std::string& who);
void flip(FaceTrack& track, const Flips& flips);

/// Takes the face of one picture as neutral: its coefficients n become 0 and 1 stays 1, as
/// (x - n) / (1 - n), not below 0; head turns are from its. Throws an Error that begins with `who`
/// if there is no such picture.
void subtract_neutral(FaceTrack& track, int picture, const std::string& who);

/// Returns the faces at times 0, 1 / rate, 2 / rate ... since the first one, between two pictures
/// in proportion; as they are if the track has no times.
std::vector<TrackedFace> resampled(const FaceTrack& track, double rate);

} // namespace rye::trainer
