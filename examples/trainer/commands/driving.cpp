// SPDX-License-Identifier: Apache-2.0
#include "commands/driving.hpp"

#include <charconv>
#include <iostream>

#include <CLI/CLI.hpp>

#include <rye/math/rotation.hpp>

#include "commands/options.hpp"
#include "data/driver_table.hpp"
#include "data/out_format.hpp"
#include "data/run_frames.hpp"
#include "data/validate.hpp"
#include "driving/fit_expressions.hpp"
#include "driving/retarget.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

/// Returns the frames of a folder: of a run (also of an older one) or of a capture.
Capture folder_frames(const fs::path& folder) {
    if (fs::exists(frames_path(folder))) return load_frames(folder, "");
    if (fs::exists(checkpoint_path(folder)))
        return driving_capture(folder, load_checkpoint(folder), {});
    return read_valid_capture(folder);
}

std::vector<Drivers<float>> folder_drivers(const fs::path& folder, const TrainState& state,
                                           const Capture& own) {
    const Capture from = folder_frames(folder);
    require_same_subject(state, from);
    if (!own.expression_names.empty() && !from.expression_names.empty() &&
        own.expression_names != from.expression_names)
        std::cerr << "rye: note: the coefficients of " << folder.string()
                  << " have other names than those of the run; they drive it in their order\n";
    std::vector<Drivers<float>> all;
    for (int f = 0; f < from.frame_count(); ++f)
        all.push_back(frame_drivers(from, f, state.config.gaze_axis));
    return all;
}

/// Parses FIRST:LAST, two whole numbers with FIRST <= LAST; throws an Error that begins with `who`
/// for anything else.
std::pair<int, int> parsed_range(const std::string& text, const std::string& who) {
    int first = -1, last = -1;
    const char* const end = text.data() + text.size();
    const auto [colon, no_first] = std::from_chars(text.data(), end, first);
    bool read = no_first == std::errc() && colon != end && *colon == ':';
    if (read) {
        const auto [stop, no_last] = std::from_chars(colon + 1, end, last);
        read = no_last == std::errc() && stop == end;
    }
    require(read && first >= 0 && first <= last, who, "got '", text,
            "', expected FIRST:LAST, frames from 0 on");
    return {first, last};
}

/// Returns the frames FIRST to LAST for "FIRST:LAST".
template <class Frame>
std::vector<Frame> ranged(const std::vector<Frame>& all, const std::string& range) {
    if (range.empty()) return all;
    const auto [first, last] = parsed_range(range, "--range");
    require(static_cast<std::size_t>(last) < all.size(), "--range", "got ", range,
            ", expected FIRST:LAST within 0:", all.size() - 1, ", the frames of --driving");
    return {all.begin() + first, all.begin() + last + 1};
}

/// Applies to the pose of `own` the motion of `now` since `first`, in the head's axes of `first`.
void follow(const Drivers<float>& first, const Drivers<float>& own, Drivers<float>& now) {
    const auto rotation = [](const Drivers<float>& d) {
        return so3_exp(Vec3<double>(d.pose.head<3>().cast<double>()));
    };
    const auto place = [](const Drivers<float>& d) -> Vec3<double> {
        return d.pose.tail<3>().cast<double>();
    };
    const Mat3<double> back = rotation(first).transpose();
    const double units = static_cast<double>(own.scale) / static_cast<double>(first.scale);
    const Mat3<double> r = rotation(own) * back * rotation(now);
    const Vec3<double> t =
        place(own) + units * (rotation(own) * (back * (place(now) - place(first))));
    now.pose.head<3>() = so3_log(r).cast<float>();
    now.pose.tail<3>() = t.cast<float>();
    now.scale = own.scale;
}

/// Makes the places of a track those since its first picture, and with `turns` its turns too.
void begin_at_first(FaceTrack& track, bool turns) {
    const TrackedFace first = track.faces.front();
    const Mat3<double> back =
        turns && first.turn ? Mat3<double>(first.turn->transpose()) : Mat3<double>::Identity();
    for (TrackedFace& f : track.faces) {
        if (f.turn) f.turn = Mat3<double>(back * *f.turn);
        if (f.place && first.place) f.place = Vec3<double>(back * (*f.place - *first.place));
    }
}

/// Returns the drivers of a face tracker's file, and says what it drives.
std::vector<Drivers<float>> tracked_drivers(const DrivingOptions& o, const TrainState& state,
                                            const Capture& capture, const Drivers<float>& own,
                                            double rate) {
    FaceTrack track = read_face_track(o.path);
    const std::size_t pictures = track.faces.size();
    if (!o.flip.empty()) flip(track, parsed_flips(o.flip, "--flip"));
    if (o.neutral >= 0) subtract_neutral(track, o.neutral, "--neutral");
    track.faces = ranged(track.faces, o.range);
    begin_at_first(track, o.pose == "relative");
    Retarget retarget(track.names, capture.expression_names, state.config.avatar.expression);
    Drivers<float> rest = own;
    if (!track.names.empty() && retarget.driven() == 0 && state.config.avatar.expression > 0) {
        retarget = Retarget(track.names, fitted_mix(procedural_head(1, 0), capture, "--driving"));
        rest.expression.setZero();
    }
    std::vector<Drivers<float>> all;
    for (const TrackedFace& f : resampled(track, rate)) all.push_back(retarget.apply(f, rest));
    std::cerr << "rye: note: " << o.path.string() << ": " << track.kind << ", " << pictures
              << " pictures, " << track.lost << " of them without a face; " << retarget.words();
    for (const std::string& note : track.notes) std::cerr << "; " << note;
    std::cerr << "\n";
    return all;
}

} // namespace

void add_driving_options(CLI::App& command, DrivingOptions& o) {
    CLI::Option* const driving =
        command
            .add_option(
                "--driving", o.path,
                "Expressions, head poses and gazes of a video: the folder of a capture or "
                "of a run, a CSV file (`rye drivers` writes one), or a face tracker's: Live "
                "Link Face's CSV, MediaPipe's or OpenXR's JSON")
            ->check(CLI::ExistingPath);
    command
        .add_option(
            "--pose", o.pose,
            "Head poses of --driving: driving: as they are, in its world, or of a tracker's "
            "file turned from the frame's; relative: its motion since its first frame, from "
            "the frame's pose on; own: the frame's, still")
        ->check(CLI::IsMember({"driving", "relative", "own"}))
        ->needs(driving)
        ->capture_default_str();
    command
        .add_option("--range", o.range, "Frames of --driving: FIRST:LAST, from 0 (default: all)")
        ->check(read_check(parsed_range))
        ->needs(driving);
    command
        .add_option("--flip", o.flip,
                    "What a tracker's file has the other way round: sides (a mirror picture), "
                    "head-yaw, head-pitch, head-roll, gaze-yaw, gaze-pitch")
        ->check(read_check(parsed_flips))
        ->needs(driving);
    command
        .add_option("--neutral", o.neutral,
                    "Picture of a tracker's file with a neutral face, whose coefficients and head "
                    "turn are taken as 0")
        ->check(from_to(0, 100000000))
        ->needs(driving);
}

std::vector<Drivers<float>> driving_frames(const DrivingOptions& o, const TrainState& state,
                                           const Capture& capture, const Drivers<float>& own,
                                           double rate, std::vector<PupilRatios>* pupils) {
    std::vector<Drivers<float>> all;
    const bool folder = fs::is_directory(o.path);
    if (!folder && is_face_track(o.path)) {
        all = tracked_drivers(o, state, capture, own, rate);
        for (Drivers<float>& d : all)
            if (o.pose == "own") d.pose = own.pose;
        return all;
    }
    require(o.flip.empty() && o.neutral < 0, o.flip.empty() ? "--neutral" : "--flip",
            "needs a face tracker's file, got ", o.path.string());
    if (folder) {
        all = folder_drivers(o.path, state, capture);
    } else {
        require(extension_of(o.path) == ".csv", o.path.string(),
                "expected the folder of a capture or of a run, or a file that ends in .csv, .json "
                "or .jsonl");
        all = read_drivers(o.path, {state.config.avatar.expression, capture.expression_names}, own,
                           pupils);
        if (pupils != nullptr && !pupils->empty()) *pupils = ranged(*pupils, o.range);
    }
    all = ranged(all, o.range);
    const Drivers<float> first = all.front();
    for (Drivers<float>& d : all) {
        if (o.pose == "relative") follow(first, own, d);
        if (o.pose != "own") continue;
        d.pose = own.pose;
        d.scale = own.scale;
    }
    return all;
}

Vec3<float> head_middle(const TrainState& state, const Drivers<float>& drivers) {
    const Mat3<float> r = so3_exp(Vec3<float>(drivers.pose.head<3>()));
    return r * (drivers.scale * state.subject.head_centre.cast<float>()) + drivers.pose.tail<3>();
}

} // namespace rye::trainer
