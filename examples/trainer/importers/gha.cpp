// SPDX-License-Identifier: Apache-2.0
/// Imports a folder as Gaussian Head Avatar prepares NeRSemble, or any capture that lacks gaze or
/// eye masks. Eye masks come from the landmarks of the lids; the gaze from a file, or from the iris
/// in the pictures. World: the source's, times a power of ten.
/// Source of the layout: Gaussian Head Avatar (Xu et al., 2024), its Dataset.
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include <rye/io/npz.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "corrections/gaze_estimator.hpp"
#include "data/checksums.hpp"
#include "data/config.hpp"
#include "data/degrees.hpp"
#include "data/json.hpp"
#include "data/median.hpp"
#include "data/threads.hpp"
#include "data/validate.hpp"
#include "importers/face_geometry.hpp"
#include "importers/gaze_file.hpp"
#include "importers/import_folder.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = ImportFolder::Json;

constexpr double limbus_share = 0.49, iris_share = 0.87; // shares of an average eye's radius

Mat3<double> rotation_of(const CaptureFrame& f) { return so3_exp(Vec3<double>(f.pose.head<3>())); }

Vec3<double> lids_of(const CaptureFrame& f, int eye) {
    const Vec3<double> world =
        f.landmarks.middleCols(eye_landmarks(eye).front(), 6).rowwise().mean();
    return rotation_of(f).transpose() * (world - f.pose.tail<3>()) / f.scale;
}

/// Returns the middle of the lids in the head frame, median over the frames.
Vec3<double> usual_lids(const Capture& c, int eye) {
    std::array<std::vector<double>, 3> all;
    for (const CaptureFrame& f : c.frames) {
        const Vec3<double> lids = lids_of(f, eye);
        for (std::size_t d = 0; d < 3; ++d) all[d].push_back(lids[static_cast<Index>(d)]);
    }
    return {median(all[0]), median(all[1]), median(all[2])};
}

/// Assumed eyeballs behind the lids, in the head frame. The upper lid covers more of an eye than
/// the lower one, so the centre is above the middle of the lids.
struct EyeGuess {
    double radius = EyeballConfig{}.radius; ///< canonical units
    double nasal = 0; ///< shift of both centres from the middle of their lids towards the nose
    std::array<Vec3<double>, 2> lids;
    Vec3<double> centre(std::size_t e) const {
        const Vec3<double> to_nose(e == 0 ? -nasal : nasal, 0, 0);
        return lids[e] + radius * Vec3<double>(0, 0.13, -0.88) + to_nose;
    }
};

/// Estimate from one picture.
struct Sighting {
    Vec3<double> gaze;
    double weight;
};

Image8 eye_mask_of(const Capture& c, int f, int k) {
    const CaptureView& view = c.view(f, k);
    if (!view.eye_mask.empty()) return read_image8(view.eye_mask, 1);
    Image8 eyes = lid_eye_mask(c.frames[static_cast<std::size_t>(f)].landmarks, view.camera);
    clip_to_mask(eyes, read_image8(view.mask, 1));
    return eyes;
}

/// Eye in one picture.
struct EyePicture {
    const CaptureFrame* frame;
    const Pinhole<double>* camera;
    const Image<float>* image;
    Columns<float> eye;
};

Columns<float> pixels_of(const Image8& eyes, std::size_t e) {
    Columns<float> out(1, static_cast<Index>(eyes.values.size()));
    for (std::size_t i = 0; i < eyes.values.size(); ++i)
        out(0, static_cast<Index>(i)) =
            eyes.values[i] == eye_mask_value(static_cast<int>(e)) ? 1.0f : 0.0f;
    return out;
}

std::optional<Sighting> sighted(const EyePicture& p, const EyeGuess& guess, std::size_t e) {
    const CaptureFrame& f = *p.frame;
    const Mat3<double> r = rotation_of(f);
    const double radius = guess.radius * f.scale;
    const EyeballGeometry ball{f.scale * (r * guess.centre(e)) + f.pose.tail<3>(), radius,
                               limbus_share * radius, r};
    const auto found = estimate_gaze(*p.image, p.eye, *p.camera, ball);
    if (!found || beyond_gaze_range(found->gaze)) return std::nullopt;
    return Sighting{found->gaze, found->contrast * found->pixels};
}

/// Direction on which the sightings agree, and their mean angle from it [deg]. Sightings far from
/// the weighted median of pitch and yaw do not count.
struct Agreed {
    Vec3<double> gaze;
    double spread;
    int sightings;
};
std::optional<Agreed> agreed(const std::vector<Sighting>& all) {
    if (all.empty()) return std::nullopt;
    Vec2<double> middle;
    double total = 0;
    for (const Sighting& s : all) total += s.weight;
    for (Index d = 0; d < 2; ++d) {
        std::vector<std::pair<double, double>> angles;
        for (const Sighting& s : all) angles.emplace_back(pitch_yaw(s.gaze)[d], s.weight);
        std::sort(angles.begin(), angles.end());
        double sum = 0;
        for (const auto& [angle, weight] : angles) {
            sum += weight;
            middle[d] = angle;
            if (sum >= 0.5 * total) break;
        }
    }
    const Vec3<double> near = gaze_vector(middle[0], middle[1]);
    constexpr double outlier = 12 / degrees;
    Vec3<double> sum = Vec3<double>::Zero();
    for (const Sighting& s : all)
        if (angular_error(s.gaze, near) < outlier) sum += s.weight * s.gaze;
    if (sum.isZero(0)) sum = near;
    Agreed a{normalized(sum), 0, 0};
    for (const Sighting& s : all) {
        if (angular_error(s.gaze, near) >= outlier) continue;
        a.spread += degrees * angular_error(s.gaze, a.gaze);
        ++a.sightings;
    }
    a.spread /= std::max(a.sightings, 1);
    return a;
}

/// Returns the sightings of both eyes in all cameras of a frame.
std::array<std::vector<Sighting>, 2> sightings(const Capture& c, int f, const EyeGuess& guess,
                                               const std::vector<Image8>& eyes) {
    const auto cameras = static_cast<std::size_t>(c.camera_count());
    std::vector<Image<float>> images(cameras);
    for (int k = 0; k < c.camera_count(); ++k) // the cache is for one thread
        if (c.view(f, k).present) images[static_cast<std::size_t>(k)] = c.image(f, k);
    std::vector<std::array<std::optional<Sighting>, 2>> found(cameras);
    program_threads().run(c.camera_count(), [&](Index i) {
        const int k = static_cast<int>(i);
        const auto at = static_cast<std::size_t>(i);
        if (!c.view(f, k).present) return;
        for (std::size_t e = 0; e < 2; ++e)
            found[at][e] = sighted({&c.frames[static_cast<std::size_t>(f)], &c.camera(f, k),
                                    &images[at], pixels_of(eyes[at], e)},
                                   guess, e);
    });
    std::array<std::vector<Sighting>, 2> all;
    for (const auto& both : found)
        for (std::size_t e = 0; e < 2; ++e)
            if (both[e]) all[e].push_back(*both[e]);
    return all;
}

std::vector<Image8> eye_masks_of(const Capture& c, int f) {
    std::vector<Image8> eyes(static_cast<std::size_t>(c.camera_count()));
    for (int k = 0; k < c.camera_count(); ++k)
        if (c.view(f, k).present) eyes[static_cast<std::size_t>(k)] = eye_mask_of(c, f, k);
    return eyes;
}

/// Returns the median yaw of the left axis minus that of the right one [rad]; nothing if no frame
/// has both.
std::optional<double> divergence(const Capture& c, const EyeGuess& guess,
                                 const std::vector<std::pair<int, std::vector<Image8>>>& frames) {
    std::vector<double> all;
    for (const auto& [f, eyes] : frames) {
        const auto seen = sightings(c, f, guess, eyes);
        const auto left = agreed(seen[0]), right = agreed(seen[1]);
        if (left && right) all.push_back(pitch_yaw(left->gaze)[1] - pitch_yaw(right->gaze)[1]);
    }
    if (all.empty()) return std::nullopt;
    return median(all);
}

/// Returns the radius at which the cameras of a sample of the frames agree best on the gaze, and
/// the shift towards the nose that gives both eyes average axes: each 5 degrees temporal of its
/// line of sight, which meet at about a metre.
EyeGuess guess_eyes(const Capture& c) {
    EyeGuess best;
    for (int e = 0; e < 2; ++e) best.lids[static_cast<std::size_t>(e)] = usual_lids(c, e);
    constexpr int sampled = 8;
    const int step = std::max(1, c.frame_count() / sampled);
    std::vector<std::pair<int, std::vector<Image8>>> frames;
    for (int f = 0; f < c.frame_count(); f += step) frames.emplace_back(f, eye_masks_of(c, f));
    constexpr std::array radii{0.105, 0.12, 0.135, 0.15, 0.165};
    std::array<double, radii.size()> score{};
    for (std::size_t i = 0; i < radii.size(); ++i) {
        EyeGuess guess = best;
        guess.radius = radii[i];
        double spread = 0, count = 0;
        for (const auto& [f, eyes] : frames)
            for (const std::vector<Sighting>& of_eye : sightings(c, f, guess, eyes))
                if (const auto a = agreed(of_eye); a && a->sightings > 1) {
                    spread += a->spread * a->sightings;
                    count += a->sightings;
                }
        score[i] = count > 0 ? spread / count : 0;
    }
    const auto least = std::min_element(score.begin(), score.end());
    if (*least > 0) best.radius = radii[static_cast<std::size_t>(least - score.begin())];
    constexpr double usual = 6 / degrees;
    for (int i = 0; i < 3; ++i) {
        const std::optional<double> now = divergence(c, best, frames);
        if (!now) break;
        best.nasal = std::clamp(best.nasal + iris_share * best.radius * 0.5 * (usual - *now),
                                -0.35 * best.radius, 0.35 * best.radius);
    }
    return best;
}

/// Source of a frame's gaze.
enum class GazeFrom { capture, file, iris };

struct GhaSource {
    Capture capture;
    double factor = 1;
    GazeFrom from = GazeFrom::iris;
    EyeGuess guess;
    std::map<std::string, GazeRow> file;
};

GhaSource read_gha(const ImportOptions& o) {
    require(fs::is_directory(o.source), o.source.string(),
            "no folder, expected one with images, cameras and params");
    require(!fs::exists(o.source / "transforms.json") || fs::exists(o.source / "params"),
            (o.source / "transforms.json").string(),
            "a folder of photographs: `rye import transforms` or `rye import vhap` reads it");
    GhaSource s;
    std::vector<Problem> problems;
    s.capture = read_capture(o.source, {}, &problems);
    for (const Problem& p : problems)
        if (p.severity == Problem::Severity::error) throw Error(p.message);
    require(!s.capture.frames.empty(), o.source.string(), "has no frames");
    const double span = landmark_span(s.capture);
    require(span > 0, (o.source / "params").string(), "lmk_3d: all landmarks are in one place");
    s.factor = unit_factor(span);
    for (CaptureFrame& f : s.capture.frames) {
        f.pose.tail<3>() *= s.factor;
        f.scale *= s.factor;
        f.landmarks *= s.factor;
        f.vertices *= s.factor;
        for (CaptureEye& eye : f.eyes) {
            if (eye.centre) *eye.centre *= s.factor;
            for (auto* length : {&eye.radius, &eye.limbus_radius, &eye.iris_plane})
                if (*length) **length *= s.factor;
        }
    }
    for (CaptureView& v : s.capture.views) v.camera.camera_from_world.translation *= s.factor;
    if (!o.gaze.empty()) {
        s.from = GazeFrom::file;
        std::vector<std::string> frames;
        for (const CaptureFrame& f : s.capture.frames) frames.push_back(f.id);
        s.file = read_gaze_file(o.gaze, frames);
    } else if (s.capture.has_gaze()) {
        s.from = GazeFrom::capture;
    } else {
        s.guess = guess_eyes(s.capture);
    }
    return s;
}

/// Spread of a frame's gazes [deg] and number of pictures.
struct GazeFacts {
    double spread = 0;
    int sightings = 0, borrowed = 0;
    bool found = true;
};

/// Returns the frame's eyes, from the frame's source of gaze.
std::array<CaptureEye, 2> eyes_of(const GhaSource& s, int f, const std::vector<Image8>& masks,
                                  GazeFacts& facts) {
    const CaptureFrame& frame = s.capture.frames[static_cast<std::size_t>(f)];
    std::array<CaptureEye, 2> eyes = frame.eyes;
    if (s.from == GazeFrom::capture) return eyes;
    if (s.from == GazeFrom::file) {
        for (std::size_t e = 0; e < 2; ++e) eyes[e].optical = s.file.at(frame.id)[e];
        return eyes;
    }
    const auto seen = sightings(s.capture, f, s.guess, masks);
    const std::array<std::optional<Agreed>, 2> gaze{agreed(seen[0]), agreed(seen[1])};
    facts.found = gaze[0] || gaze[1];
    for (std::size_t e = 0; e < 2; ++e) {
        if (gaze[e]) {
            facts.spread += gaze[e]->spread * gaze[e]->sightings;
            facts.sightings += gaze[e]->sightings;
            eyes[e].optical = gaze[e]->gaze;
        } else if (gaze[1 - e]) {
            eyes[e].optical = gaze[1 - e]->gaze;
            ++facts.borrowed;
        }
        const double radius = s.guess.radius * frame.scale;
        eyes[e].centre =
            frame.scale * (rotation_of(frame) * s.guess.centre(e)) + frame.pose.tail<3>();
        eyes[e].radius = radius;
        eyes[e].limbus_radius = limbus_share * radius;
        eyes[e].iris_plane = iris_share * radius;
    }
    return eyes;
}

ImportFrame frame_of(const GhaSource& s, int f, Json& facts) {
    const Capture& c = s.capture;
    const CaptureFrame& from = c.frames[static_cast<std::size_t>(f)];
    const std::vector<Image8> masks = eye_masks_of(c, f);
    GazeFacts gaze;
    ImportHead head;
    head.expression.assign(from.expression.begin(), from.expression.end());
    head.pose = from.pose;
    head.scale = from.scale;
    head.landmarks = from.landmarks;
    head.vertices = from.vertices;
    head.eyes = eyes_of(s, f, masks, gaze);
    head.has_gaze = gaze.found;
    ImportFrame frame{from.id, head, {}};
    int derived = 0;
    for (int k = 0; k < c.camera_count(); ++k) {
        const CaptureView& v = c.view(f, k);
        if (!v.present) continue;
        ImportView view;
        view.camera = c.camera_ids[static_cast<std::size_t>(k)];
        view.pinhole = v.camera;
        view.copy_of = v.image;
        view.mask = read_image8(v.mask, 1);
        if (!v.visible.empty()) view.visible = read_image8(v.visible, 1);
        view.eyes = masks[static_cast<std::size_t>(k)];
        derived += v.eye_mask.empty() ? 1 : 0;
        frame.views.push_back(std::move(view));
    }
    facts = {{"views", frame.views.size()}, {"eye_masks", derived},
             {"gaze", gaze.found},          {"spread", gaze.spread},
             {"sightings", gaze.sightings}, {"borrowed", gaze.borrowed}};
    return frame;
}

/// Returns the capture.json of the source, or its substitute for a folder without one.
Json description(const GhaSource& s, const std::set<std::string>& left_out) {
    const fs::path file = s.capture.folder / "capture.json";
    Json json = fs::exists(file) ? read_json<Json>(file) : Json::object();
    const auto list = [&](const std::vector<int>& frames) {
        Json names = Json::array();
        for (const int f : frames)
            if (const std::string& id = s.capture.frames[static_cast<std::size_t>(f)].id;
                !left_out.contains(id))
                names.push_back(id);
        return names;
    };
    if (!json.contains("subject")) json["subject"] = s.capture.folder.filename().string();
    json["image_size"] = {s.capture.width, s.capture.height};
    json["train_frames"] = list(s.capture.train);
    json["test_frames"] = list(s.capture.test);
    for (const char* key : {"novel_gaze_test_frames", "independent_gaze_test_frames"})
        if (json.contains(key))
            json[key] = list(std::string(key)[0] == 'n' ? s.capture.novel_gaze
                                                        : s.capture.independent_gaze);
    Json conventions = Json::object();
    if (json.contains("conventions")) {
        if (json.at("conventions").is_object()) conventions = json.at("conventions");
        else conventions["source"] = json.at("conventions"); // text for people
    }
    conventions["image"] = s.capture.images_over_black
                               ? "over black"
                               : "photographs; multiplied by the mask when read";
    conventions["world"] = "that of the source, lengths times " + factor_text(s.factor);
    json["conventions"] = conventions;
    if (s.from == GazeFrom::iris) json["gazes"] = "irises";
    else if (s.from == GazeFrom::file) json.erase("gazes");
    return json;
}

/// Sums of the facts of all frames.
struct GhaTotals {
    int views = 0, eye_masks = 0, sightings = 0, borrowed = 0;
    double spread = 0;
    std::set<std::string> left_out;
};

void summarize(const GhaSource& s, const GhaTotals& t, ImportSummary& summary) {
    summary.found = {std::to_string(t.views) + " pictures, cameras and masks",
                     std::to_string(s.capture.expression_width()) +
                         " expression coefficients, head poses, landmarks, " +
                         std::to_string(s.capture.frames.front().vertices.cols()) + " vertices"};
    if (t.eye_masks < t.views)
        summary.found.push_back(std::to_string(t.views - t.eye_masks) + " eye masks");
    if (t.eye_masks > 0)
        summary.derived.push_back(std::to_string(t.eye_masks) +
                                  " eye masks: the polygons of the lids' landmarks");
    if (s.from == GazeFrom::capture) summary.found.push_back("gaze of every frame");
    if (s.from == GazeFrom::file) summary.found.push_back("gaze of every frame, from --gaze");
    if (s.from == GazeFrom::iris) {
        summary.derived.push_back(
            "gaze from the iris in " + std::to_string(t.sightings) +
            " pictures of an eye, on eyeballs of radius " + factor_text(s.guess.radius) +
            " behind the lids, so that the axes of both eyes diverge as those of average eyes; the "
            "cameras of a frame agree to " +
            factor_text(t.spread / std::max(t.sightings, 1)) +
            " degrees in the mean, but an error that all share (a centre or radius that is off) "
            "does not show in that: expect some degrees");
        summary.derived.push_back(
            "eyeballs' centres and sizes: of an average eye, placed by the "
            "lids");
        if (t.borrowed > 0)
            summary.derived.push_back(
                std::to_string(t.borrowed) +
                " gazes of an eye from the other eye: its iris was not found");
        if (!t.left_out.empty())
            summary.missing.push_back(std::to_string(t.left_out.size()) +
                                      " frames have no iris that was found (closed eyes?) and are "
                                      "in no list of frames");
    }
    if (s.factor != 1)
        summary.derived.push_back("lengths times " + factor_text(s.factor) +
                                  ", so that a head spans about 2 units");
}

} // namespace

ImportSummary import_gha(const ImportOptions& o) {
    Json job = import_job("gha", o);
    job["gaze"] = o.gaze.empty() ? "" : fs::weakly_canonical(o.gaze).string();
    const GhaSource s = read_gha(o);
    warn_of_changes(o.source); // if it is a capture
    ImportFolder folder(o.out, job);
    ImportSummary summary;
    GhaTotals totals;
    for (int f = 0; f < s.capture.frame_count(); ++f) {
        const std::string& id = s.capture.frames[static_cast<std::size_t>(f)].id;
        if (!folder.has(id)) {
            Json facts;
            const ImportFrame frame = frame_of(s, f, facts);
            folder.write(frame, facts);
            ++summary.written;
        }
        const Json& facts = folder.facts(id);
        totals.views += facts.value("views", 0);
        totals.eye_masks += facts.value("eye_masks", 0);
        totals.sightings += facts.value("sightings", 0);
        totals.borrowed += facts.value("borrowed", 0);
        totals.spread += facts.value("spread", 0.0);
        if (!facts.value("gaze", true)) totals.left_out.insert(id);
        o.progress(++summary.frames, s.capture.frame_count());
    }
    require(totals.left_out.size() < static_cast<std::size_t>(s.capture.frame_count()),
            o.source.string(),
            "in no frame was an iris found: the eyes have too few pixels, or the landmarks are not "
            "on the lids; give the gaze by --gaze FILE");
    summary.cameras = s.capture.camera_count();
    summarize(s, totals, summary);
    folder.finish(description(s, totals.left_out), summary);
    return summary;
}

} // namespace rye::trainer
