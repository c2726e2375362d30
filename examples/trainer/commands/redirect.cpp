// SPDX-License-Identifier: Apache-2.0
/// `rye redirect`: renders a trained head with another gaze for each eye, from another camera, with
/// other drivers: one picture, a contact sheet, or a video.

#include <algorithm>
#include <array>
#include <chrono>
#include <iostream>
#include <memory>
#include <optional>
#include <span>

#include <CLI/CLI.hpp>

#include <rye/io/atomic_file.hpp>
#include <rye/math/rotation.hpp>

#include "commands/camera_options.hpp"
#include "commands/commands.hpp"
#include "commands/driving.hpp"
#include "commands/idle.hpp"
#include "commands/lights_option.hpp"
#include "commands/options.hpp"
#include "commands/picture_labels.hpp"
#include "commands/progress.hpp"
#include "data/film_encoder.hpp"
#include "data/moving_picture.hpp"
#include "data/panel.hpp"
#include "data/system.hpp"
#include "data/threads.hpp"
#include "drawing/variants.hpp"

namespace rye::trainer {
namespace {

struct RedirectOptions {
    std::filesystem::path run, capture, out, labels, lights;
    std::string frame, camera, effects, rate = "25", device = "auto";
    std::vector<double> left, right;  ///< pitch, yaw [deg]
    std::vector<float> pupil;         ///< of both, or left and right
    CameraOptions own;
    DrivingOptions driving;
    GazeAtOptions at;
    IdleOptions idle;
    bool sweep = false, compare = false;
    int threads = 0;
};

/// Formats of --out.
const std::vector<OutFormat> formats{OutFormat::png,        OutFormat::jpeg,
                                     OutFormat::apng,       OutFormat::y4m,
                                     OutFormat::film,       OutFormat::y4m_stream,
                                     OutFormat::picture_folder};

/// (pitch, yaw) of the left eye and of the right one [deg].
struct Look {
    double left[2], right[2];
};

/// Returns the gazes of the sheet: pitch down the rows, yaw across; then single eyes, then
/// converging and diverging ones.
const std::vector<std::vector<Look>>& sheet_of_heads() {
    static const std::vector<std::vector<Look>> rows = [] {
        std::vector<std::vector<Look>> r;
        for (const double pitch : {15.0, 0.0, -15.0}) {
            r.emplace_back();
            for (const double yaw : {-24.0, -12.0, 0.0, 12.0, 24.0})
                r.back().push_back({{pitch, yaw}, {pitch, yaw}});
        }
        r.push_back({{{0, -12}, {0, 12}}, {{0, 12}, {0, -12}}, {{12, 0}, {-12, 0}},
                     {{0, 20}, {0, 0}}, {{0, 0}, {0, -20}}});
        return r;
    }();
    return rows;
}

/// Returns gazes that are shown enlarged around the eyes, to make the lids visible.
const std::vector<std::vector<Look>>& sheet_of_eyes() {
    static const std::vector<std::vector<Look>> rows = [] {
        std::vector<std::vector<Look>> r(2);
        for (const double yaw : {-24.0, -12.0, 0.0, 12.0, 24.0})
            r[0].push_back({{0, yaw}, {0, yaw}});
        for (const double pitch : {-20.0, -10.0, 0.0, 8.0, 16.0})
            r[1].push_back({{pitch, 0}, {pitch, 0}});
        return r;
    }();
    return rows;
}

DrawnFrame looking(const DrawnFrame& frame, const Look& look) {
    DrawnFrame f = frame;
    f.drivers.gaze = {gaze_option({look.left[0], look.left[1]}, "--sweep"),
                      gaze_option({look.right[0], look.right[1]}, "--sweep")};
    return f;
}

/// Returns a crop of an image around the eyes, as wide as the image.
Image<float> around_eyes(const Image<float>& whole, const TrainState& state,
                         const DrawnFrame& frame) {
    const Mat3<float> r = so3_exp(Vec3<float>(frame.drivers.pose.head<3>()));
    Vec2<float> middle = Vec2<float>::Zero();
    std::array<Vec3<float>, 2> p;
    for (std::size_t e = 0; e < 2; ++e) {
        const Vec3<float> head = frame.drivers.scale * state.subject.eye_centre[e].cast<float>();
        p[e] = frame.camera.project_point(r * head + frame.drivers.pose.tail<3>());
        middle += 0.5f * p[e].head<2>();
    }
    const float apart = std::max(8.0f, (p[0] - p[1]).head<2>().norm());
    const int w = static_cast<int>(2.0f * apart), h = w / 2;
    return enlarged(cropped(whole, static_cast<int>(middle.x()) - w / 2,
                            static_cast<int>(middle.y()) - h / 2, w, h), whole.width);
}

/// Returns the drawer of these frames by --device and --effects; prints its choice, if any, to
/// `say`.
FrameDrawer drawer_of(const RedirectOptions& o, const TrainState& state,
                      const std::vector<DrawnFrame>& frames, std::ostream& say) {
    const DeviceWish wish = device_wish(o.device);
    const std::string left_out = left_out_on_device(o.effects, "--effects");
    require(wish != DeviceWish::cuda || left_out.empty(), "--device", "got cuda, but ", left_out);
    if (left_out.empty()) {
        AvatarDrawer drawer(state, wish);
        if (!drawer.words().empty()) say << drawer.words() << "\n";
        if (drawer.on_device()) return FrameDrawer(std::move(drawer));
    } else if (wish == DeviceWish::automatic && has_device_kernels()) {
        say << "pictures are drawn on the CPU: " << left_out << "\n";
    }
    return {state, frames, o.effects, "--effects", 1.0 / 255};
}

/// Returns a contact sheet of many gazes of one frame; `explained` receives the choice of the
/// effects.
Image<float> contact_sheet(const RedirectOptions& o, const TrainState& state,
                           const DrawnFrame& frame, std::ostream& say, std::string& explained) {
    std::vector<DrawnFrame> all;
    for (const auto* rows : {&sheet_of_heads(), &sheet_of_eyes()})
        for (const std::vector<Look>& row : *rows)
            for (const Look& look : row) all.push_back(looking(frame, look));
    const FrameDrawer drawer = drawer_of(o, state, all, say);
    explained = drawer.explanation();
    std::vector<Image<float>> stack;
    for (const auto* rows : {&sheet_of_heads(), &sheet_of_eyes()})
        for (const std::vector<Look>& row : *rows) {
            std::vector<Image<float>> pictures;
            for (const Look& look : row) {
                const Image<float> whole = drawer.picture(looking(frame, look));
                pictures.push_back(rows == &sheet_of_heads() ? whole
                                                             : around_eyes(whole, state, frame));
            }
            stack.push_back(side_by_side(pictures));
        }
    return stacked(stack);
}

void write_picture(const std::filesystem::path& out, OutFormat format,
                   const Image<float>& picture) {
    constexpr int quality = 95;
    if (format == OutFormat::jpeg)
        write_jpeg(out, to_8bit(picture), quality);
    else
        write_png(out, picture);
}

/// Pictures of a command: drivers and camera of each, and the photograph beside the only one.
struct Shot {
    std::vector<DrawnFrame> frames;
    std::optional<Image<float>> photograph;
};

/// Returns the pictures to draw, as many as there are drivers or cameras; a single one of either is
/// used for all. Prints what moves by itself to `say`.
Shot shot_of(const RedirectOptions& o, const TrainState& state, std::ostream& say) {
    const std::filesystem::path source =
        o.compare ? capture_folder(o.run, state, o.capture, "--compare") : o.capture;
    const ShownView view = shown_view(o.run, state, source, o.frame, o.camera);
    const Capture& capture = view.capture;
    const Drivers<float> base = frame_drivers(capture, view.frame, state.config.gaze_axis);
    const Vec3<double> middle =
        capture.frames[static_cast<std::size_t>(view.frame)].landmarks.rowwise().mean();
    const std::vector<Pinhole<double>> cameras =
        own_cameras(o.own, capture.camera(view.frame, view.camera), middle);
    std::vector<Drivers<float>> drivers{base};
    std::vector<PupilRatios> pupils;
    if (!o.driving.path.empty())
        drivers = driving_frames(o.driving, state, capture, base,
                                 pictures_a_second(parsed_rate(o.rate, "--fps")), &pupils);
    const std::size_t d = drivers.size(), c = cameras.size();
    require(d == c || d == 1 || c == 1, "rye redirect", "got ", d, " frames of --driving and ", c,
            " cameras of --cameras, expected as many of both, or one of either (--view)");
    Shot shot;
    for (std::size_t i = 0; i < std::max(d, c); ++i) {
        DrawnFrame f{drivers[d == 1 ? 0 : i], cameras[c == 1 ? 0 : i].cast<float>()};
        if (!o.left.empty()) f.drivers.gaze[0] = gaze_option(o.left, "--gaze-left");
        if (!o.right.empty()) f.drivers.gaze[1] = gaze_option(o.right, "--gaze-right");
        if (!pupils.empty()) f.pupil = pupils[d == 1 ? 0 : i];
        if (!o.pupil.empty()) f.pupil = {o.pupil.front(), o.pupil.back()};
        shot.frames.push_back(std::move(f));
    }
    if (o.idle.given())
        shot.frames = idle_frames(o.idle, o.at, parsed_rate(o.rate, "--fps"), state, capture,
                                  std::move(shot.frames), say);
    else if (o.at.given())
        aim_frames(o.at, state, shot.frames);
    if (o.own.given() || !o.own.size.empty()) {
        take_size(o.run, state, view, shot.frames);
    } else {
        const double dilation = dilation_of(o.run, state, capture);
        for (DrawnFrame& f : shot.frames) f.dilation = dilation;
    }
    if (o.compare)
        shot.photograph = on_background(capture.image(view.frame, view.camera),
                                        capture.mask(view.frame, view.camera), 1.0f);
    return shot;
}

/// Prints in how many pictures the head is outside: cameras and poses of two worlds rarely match.
void note_outside(const TrainState& state, const std::vector<DrawnFrame>& frames) {
    std::size_t outside = 0;
    for (const DrawnFrame& f : frames) {
        const Vec3<float> at = f.camera.project_point(head_middle(state, f.drivers));
        const bool seen = at.z() > f.camera.near_depth && at.x() >= 0 && at.y() >= 0 &&
                          at.x() <= static_cast<float>(f.camera.width) &&
                          at.y() <= static_cast<float>(f.camera.height);
        outside += seen ? 0 : 1;
    }
    if (outside > 0)
        std::cerr << "rye: note: the middle of the head lies outside of " << outside << " of "
                  << frames.size() << " pictures"
                  << (frames.size() > 1 ? "; --pose relative or own keeps it near the frame's\n"
                                        : "\n");
}

void write_video(const RedirectOptions& o, OutFormat format, const TrainState& state,
                 const std::vector<DrawnFrame>& frames, std::ostream& say) {
    const int count = static_cast<int>(frames.size());
    const FrameDrawer drawer = drawer_of(o, state, frames, say);
    say << drawer.explanation();
    const std::unique_ptr<MovingPicture> video =
        moving_picture(o.out, format, parsed_rate(o.rate, "--fps"), count);
    const bool terminal = is_terminal(Stream::errors);
    const auto begin = std::chrono::steady_clock::now();
    for (int i = 0; i < count; ++i) {
        video->add(to_8bit(drawer.picture(frames[static_cast<std::size_t>(i)])));
        if (terminal)
            std::cerr << "\r\033[Kpicture " << i + 1 << " of " << count
                      << left_words(std::chrono::duration<double>(
                                        std::chrono::steady_clock::now() - begin)
                                        .count(),
                                    i + 1, count)
                      << std::flush;
    }
    if (terminal) std::cerr << "\n";
    video->finish();
    say << o.out.string() << ": " << count << " pictures of " << frames.front().camera.width
        << " x " << frames.front().camera.height << " pixels\n";
}

/// Writes --labels of the pictures, if it is given.
void write_labels(const RedirectOptions& o, OutFormat format, const TrainState& state,
                  const std::vector<DrawnFrame>& frames, std::ostream& say) {
    if (o.labels.empty()) return;
    std::vector<std::string> names;
    const int count = static_cast<int>(frames.size());
    if (format == OutFormat::picture_folder)
        for (int i = 0; i < count; ++i) names.push_back(numbered_picture(i, count));
    else if (!moves(format))
        names.push_back(o.out.filename().string());
    const std::string text = text_of_labels(state, frames, names, o.at);
    write_atomic(o.labels, std::as_bytes(std::span(text)));
    say << o.labels.string() << ": labels of " << count << " pictures\n";
}

/// Returns the format. Throws an Error for options that exclude each other, before anything is
/// read.
OutFormat checked_format(const RedirectOptions& o) {
    const OutFormat format = out_format(o.out, formats, "--out");
    const bool many =
        o.idle.given() || !o.driving.path.empty() || (!o.own.file.empty() && o.own.view < 0);
    require(
        !moves(format) || many, "--out", "got ", o.out.string(),
        ", a video, but nothing moves: expected --driving, --idle, or --cameras "
        "without --view, or a single picture (",
        [&] {
            return list_of({OutFormat::png, OutFormat::jpeg});
        },
        ")");
    require(moves(format) || (o.driving.path.empty() && !o.idle.given()), "--out", "got ",
            o.out.string(), ", one picture, but ", (o.idle.given() ? "--idle" : "--driving"),
            " makes a video, expected ", [&] {
                return list_of({formats.begin() + 2, formats.end()});
            });
    require(format != OutFormat::y4m_stream || !is_terminal(Stream::output), "--out",
            "got -, and standard output is a terminal, expected a pipe or a file behind it");
    if (format == OutFormat::film) require_ffmpeg(o.out);
    for (const auto* gaze : {&o.left, &o.right})
        if (!gaze->empty()) gaze_option(*gaze, gaze == &o.left ? "--gaze-left" : "--gaze-right");
    return format;
}

void redirect(const RedirectOptions& o) {
    const OutFormat format = checked_format(o);
    set_threads(o.threads);
    std::ostream& say = format == OutFormat::y4m_stream ? std::cerr : std::cout;
    TrainState state = load_trained(o.run);
    relight(state, o.run, o.lights);
    Shot shot = shot_of(o, state, say);
    note_outside(state, shot.frames);
    if (moves(format)) {
        write_video(o, format, state, shot.frames, say);
        write_labels(o, format, state, shot.frames, say);
        return;
    }
    require(
        shot.frames.size() == 1, "--out", "got ", o.out.string(), ", one picture, but ",
        o.own.file.string(), " has ", shot.frames.size(),
        " cameras: choose one by --view, or a video (",
        [&] {
            return list_of({formats.begin() + 2, formats.end()});
        },
        ")");
    std::string explained;
    Image<float> picture;
    if (o.sweep) {
        picture = contact_sheet(o, state, shot.frames.front(), say, explained);
    } else {
        const FrameDrawer drawer = drawer_of(o, state, shot.frames, say);
        if (!o.effects.empty()) explained = drawer.explanation();
        picture = drawer.picture(shot.frames.front());
        if (shot.photograph) picture = side_by_side({*shot.photograph, picture});
    }
    say << explained;
    write_picture(o.out, format, picture);
    say << o.out.string() << "\n";
    write_labels(o, format, state, shot.frames, say);
}

} // namespace

void add_redirect(CLI::App& app) {
    auto o = std::make_shared<RedirectOptions>();
    CLI::App* c = app.add_subcommand(
        "redirect",
        "Render a trained head with another gaze, camera or drivers: a picture or a video");
    c->add_option("--run", o->run, "Folder of the run")
        ->required()
        ->check(folder_check("the folder of a run with its checkpoint"));
    c->add_option("--capture", o->capture,
                  "Folder of a capture whose frames and cameras are used "
                  "(default: the run's own, which lie in its folder)")
        ->check(folder_check("the folder of a capture"));
    c->add_option("--frame", o->frame, "Frame whose expression and head pose are used "
                                       "(default: the first test frame)");
    c->add_option("--camera", o->camera, "Camera of that frame (default: the most frontal)");
    add_camera_options(*c, o->own, {"default: the middle of the face", "that of --camera",
                                   "that of --camera", "that of --camera"});
    c->add_option("--gaze-left", o->left, "Subject's left eye: PITCH,YAW in degrees, head frame; "
                                          "+ is up and toward the subject's left")->delimiter(',');
    c->add_option("--gaze-right", o->right, "Subject's right eye: PITCH,YAW in degrees")->delimiter(',');
    c->add_option("--pupil", o->pupil,
                  "Radius of the pupils over that at rest: of both, or LEFT,RIGHT")
        ->delimiter(',')
        ->expected(1, 2)
        ->check(from_to(least_pupil, most_pupil));
    add_gaze_at_options(*c, o->at);
    for (const char* gaze : {"--gaze-left", "--gaze-right"})
        c->get_option("--gaze-at")->excludes(gaze);
    add_driving_options(*c, o->driving);
    add_idle_options(*c, o->idle);
    add_lights(*c, o->lights);
    c->add_option("--fps", o->rate, "Pictures a second of a video: 25, or 30000/1001")
        ->check(read_check(parsed_rate))
        ->capture_default_str();
    CLI::Option* const sweep =
        c->add_flag("--sweep", o->sweep, "A contact sheet of many gazes instead")
            ->excludes("--driving")
            ->excludes("--gaze-at")
            ->excludes("--idle");
    c->add_flag("--compare", o->compare,
                "Put the photograph of that frame beside it; needs the capture")
        ->excludes(sweep)
        ->excludes("--driving")
        ->excludes("--idle")
        ->excludes("--eye")
        ->excludes("--cameras");
    c->add_option("--labels", o->labels,
                  "File of JSON lines to write (.jsonl): of each picture both eyes' gazes, the "
                  "target, head and camera")
        ->check(read_check(check_labels_name))
        ->excludes(sweep)
        ->excludes("--compare");
    c->add_option("--effects", o->effects, "Draw by these effects, or by a variant: paper, talk, gaze "
                                           "or still (default: the fewest that the pictures call for)");
    c->add_option("--out", o->out,
                  "What to write: a picture (.png, .jpg), an animated PNG (.apng), a video by ffmpeg "
                  "(.mp4, .webm), Y4M for video programs (.y4m, or - for standard output), or a "
                  "folder of numbered pictures (no extension)")
        ->required()
        ->check(out_check(formats));
    add_device(*c, o->device, std::string(drawing_device_help) + ", and --effects leaves none out");
    add_memory(*c);
    add_threads(*c, o->threads);
    c->callback([o] { redirect(*o); });
}

} // namespace rye::trainer
