// SPDX-License-Identifier: Apache-2.0
/// Imports videos that one camera took of one head. Programs that are no part of rye track the face
/// (video_tools.hpp); camera, poses, landmarks, eyeballs and gazes follow from all pictures together
/// (video_head.hpp). World and head frame: video_head.hpp. Expression: the tracker's coefficients.
#include <algorithm>
#include <cstdlib>
#include <optional>
#include <set>

#include <rye/io/npz.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/median.hpp"
#include "importers/face_mesh.hpp"
#include "importers/import_folder.hpp"
#include "importers/video_choice.hpp"
#include "importers/video_dots.hpp"
#include "importers/video_gaze.hpp"
#include "importers/video_pictures.hpp"
#include "importers/video_tools.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = ImportFolder::Json;

/// Errors of a picture's landmarks from which on it is left out, over the median of all.
constexpr double doubtful = 2.5;
/// Every so many-th picture is a test frame.
constexpr int test_stride = 5;

bool is_tracked(const fs::path& source) { return fs::exists(source / "tracks.jsonl"); }

Json job_of(const ImportOptions& o) {
    require(!o.video.files.empty(), "rye import video", "FILE is missing");
    Json sources = Json::array();
    for (const fs::path& file : o.video.files) {
        require(fs::exists(file), file.string(), "no such file or folder");
        require(!fs::is_directory(file) || is_tracked(file), file.string(),
                "is a folder without tracks.jsonl, expected a video or a folder of tracks");
        sources.push_back(fs::weakly_canonical(file).string());
    }
    return {{"kind", "video"},         {"source", sources},
            {"every", o.video.every},  {"size", o.video.size},
            {"frames", o.video.frames}, {"focal", o.video.focal},
            {"iris_mm", o.video.iris_mm},
            {"dots", o.video.dots.empty() ? "" : fs::weakly_canonical(o.video.dots).string()}};
}

/// Returns the folders of the tracks of all videos, which it makes where they are missing.
std::vector<fs::path> tracked(const ImportOptions& o) {
    std::vector<fs::path> folders;
    const bool all = std::all_of(o.video.files.begin(), o.video.files.end(), is_tracked);
    const VideoTools tools =
        all ? VideoTools{} : find_video_tools({o.video.modules, o.video.landmarker, o.video.tracker});
    fs::path beside = o.out.has_filename() ? o.out : o.out.parent_path();
    beside += ".tracks";
    for (std::size_t i = 0; i < o.video.files.size(); ++i) {
        const fs::path& file = o.video.files[i];
        if (is_tracked(file)) {
            folders.push_back(file);
            continue;
        }
        folders.push_back(beside / std::to_string(i));
        track_video(tools, file, o.video.every, folders.back(), o.video.progress);
    }
    return folders;
}

std::string frame_id(const TrackedPicture& p, bool several) {
    const std::string number = std::to_string(p.number);
    std::string id = std::string(number.size() < 4 ? 4 - number.size() : 0, '0') + number;
    return several ? std::to_string(p.video) + "_" + id : id;
}

ImportHead head_of(const Tracks& tracks, const VideoHead& head, const VideoPose& pose) {
    const TrackedPicture& p = tracks.pictures[static_cast<std::size_t>(pose.picture)];
    ImportHead out;
    for (const int i : head.drivers) out.expression.push_back(p.coefficients[i]);
    out.pose << so3_log(pose.world_from_head.rotation), pose.world_from_head.translation;
    out.landmarks.resize(3, 68);
    for (std::size_t i = 0; i < 68; ++i)
        out.landmarks.col(static_cast<Index>(i)) = pose.landmarks.col(face_ibug[i]);
    out.vertices = pose.landmarks;
    out.has_gaze = true;
    for (std::size_t e = 0; e < 2; ++e) {
        CaptureEye& eye = out.eyes[e];
        eye.optical = pose.gaze[e];
        eye.centre = pose.world_from_head.apply(head.eyes[e].centre);
        eye.radius = head.eyes[e].radius;
        eye.limbus_radius = head.eyes[e].limbus_radius;
        eye.iris_plane = head.eyes[e].iris_plane;
    }
    return out;
}

/// Displacements by the expressions, as expression_shapes.npz has them.
Bytes shapes_file(const VideoHead& head) {
    std::vector<float> landmarks, vertices;
    for (Index e = 0; e < head.shapes.cols(); ++e) {
        const auto add = [&](std::vector<float>& list, Index i) {
            for (Index d = 0; d < 3; ++d) list.push_back(static_cast<float>(head.shapes(3 * i + d, e)));
        };
        for (const int i : face_ibug) add(landmarks, i);
        for (Index i = 0; i < skin_landmarks; ++i) add(vertices, i);
    }
    const auto array = [&](const std::vector<float>& values, Index points) {
        return npy_array<float>({head.shapes.cols(), points, 3}, std::span<const float>(values));
    };
    return npz_bytes({{"landmarks", array(landmarks, 68)}, {"vertices", array(vertices, skin_landmarks)}});
}

std::string words_of(const VideoGazes& gazes, const std::optional<DotClock>& clock, const DotGazes& dots,
                     std::size_t poses) {
    std::string words = "gaze from the tracker's coefficients (eyeLook*)";
    if (gazes.up_deg != 0)
        words += " and " + std::to_string(gazes.seen) + " irises in " + std::to_string(2 * poses) +
                 " pictures of eyes, which look " + factor_text(gazes.up_deg) + " degrees further up";
    if (clock)
        words += "; in " + std::to_string(dots.pictures) + " pictures from the dots, which begin " +
                 factor_text(clock->begin) + " s into the video (correlation " +
                 factor_text(clock->correlation) + ") and change a gaze's angles by " +
                 factor_text(dots.off_deg) + " degrees";
    return words + "; eyeballs of average eyes behind the lids, fixed in the head";
}

void summarize(const Tracks& tracks, const VideoChoice& choice, const VideoHead& head,
               const VideoGazes& gazes, const std::optional<DotClock>& clock, const DotGazes& dots,
               int left_out, const ImportOptions& o, ImportSummary& s) {
    const auto percent = [](double x) { return factor_text(100 * x) + " %"; };
    const std::vector<TrackedPicture>& all = tracks.pictures;
    const int step = all.size() > 1 ? std::abs(all[1].number - all[0].number) : 1;
    s.found = {std::to_string(all.size()) + " tracked pictures of " + std::to_string(tracks.width) +
                   " x " + std::to_string(tracks.height) + " pixels" +
                   (step > 3 ? ", one in " + std::to_string(step) + " of the video's (--every)" : ""),
               std::to_string(head.drivers.size()) + " expression coefficients of the tracker"};
    s.derived = {
        std::string("focal length ") + factor_text(head.camera.fx) + " px, " +
            (o.video.focal > 0 ? "as --focal says"
                               : "sigma " + percent(head.focal_deviation) +
                                     ": mostly what cameras of phones have; --focal gives a known one"),
        "head poses and " + std::to_string(skin_landmarks) +
            " landmarks by bundle adjustment, whose errors are " + factor_text(head.landmark_error) +
            " px in the middle",
        "scale by an iris of " + factor_text(o.video.iris_mm) + " mm (--iris-mm)",
        words_of(gazes, clock, dots, head.poses.size()),
        "eye masks from the tracked lids; masks from the tracker's segmentation, without the neck"};
    s.missing = {"what one camera did not see", "angle kappa between optical and visual axis"};
    const auto add = [&](int count, const char* what) {
        if (count > 0) s.missing.push_back(std::to_string(count) + " pictures left out: " + what);
    };
    add(choice.without_face, "no face");
    add(choice.with_several, "several faces");
    add(choice.at_border, "the face is cut off");
    add(choice.blurred, "blurred");
    add(choice.unwanted, "the eyes are between dots, or head and expression are as in one with a dot");
    add(left_out, "landmarks or gaze in doubt");
    add(choice.spare, "like others that are taken (--frames)");
}

} // namespace

ImportSummary import_video(const ImportOptions& o) {
    const Json job = job_of(o);
    std::vector<GazeDot> dots;
    if (!o.video.dots.empty()) dots = read_gaze_dots(o.video.dots);
    const Tracks tracks = read_tracks(tracked(o));
    std::optional<DotClock> clock;
    if (!dots.empty()) clock = find_dots(tracks, std::move(dots), o.video.dots.string());
    const VideoChoice choice =
        choose_pictures(tracks, o.video.frames, [&](const TrackedPicture& p) {
            if (!clock || clock->looked_at(p)) return Wanted::preferred;
            // Between two dots nobody knows where the eyes are.
            return clock->has(p) ? Wanted::no : Wanted::otherwise;
        });
    VideoHead head = video_head(tracks, choice.pictures, {o.video.focal, o.video.iris_mm});
    const VideoGazes gazes = correct_gazes(tracks, head);
    const DotGazes looks = clock ? look_at_dots(tracks, *clock, head) : DotGazes{};
    std::vector<double> residuals;
    for (const VideoPose& pose : head.poses) residuals.push_back(pose.residual);
    const double most = doubtful * median(residuals);
    std::vector<const VideoPose*> poses;
    std::vector<int> pictures;
    for (const VideoPose& pose : head.poses) {
        if (pose.residual > most || beyond_gaze_range(pose.gaze[0]) || beyond_gaze_range(pose.gaze[1]))
            continue;
        poses.push_back(&pose);
        pictures.push_back(pose.picture);
    }
    const int left_out = static_cast<int>(head.poses.size() - poses.size());
    require(static_cast<int>(poses.size()) >= least_pictures, "rye import video",
            "landmarks or gazes are in doubt in ", left_out, " of ", head.poses.size(),
            " pictures, expected ", least_pictures, " good ones or more");
    const VideoSquare square = square_of(tracks, pictures, o.video.size);

    ImportFolder folder(o.out, job);
    ImportSummary summary;
    summary.cameras = 1;
    Json train = Json::array(), test = Json::array(), names = Json::array();
    for (const VideoPose* pose : poses) {
        const std::string id = frame_id(tracks.pictures[static_cast<std::size_t>(pose->picture)],
                                        o.video.files.size() > 1);
        (summary.frames % test_stride == test_stride - 1 ? test : train).push_back(id);
        if (!folder.has(id)) {
            folder.write({id, head_of(tracks, head, *pose), {view_of(tracks, head, *pose, square)}},
                         {{"residual", pose->residual}});
            ++summary.written;
        }
        o.progress(++summary.frames, static_cast<int>(poses.size()));
    }
    for (const int i : head.drivers) names.push_back(tracks.names[static_cast<std::size_t>(i)]);
    const Bytes shapes = shapes_file(head);
    folder.write_file("expression_shapes.npz", std::string(as_text(shapes)));
    summarize(tracks, choice, head, gazes, clock, looks, left_out, o, summary);
    folder.finish({{"subject", o.video.files.front().stem().string()},
                   {"image_size", {square.size, square.size}},
                   {"train_frames", train},
                   {"test_frames", test},
                   {"exp_names", names},
                   {"unit_mm", 100},
                   {"video",
                    {{"focal", head.camera.fx},
                     {"square", {square.left, square.top, square.side}}}},
                   {"conventions",
                    {{"image", "photographs; multiplied by the mask when read"},
                     {"world", "x the subject's left, y up, z towards the camera; 1 dm"},
                     {"gaze", !clock ? "optical axes from the tracker's coefficients and irises, head frame"
                                  : "optical axes to dots, else from the tracker's coefficients and "
                                    "irises, head frame"}}}},
                  summary);
    return summary;
}

} // namespace rye::trainer
