// SPDX-License-Identifier: Apache-2.0
#include "commands/options.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>

#include <CLI/CLI.hpp>

#include <rye/avatar/drawn_size.hpp>
#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/core/parse.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/corrected_cameras.hpp"
#include "data/degrees.hpp"
#include "data/memory_limit.hpp"
#include "data/run_frames.hpp"
#include "data/validate.hpp"

namespace rye::trainer {

namespace {

Error no_frame(const std::string& id, const std::string& first, const std::string& last,
               const std::filesystem::path& folder) {
    return Error("--frame: got '" + id + "', expected one from '" + first + "' to '" + last +
                 "' in " + folder.string());
}

Error no_camera(const std::string& id, const std::vector<std::string>& ids) {
    std::string all;
    for (const std::string& name : ids) all += " " + name;
    return Error("--camera: got '" + id + "', expected one of:" + all);
}

} // namespace

int frame_index(const Capture& capture, const std::string& id) {
    if (id.empty()) return capture.test.empty() ? 0 : capture.test.front();
    for (int f = 0; f < capture.frame_count(); ++f)
        if (capture.frames[static_cast<std::size_t>(f)].id == id) return f;
    throw no_frame(id, capture.frames.front().id, capture.frames.back().id, capture.folder);
}

std::string frame_id(const CaptureContents& contents, const std::string& id) {
    if (id.empty()) return contents.test.empty() ? contents.frames.front() : contents.test.front();
    if (std::find(contents.frames.begin(), contents.frames.end(), id) == contents.frames.end())
        throw no_frame(id, contents.frames.front(), contents.frames.back(), contents.folder);
    return id;
}

std::vector<std::string> camera_choices(const CaptureContents& contents, const std::string& id) {
    const std::vector<std::string>& all = contents.camera_ids;
    if (id.empty()) return all;
    if (std::find(all.begin(), all.end(), id) == all.end()) throw no_camera(id, all);
    return {id};
}

int camera_index(const Capture& capture, const std::string& id, int frame) {
    if (!id.empty()) {
        for (int c = 0; c < capture.camera_count(); ++c) {
            if (capture.camera_ids[static_cast<std::size_t>(c)] != id) continue;
            require(capture.view(frame, c).present, "--camera", "camera '", id,
                    "' has no image of frame '", capture.frames[static_cast<std::size_t>(frame)].id,
                    "'");
            return c;
        }
        throw no_camera(id, capture.camera_ids);
    }
    const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frame)];
    const Mat3<double> head = so3_exp(Vec3<double>(f.pose.head<3>()));
    const Vec3<double> forward = head.col(2), at = f.landmarks.rowwise().mean();
    int best = -1;
    double most = -2;
    for (int c = 0; c < capture.camera_count(); ++c) {
        if (!capture.view(frame, c).present) continue;
        const Vec3<double> to = capture.camera(frame, c).centre() - at;
        const double facing = to.normalized().dot(forward);
        if (facing > most) most = facing, best = c;
    }
    require(best >= 0, capture.folder.string(), "frame '", f.id, "' has no image");
    return best;
}

Vec3<float> gaze_option(const std::vector<double>& pitch_yaw_deg, const std::string& option) {
    require(pitch_yaw_deg.size() == 2, option, "got ", pitch_yaw_deg.size(),
            " numbers, expected PITCH,YAW");
    for (const double a : pitch_yaw_deg)
        require(
            std::isfinite(a) && std::abs(a) <= 70, option, "got ",
            [&] { return std::to_string(a); }, " degrees, expected at most 70 either way");
    return gaze_vector(pitch_yaw_deg[0] * degree, pitch_yaw_deg[1] * degree).cast<float>();
}

void add_device(CLI::App& command, std::string& device, const std::string& help) {
    command.add_option("--device", device, help)
        ->check(CLI::IsMember({"auto", "cpu", "cuda"}))
        ->capture_default_str();
}

std::filesystem::path capture_folder(const std::filesystem::path& run, const TrainState& state,
                                     const std::filesystem::path& option, const std::string& use) {
    if (!option.empty()) return option;
    require(std::filesystem::is_directory(state.capture), run.string(), use,
            " needs the photographs of its capture, which is not at '", state.capture,
            "' any more; name its folder by --capture");
    return state.capture;
}

namespace {

bool has_own_frames(const std::filesystem::path& run) {
    return std::filesystem::exists(frames_path(run));
}

/// Returns the capture of an older run.
std::filesystem::path old_capture(const std::filesystem::path& run, const TrainState& state) {
    require(std::filesystem::is_directory(state.capture), run.string(),
            "holds no frames.safetensors (older versions wrote none), and its capture is not at '",
            state.capture,
            "' any more; name its folder by --capture, or let `rye train "
            "--resume --out ",
            run.string(), " --capture FOLDER` add the file");
    return state.capture;
}

} // namespace

Capture driving_capture(const std::filesystem::path& run, const TrainState& state,
                        const std::filesystem::path& option) {
    Capture c = option.empty() && has_own_frames(run)
                    ? load_frames(run, state.frames)
                    : read_valid_capture(option.empty() ? old_capture(run, state) : option);
    require_same_subject(state, c);
    return c;
}

ShownView shown_view(const std::filesystem::path& run, const TrainState& state,
                     const std::filesystem::path& option, const std::string& frame,
                     const std::string& camera) {
    ShownView v;
    if (option.empty() && has_own_frames(run)) {
        v.capture = driving_capture(run, state, option);
        v.frame = frame_index(v.capture, frame);
    } else {
        const CaptureContents contents =
            read_contents(option.empty() ? old_capture(run, state) : option);
        v.capture =
            read_valid_frame(contents, frame_id(contents, frame), camera_choices(contents, camera));
        require_same_subject(state, v.capture);
        take_corrected(v.capture, load_corrected_cameras(run));
    }
    v.camera = camera_index(v.capture, camera, v.frame);
    return v;
}

double share_of_trained(const std::filesystem::path& run, const TrainState& state,
                        const Capture& capture) {
    if (!has_own_frames(run)) return 1;
    return static_cast<double>(capture.height) / load_frames(run, state.frames).height;
}

double dilation_of(const std::filesystem::path& run, const TrainState& state,
                   const Capture& capture) {
    return resized_dilation(trained_dilation, share_of_trained(run, state, capture));
}

void take_size(const std::filesystem::path& run, const TrainState& state, const ShownView& view,
               std::vector<DrawnFrame>& frames) {
    const double usual = dilation_of(run, state, view.capture);
    const TrainedSize<float> size(
        state.subject.head_centre.cast<float>(),
        frame_drivers(view.capture, view.frame, state.config.gaze_axis),
        view.capture.camera(view.frame, view.camera).cast<float>());
    for (DrawnFrame& f : frames) f.dilation = size.dilation(usual, f.drivers, f.camera);
}

std::function<std::string(const std::string&)> out_check(std::vector<OutFormat> known) {
    return read_check([known = std::move(known)](const std::string& path, const std::string& who) {
        out_format(path, known, who);
    });
}

std::function<std::string(const std::string&)> folder_check(const std::string& what) {
    return [what](const std::string& path) -> std::string {
        if (std::filesystem::is_directory(path)) return "";
        return "got '" + path + "', which is " +
               (std::filesystem::exists(path) ? "no folder" : "not there") + ", expected " + what;
    };
}

void require_same_subject(const TrainState& state, const Capture& capture) {
    const int width = capture.expression_width();
    require(width == state.config.avatar.expression, capture.folder.string(), "exp_coeff has ",
            width, " values, expected ", state.config.avatar.expression,
            ", as this run was trained with");
    require_gazes(capture, state.config.gaze_axis);
}

namespace {

template <class T>
std::function<std::string(const std::string&)> range_check(T least, T most) {
    return [least, most](const std::string& text) -> std::string {
        T x{};
        if (!CLI::detail::lexical_cast(text, x)) return "";
        if (!(x < least || x > most)) return ""; // NaN is reported by run_program
        return "got " + text + ", expected " + number_text(least) + " to " + number_text(most);
    };
}

} // namespace

std::function<std::string(const std::string&)> from_to(int least, int most) {
    return range_check(least, most);
}

std::function<std::string(const std::string&)> from_to(double least, double most) {
    return range_check(least, most);
}

void add_threads(CLI::App& command, int& threads, const std::string& help) {
    command.add_option("--threads", threads, help)
        ->check(from_to(0, most_threads))
        ->capture_default_str();
}

void add_memory(CLI::App& command) {
    command
        .add_option_function<std::string>(
            "--memory",
            [](const std::string& text) { set_memory_limit(parsed_memory(text, "--memory")); },
            "The most memory that one file may ask for, or the lists of one picture: 512M, 8G "
            "(default: 2G)")
        ->check(read_check(parsed_memory));
}

std::uint64_t parsed_seed(const std::string& text, const std::string& option) {
    std::uint64_t seed = 0;
    const char* const end = text.data() + text.size();
    const auto [stop, fault] = std::from_chars(text.data(), end, seed);
    require(fault == std::errc() && stop == end, option, "got '", text,
            "', expected a whole number from 0 to 18446744073709551615");
    return seed;
}

double parsed_error(const std::string& text, const std::string& option) {
    const std::size_t slash = text.find('/');
    const std::optional<double> above = parse_double(std::string_view(text).substr(0, slash));
    const std::optional<double> below =
        slash == std::string::npos ? 1 : parse_double(std::string_view(text).substr(slash + 1));
    const double error = above && below ? *above / *below : 0;
    require(error > 0 && error < 1, option, "got '", text,
            "', expected a number between 0 and 1 such as 0.004 or 1/255");
    return error;
}

} // namespace rye::trainer
