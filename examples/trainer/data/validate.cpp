// SPDX-License-Identifier: Apache-2.0
#include "data/validate.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <string>
#include <utility>

#include <rye/io/eye_sizes.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/checksums.hpp"
#include "data/config.hpp"
#include "data/degrees.hpp"
#include "data/expression_shapes.hpp"
#include "data/median.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

constexpr double head_span = 2.2;      ///< of 66 landmarks of an adult [dm]
constexpr double usual_distance = 4.5; ///< of a camera, in spans of the head
constexpr int max_sampled_views = 64;
constexpr double max_expression = 1000; ///< larger values overflow the networks
constexpr int min_side = 16;            ///< of an image [px]; SSIM has a window of 11
constexpr int few_cameras = 3;          ///< fewer see one side of a head only
constexpr int few_frames = 8;           ///< fewer do not cover the gazes of an eye

/// Returns a number with three significant digits.
std::string text(double x) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%.3g", x);
    return digits;
}

/// Returns a text such as "1 camera" or "2 cameras".
std::string count_text(int n, const char* what) {
    return std::to_string(n) + " " + what + (n == 1 ? "" : "s");
}

/// Returns the nearest power of ten: units differ by powers of ten.
double power_of_ten(double x) { return std::pow(10.0, std::round(std::log10(x))); }

/// Collector of problems, which reports the first of a kind and the number of the others.
class Findings {
  public:
    void error(const char* kind, const std::string& message) {
        add(Problem::Severity::error, kind, message);
    }
    void warning(const char* kind, const std::string& message) {
        add(Problem::Severity::warning, kind, message);
    }
    std::vector<Problem> list() const {
        std::vector<Problem> out = problems_;
        for (const auto& [kind, place] : places_)
            if (place.count > 1)
                out[place.index].message +=
                    " (and " + std::to_string(place.count - 1) + " more like this)";
        return out;
    }

  private:
    struct Place {
        std::size_t index = 0;
        int count = 0;
    };
    void add(Problem::Severity severity, const char* kind, const std::string& message) {
        Place& place = places_[kind];
        if (place.count++ > 0) return;
        place.index = problems_.size();
        problems_.push_back({severity, message});
    }
    std::vector<Problem> problems_;
    std::map<std::string, Place> places_;
};

std::string file_of(const Capture& c, const CaptureFrame& f, const char* name) {
    return (c.folder / "params" / f.id / name).string();
}
std::string camera_file(const Capture& c, int frame, int camera) {
    return (c.folder / "cameras" / c.frames[static_cast<std::size_t>(frame)].id /
            ("camera_" + c.camera_ids[static_cast<std::size_t>(camera)] + ".npz"))
        .string();
}

Mat3<double> head_rotation(const CaptureFrame& f) {
    return so3_exp(Vec3<double>(f.pose.head<3>()));
}
Vec3<double> to_head(const CaptureFrame& f, const Vec3<double>& world) {
    return head_rotation(f).transpose() * (world - f.pose.tail<3>()) / f.scale;
}
Columns<double> head_landmarks(const CaptureFrame& f) {
    const Vec3<double> t = f.pose.tail<3>();
    return head_rotation(f).transpose() * (f.landmarks.colwise() - t) / f.scale;
}

struct ViewIndex {
    int frame, camera;
};

/// Returns at most `limit` views that are present, spread evenly over frames and cameras.
std::vector<ViewIndex> sampled_views(const Capture& c, std::size_t limit) {
    std::vector<ViewIndex> all;
    for (int f = 0; f < c.frame_count(); ++f)
        for (int k = 0; k < c.camera_count(); ++k)
            if (c.view(f, k).present) all.push_back({f, k});
    if (all.size() <= limit) return all;
    // A stride by the golden section covers all frames and all cameras.
    std::vector<ViewIndex> out;
    double at = 0;
    for (std::size_t i = 0; i < limit; ++i) {
        out.push_back(all[static_cast<std::size_t>(at * static_cast<double>(all.size()))]);
        at += 0.6180339887498949;
        at -= std::floor(at);
    }
    return out;
}

// ---- landmarks in the masks --------------------------------------------------------------------

struct MaskedView {
    Pinhole<double> camera;
    Image<float> mask;
    const Columns<double>* landmarks;
};

std::vector<MaskedView> masked_views(const Capture& c) {
    std::vector<MaskedView> out;
    for (const auto [f, k] : sampled_views(c, max_sampled_views)) {
        try {
            out.push_back(
                {c.camera(f, k), c.mask(f, k), &c.frames[static_cast<std::size_t>(f)].landmarks});
        } catch (const Error&) {
            continue; // reported by check_pixels
        }
    }
    return out;
}

using CameraChange = std::function<void(Pinhole<double>&)>;

LandmarkFit fit(const std::vector<MaskedView>& views, const CameraChange& change) {
    LandmarkFit sum;
    double n = 0;
    for (const MaskedView& v : views) {
        Pinhole<double> camera = v.camera;
        change(camera);
        for (Index i = 0; i < v.landmarks->cols(); ++i) {
            ++n;
            const Vec3<double> p = camera.project_point(v.landmarks->col(i));
            if (!(p.z() > 0)) continue;
            ++sum.in_front;
            if (!(p.x() >= 0 && p.x() < v.mask.width && p.y() >= 0 && p.y() < v.mask.height))
                continue;
            ++sum.inside_image;
            const auto x = static_cast<int>(p.x()), y = static_cast<int>(p.y());
            if (v.mask.at(x, y)[0] >= 0.5f) ++sum.inside_mask;
        }
    }
    sum.views = static_cast<int>(views.size());
    for (double* share : {&sum.in_front, &sum.inside_image, &sum.inside_mask})
        *share /= std::max(n, 1.0);
    return sum;
}

void flip_camera_axes(Pinhole<double>& c) {
    Rigid<double>& m = c.camera_from_world;
    const Vec3<double> flip(1, -1, -1);
    m.rotation = flip.asDiagonal() * m.rotation;
    m.translation = flip.cwiseProduct(m.translation);
}

void invert_camera(Pinhole<double>& c) { c.camera_from_world = c.camera_from_world.inverse(); }

/// Returns the correction, in words, that would move the landmarks into the masks; empty if none
/// does.
std::string remedy(const std::vector<MaskedView>& views) {
    const std::vector<std::pair<std::string, CameraChange>> changes{
        {"the cameras have OpenGL axes (y up, z backward): negate rows 2 and 3 of extrinsic",
         flip_camera_axes},
        {"extrinsic is camera to world: invert it", invert_camera},
        {"extrinsic is camera to world with OpenGL axes, as in NeRF: invert it, then negate rows 2 "
         "and 3",
         [](Pinhole<double>& c) {
             invert_camera(c);
             flip_camera_axes(c);
         }},
        {"the world of lmk_3d and that of the cameras differ by half a turn about x: negate "
         "columns 2 and 3 of extrinsic",
         [](Pinhole<double>& c) {
             const Vec3<double> flip(1, -1, -1);
             c.camera_from_world.rotation = c.camera_from_world.rotation * flip.asDiagonal();
         }},
        {"intrinsic belongs to images of another size: scale it so that its principal point is "
         "near the middle",
         [](Pinhole<double>& c) {
             const double sx = c.width / (2 * c.cx), sy = c.height / (2 * c.cy);
             c.fx *= sx;
             c.cx *= sx;
             c.fy *= sy;
             c.cy *= sy;
         }}};
    std::string best;
    double best_share = 0.8; // a correction must reach this share
    for (const auto& [words, change] : changes) {
        const double share = fit(views, change).inside_mask;
        if (share > best_share) {
            best = words;
            best_share = share;
        }
    }
    return best;
}

void check_projection(const Capture& c, Findings& found) {
    const std::vector<MaskedView> views = masked_views(c);
    if (views.empty()) return;
    const LandmarkFit now = fit(views, [](Pinhole<double>&) {});
    if (now.inside_mask >= 0.9) return;
    const std::string shares = "only " + text(100 * now.inside_mask) +
                               " % of the points of lmk_3d "
                               "fall into the masks (" +
                               text(100 * now.in_front) + " % in front of the camera, " +
                               text(100 * now.inside_image) +
                               " % inside the image), expected nearly all";
    const std::string where = (c.folder / "cameras").string() + ": ";
    const std::string advice = remedy(views);
    if (now.inside_mask >= 0.7)
        found.warning("projection", where + shares);
    else
        found.error("projection", where + shares + (advice.empty() ? "" : "; " + advice));
}

// ---- units and cameras -------------------------------------------------------------------------

void check_units(const Capture& c, double span, Findings& found) {
    const std::string where = file_of(c, c.frames.front(), "lmk_3d.npy");
    if (!(span > 0)) return found.error("units", where + ": all landmarks are in one place");
    if (span < 0.7 || span > 7) {
        const double factor = power_of_ten(head_span / span);
        const char* unit = factor == 0.01   ? "it looks like millimetres: "
                           : factor == 0.1  ? "it looks like centimetres: "
                           : factor == 10.0 ? "it looks like metres: "
                                            : "";
        found.error("units", where + ": the landmarks span " + text(span) +
                                 " units, expected about 2 (decimetres); " + unit +
                                 "multiply lmk_3d, vertices, the translations of pose and "
                                 "extrinsic, and the eyes' centres, radii and iris planes by " +
                                 text(factor));
    }
}

void check_cameras(const Capture& c, double span, Findings& found) {
    for (const auto [f, k] : sampled_views(c, static_cast<std::size_t>(-1))) {
        const Pinhole<double>& camera = c.camera(f, k);
        const Columns<double>& landmarks = c.frames[static_cast<std::size_t>(f)].landmarks;
        const std::string where = camera_file(c, f, k);
        const Vec3<double> head = landmarks.rowwise().mean();
        const double distance = norm(Vec3<double>(camera.centre() - head));
        if (distance < 0.7 * span || distance > 200 * span)
            found.error("distance",
                        where + ": extrinsic: the camera is " + text(distance) +
                            " units from landmarks that span " + text(span) +
                            ", expected 1 to 100 times that; if the units differ, multiply the "
                            "translation in extrinsic by " +
                            text(power_of_ten(usual_distance * span / distance)));
        if (camera.camera_from_world.apply(head).z() <= 0)
            found.error("behind", where + ": extrinsic: the head is behind the camera (depth " +
                                      text(camera.camera_from_world.apply(head).z()) +
                                      "), expected z forward (OpenCV)");
        if (camera.cx < 0 || camera.cx > c.width || camera.cy < 0 || camera.cy > c.height)
            found.error("principal", where + ": intrinsic: the principal point (" +
                                         text(camera.cx) + ", " + text(camera.cy) +
                                         ") is outside the image of " + std::to_string(c.width) +
                                         " x " + std::to_string(c.height) +
                                         " pixels: intrinsic must be in its pixels");
        const double focal = camera.fx / c.width;
        if (focal < 0.3 || focal > 100)
            found.error("focal", where + ": intrinsic: a focal length of " + text(camera.fx) +
                                     " pixels for an image " + std::to_string(c.width) +
                                     " wide, expected 0.3 to 100 times that");
        if (std::abs(camera.fx / camera.fy - 1) > 0.1)
            found.warning("aspect", where + ": intrinsic: focal lengths " + text(camera.fx) +
                                        " and " + text(camera.fy) + " differ by more than 10 %");
    }
}

// ---- values that leave no space for a head -----------------------------------------------------

/// Checks for points and scales outside the range of single precision.
void check_extent(const Capture& c, double span, Findings& found) {
    if (c.width < min_side || c.height < min_side)
        found.error("size", c.folder.string() + ": images of " + std::to_string(c.width) + " x " +
                                std::to_string(c.height) + " pixels, expected at least " +
                                std::to_string(min_side) + " x " + std::to_string(min_side));
    for (const CaptureFrame& f : c.frames) {
        const double head = span / f.scale;
        if (!(head > 0.05 && head < 100))
            found.error("scale", file_of(c, f, "params.npz") + ": scale: got " + text(f.scale) +
                                     ", by which the landmarks span " + text(head) +
                                     " units of the head's frame, expected about 2");
        if (f.vertices.cols() == 0) continue;
        const Vec3<double> middle = f.landmarks.rowwise().mean();
        Index farthest = 0;
        const double away =
            std::sqrt((f.vertices.colwise() - middle).colwise().squaredNorm().maxCoeff(&farthest));
        if (!(away < 10 * span))
            found.error("vertices", file_of(c, f, "vertices.npy") + ": vertex " +
                                        std::to_string(farthest) + " is " + text(away) +
                                        " units from landmarks that span " + text(span) +
                                        ", expected less than 10 times that");
    }
}

// ---- pose and landmarks ------------------------------------------------------------------------

Vec3<double> mean_of(const Columns<double>& points, Index first, Index count) {
    return points.middleCols(first, count).rowwise().mean();
}

void check_head_frame(const Capture& c, double span, Findings& found) {
    // Nose and eyes are almost fixed in the head's frame.
    constexpr Index stable = 27, stable_count = 21;
    Columns<double> mean = Columns<double>::Zero(3, stable_count);
    for (const CaptureFrame& f : c.frames) {
        const Columns<double> in_head = head_landmarks(f);
        mean += in_head.middleCols(stable, stable_count) / c.frame_count();
        const std::string where = file_of(c, f, "params.npz") + ": pose: ";
        const double angle = norm(Vec3<double>(f.pose.head<3>()));
        if (angle > 2 * 3.1416)
            found.error("degrees", where + "a rotation by " + text(angle) +
                                       " rad, expected less than a turn: are these degrees?");
        const char* frame_words = " in the head's frame (x left, y up, z out of the face)";
        const Vec3<double> right = mean_of(in_head, 36, 6), left = mean_of(in_head, 42, 6);
        if (!(left.x() > right.x()))
            found.error(
                "left",
                where + "the subject's left eye (landmarks 42 to 47, x = " + text(left.x()) +
                    ") is right of the right eye (x = " + text(right.x()) + ")" + frame_words);
        if (!(mean_of(in_head, 17, 10).y() > in_head(1, 8)))
            found.error("up", where + "the brows (y = " + text(mean_of(in_head, 17, 10).y()) +
                                  ") are below the chin (y = " + text(in_head(1, 8)) + ")" +
                                  frame_words);
        if (!(in_head(2, 30) > mean_of(in_head, 0, 17).z()))
            found.error("out", where + "the nose (z = " + text(in_head(2, 30)) +
                                   ") is behind the jaw (z = " + text(mean_of(in_head, 0, 17).z()) +
                                   ")" + frame_words);
    }
    for (const CaptureFrame& f : c.frames) {
        const double size = span / f.scale;
        const Columns<double> moved = head_landmarks(f).middleCols(stable, stable_count) - mean;
        const double share = std::sqrt(moved.squaredNorm() / stable_count) / size;
        const std::string message =
            file_of(c, f, "params.npz") + ": pose: nose and eyes are " + text(100 * share) +
            " % of the face away from where the other frames have them in the head's frame: pose "
            "and lmk_3d do not belong together";
        if (share > 0.15)
            found.error("rigid", message);
        else if (share > 0.05)
            found.warning("loose", message);
    }
}

void check_expressions(const Capture& c, Findings& found) {
    float lowest = 0, highest = 0;
    bool varies = false;
    for (const CaptureFrame& f : c.frames) {
        varies = varies || f.expression != c.frames.front().expression;
        for (const float w : f.expression) {
            lowest = std::min(lowest, w);
            highest = std::max(highest, w);
        }
    }
    const std::string where = file_of(c, c.frames.front(), "params.npz") + ": exp_coeff: ";
    if (c.expression_width() == 0)
        found.warning("expression", where + "has no numbers");
    else if (!varies && c.frame_count() > 1)
        found.warning("expression",
                      where + "the same in all frames: expressions will not be learned");
    if (!(lowest >= -max_expression && highest <= max_expression))
        found.error("weights", where + "values from " + text(lowest) + " to " + text(highest) +
                                   ", expected a few units at most, and none beyond " +
                                   text(max_expression));
    else if (lowest < -20 || highest > 20)
        found.warning("weights", where + "values from " + text(lowest) + " to " + text(highest) +
                                     ", expected a few units at most");
}

/// Checks that the shapes do not move landmarks away from where they are, as in other units or with
/// other coefficients.
void check_expression_shapes(const Capture& c, double span, Findings& found) {
    const std::string where = (c.folder / "expression_shapes.npz").string() + ": ";
    Columns<double> shapes;
    try {
        shapes = expression_shapes(c);
    } catch (const Error& e) {
        found.error("shapes", e.what());
        return;
    }
    if (shapes.size() == 0) return;
    const double longest = shapes.cwiseAbs().maxCoeff() * c.frames.front().scale;
    if (!(longest < 10 * span)) {
        found.error("shapes", where + "a displacement of " + text(longest) +
                                  " units, expected less than 10 times the landmarks' span of " +
                                  text(span));
        return;
    }
    const Index sparse = c.frames.front().landmarks.cols();
    Columns<double> moved(3 * sparse, c.frame_count()), left = moved;
    for (Index f = 0; f < moved.cols(); ++f) {
        const CaptureFrame& frame = c.frames[static_cast<std::size_t>(f)];
        const Columns<double> now = head_landmarks(frame);
        moved.col(f) = Eigen::Map<const VecX<double>>(now.data(), now.size());
        left.col(f) = moved.col(f);
        for (Index e = 0; e < shapes.rows(); ++e)
            left.col(f) -= static_cast<double>(frame.expression[static_cast<std::size_t>(e)]) *
                           shapes.row(e).head(3 * sparse).transpose();
    }
    const auto spread = [&](const Columns<double>& a) {
        return std::sqrt((a.colwise() - a.rowwise().mean()).squaredNorm() /
                         static_cast<double>(sparse * a.cols()));
    };
    if (spread(left) > spread(moved))
        found.warning("shapes", where + "landmarks are " + text(spread(left)) +
                                    " units from their mean after these displacements are taken " +
                                    "away, " + text(spread(moved)) +
                                    " before; expected less: are units and exp_coeff the model's?");
}

// ---- gaze --------------------------------------------------------------------------------------

void check_axis(const std::string& where, const std::string& name, const Vec3<double>& v,
                Findings& found) {
    if (std::abs(norm(v) - 1) > 1e-3)
        found.error("unit", where + ": " + name + ": its length is " + text(norm(v)) +
                                ", expected a unit vector");
    else if (v.z() <= 0)
        found.error("backward", where + ": " + name + ": z is " + text(v.z()) +
                                    ", so the eye looks into the head; expected the head's frame "
                                    "with z out of the face");
    else if (beyond_gaze_range(v))
        found.warning("range", where + ": " + name + ": " +
                                   text(degrees * angular_error(v, Vec3<double>(0, 0, 1))) +
                                   " degrees from straight ahead, beyond the range of an eye");
}

/// Checks the data of one eye in one gaze.npz, `where`.
void check_eye(const CaptureFrame& f, std::size_t e, double span, const std::string& where,
               Findings& found) {
    const CaptureEye& eye = f.eyes[e];
    const std::string side = e == 0 ? "left" : "right";
    check_axis(where, "gaze_" + side, eye.optical, found);
    if (eye.visual) check_axis(where, "visual_" + side, *eye.visual, found);
    if (eye.optical_world) {
        const Vec3<double> expected = head_rotation(f) * eye.optical;
        const double off = degrees * angular_error(*eye.optical_world, expected);
        if (off > 0.5)
            found.error("world", where + ": gaze_" + side + "_world is " + text(off) +
                                     " degrees from R(pose) gaze_" + side + ", expected equal");
    }
    if (eye.kappa) {
        const Vec2<double> kappa = *eye.kappa;
        if (kappa.cwiseAbs().maxCoeff() > 15)
            found.warning("kappa", where + ": kappa_" + side + ": got (" + text(kappa[0]) + ", " +
                                       text(kappa[1]) + ") degrees, expected a few");
        if (eye.visual) {
            const Vec2<double> optical = degrees * pitch_yaw(eye.optical);
            const Vec2<double> visual = degrees * pitch_yaw(*eye.visual);
            const double off = std::max(std::abs(optical[1] - visual[1] - kappa[0]),
                                        std::abs(optical[0] - visual[0] - kappa[1]));
            if (off > 0.5)
                found.warning("kappa_sum", where + ": kappa_" + side + ": the optical axis is " +
                                               text(off) +
                                               " degrees from visual + kappa (yaw, "
                                               "pitch), expected equal");
        }
    }
    if (eye.centre) {
        const Vec3<double> centre = to_head(f, *eye.centre);
        const Vec3<double> lids =
            mean_of(head_landmarks(f), eye_landmarks(static_cast<int>(e)).front(), 6);
        const double away = f.scale * norm(Vec3<double>(centre - lids)) / span;
        if (away > 0.2)
            found.error("centre", where + ": eye_center_" + side + " is " + text(100 * away) +
                                      " % of the face away from the lids of that eye, expected "
                                      "below 20 (world units, " +
                                      side + " is the subject's)");
    }
    if (eye.radius) {
        const double share = *eye.radius / span;
        if (share < 0.02 || share > 0.2)
            found.error("radius", where + ": eye_radius: got " + text(*eye.radius) +
                                      " for landmarks that span " + text(span) +
                                      ", expected 0.02 to 0.2 of that");
        if (eye.limbus_radius && *eye.limbus_radius >= *eye.radius)
            found.error("limbus", where + ": limbus_radius: got " + text(*eye.limbus_radius) +
                                      ", expected below eye_radius " + text(*eye.radius));
        if (eye.iris_plane && *eye.iris_plane > 1.5 * *eye.radius)
            found.error("iris", where + ": iris_plane: got " + text(*eye.iris_plane) +
                                    ", expected about eye_radius " + text(*eye.radius));
    }
    // Checks the eyeball that training would make of it.
    try {
        require_eyeball(eye_sizes(eye, f.scale, EyeballConfig{}.radius), where + ": " + side);
    } catch (const Error& fault) {
        found.error("eyeball", fault.what());
    }
}

void check_gaze(const Capture& c, double span, Findings& found) {
    for (const CaptureFrame& f : c.frames) {
        if (f.has_gaze)
            for (std::size_t e = 0; e < 2; ++e)
                check_eye(f, e, span, file_of(c, f, "gaze.npz"), found);
        else
            found.warning("gaze", file_of(c, f, "gaze.npz") +
                                      ": no such file: without the gaze of every frame the eyes "
                                      "can neither be trained nor redirected");
        if (f.has_gaze && !f.has_centres)
            found.warning("centres", file_of(c, f, "gaze.npz") +
                                         ": no eye_center_left and eye_center_right: the eyes are "
                                         "placed by the landmarks of the lids");
    }
    if (!c.has_eye_masks)
        found.warning("eye_masks", (c.folder / "images").string() +
                                       ": not every view has an eye_mask_<camera>.png: the loss "
                                       "on the eyes alone, and scores inside the eyes, are "
                                       "impossible");
    if (c.test.empty())
        found.warning("test", c.folder.string() + ": no test frames: nothing to evaluate on");
}

// ---- pixels ------------------------------------------------------------------------------------

/// Returns true if the eye labels fit the other eye's landmarks better.
bool eyes_swapped(const Capture& c, ViewIndex v, const Image<float>& labels) {
    std::array<Vec2<double>, 2> lids, seen{Vec2<double>::Zero(), Vec2<double>::Zero()};
    std::array<double, 2> count{0, 0};
    for (int e = 0; e < 2; ++e) {
        const Vec3<double> middle = mean_of(c.frames[static_cast<std::size_t>(v.frame)].landmarks,
                                            eye_landmarks(e).front(), 6);
        lids[static_cast<std::size_t>(e)] =
            c.camera(v.frame, v.camera).project_point(middle).head<2>();
    }
    for (int y = 0; y < labels.height; ++y)
        for (int x = 0; x < labels.width; ++x)
            for (std::size_t e = 0; e < 2; ++e)
                if (labels.at(x, y)[static_cast<Index>(e)] > 0) {
                    seen[e] += Vec2<double>(x + 0.5, y + 0.5);
                    ++count[e];
                }
    if (count[0] < 5 || count[1] < 5) return false;
    const Vec2<double> left = seen[0] / count[0], right = seen[1] / count[1];
    return (left - lids[0]).norm() + (right - lids[1]).norm() >
           (left - lids[1]).norm() + (right - lids[0]).norm();
}

void check_pixels(const Capture& c, ImagesToDecode which, Findings& found) {
    const std::size_t limit = which == ImagesToDecode::all ? static_cast<std::size_t>(-1)
                                                           : std::size_t(max_sampled_views);
    for (const ViewIndex v : sampled_views(c, limit)) {
        const CaptureView& view = c.view(v.frame, v.camera);
        try {
            const Image<float> image = c.image(v.frame, v.camera), mask = c.mask(v.frame, v.camera);
            const Image<float> visible = c.visible(v.frame, v.camera);
            if (mask.pixels.maxCoeff() < 0.5f)
                found.error("mask", view.mask.string() +
                                        ": the mask is empty (its largest value is " +
                                        text(255 * mask.pixels.maxCoeff()) + " of 255)");
            if (mask.pixels.minCoeff() > 0.5f)
                found.warning("full", view.mask.string() +
                                          ": the mask covers the whole image, "
                                          "expected the head only");
            double outside = 0, light = 0;
            for (Index i = 0; i < mask.size(); ++i)
                if (mask.pixels(0, i) == 0) {
                    light += image.pixels.col(i).mean();
                    ++outside;
                }
            if (outside > 0 && light / outside > 0.1)
                found.warning("background",
                              view.image.string() + ": outside the mask its mean is " +
                                  text(light / outside) + " of 1, though it should be over black");
            if (!view.eye_mask.empty() && eyes_swapped(c, v, c.eye_mask(v.frame, v.camera)))
                found.error("swapped", view.eye_mask.string() +
                                           ": the labels 85 (subject's left eye) and 170 (right) "
                                           "are on the other eye's lids");
        } catch (const Error& e) {
            found.error("decode", e.what());
        }
    }
}

} // namespace

double landmark_span(const Capture& c) {
    std::vector<double> spans;
    for (const CaptureFrame& f : c.frames) {
        const Vec3<double> low = f.landmarks.rowwise().minCoeff();
        const Vec3<double> high = f.landmarks.rowwise().maxCoeff();
        spans.push_back(norm(Vec3<double>(high - low)));
    }
    return median(spans);
}

LandmarkFit fit_landmarks(const Capture& c) {
    return fit(masked_views(c), [](Pinhole<double>&) {});
}

std::vector<Problem> validate(const Capture& c, ImagesToDecode images) {
    if (c.frames.empty()) return {}; // already reported by the reader
    Findings found;
    const double span = landmark_span(c);
    check_units(c, span, found);
    // Before single cameras, as it can explain the faults of all of them.
    if (images != ImagesToDecode::none) check_projection(c, found);
    check_cameras(c, span, found);
    check_extent(c, span, found);
    check_head_frame(c, span, found);
    check_expressions(c, found);
    check_expression_shapes(c, span, found);
    check_gaze(c, span, found);
    if (images != ImagesToDecode::none) check_pixels(c, images, found);
    return found.list();
}

std::vector<std::string> training_faults(const Capture& c) {
    std::vector<std::string> faults;
    const std::string where = c.folder.string() + ": ";
    if (c.train.empty()) faults.push_back(where + "no training frames");
    for (const CaptureFrame& f : c.frames)
        if (!f.has_gaze) {
            faults.push_back(file_of(c, f, "gaze.npz") +
                             ": no such file, expected the gaze of every frame: `rye import gha " +
                             c.folder.string() +
                             " --out CAPTURE` takes it from a file (--gaze) or estimates it from "
                             "the iris");
            break;
        }
    if (!c.has_eye_masks)
        faults.push_back(where +
                         "some images have no eye_mask_<camera>.png, expected one for every view: "
                         "`rye import gha " +
                         c.folder.string() +
                         " --out CAPTURE` makes them from the landmarks of the "
                         "lids");
    for (const int f : c.train) {
        bool seen = false;
        for (int k = 0; k < c.camera_count(); ++k) seen = seen || c.view(f, k).present;
        if (seen) continue;
        faults.push_back(where + "frame " + c.frames[static_cast<std::size_t>(f)].id +
                         ": no camera has an image of it, expected one at least of each training "
                         "frame");
        break;
    }
    return faults;
}

namespace {

/// Throws an Error with the first error of a list and the number of errors.
void require_none(const std::vector<Problem>& problems, const fs::path& folder) {
    std::string first;
    int count = 0;
    for (const Problem& p : problems)
        if (p.severity == Problem::Severity::error && count++ == 0) first = p.message;
    if (count > 1)
        first += " (and " + std::to_string(count - 1) + " more: `rye info " + folder.string() +
                 "` lists them)";
    if (count > 0) throw Error(first);
}

} // namespace

Capture read_valid_capture(const fs::path& folder, const CaptureOptions& options,
                           std::vector<Problem>* warnings) {
    std::vector<Problem> problems;
    Capture capture = read_capture(folder, options, &problems);
    const std::vector<Problem> more = validate(capture);
    problems.insert(problems.end(), more.begin(), more.end());
    if (warnings)
        for (const Problem& p : problems)
            if (p.severity == Problem::Severity::warning) warnings->push_back(p);
    warn_of_changes(folder);
    require_none(problems, folder);
    return capture;
}

std::string Verdict::text() const {
    if (errors > 0) return std::to_string(errors) + " errors: not usable";
    return lacks.empty() ? "usable" : "usable to draw and measure, not to train: " + lacks.front();
}

Verdict judge(const Capture& c, const std::vector<Problem>& problems) {
    Verdict v;
    for (const Problem& p : problems) v.errors += p.severity == Problem::Severity::error ? 1 : 0;
    if (v.errors > 0) return v;
    v.lacks = training_faults(c);
    if (c.camera_count() < few_cameras)
        v.expect.push_back(c.folder.string() + ": " + count_text(c.camera_count(), "camera") +
                           ": sides of the head that no image shows stay empty or blurred, and "
                           "depth comes from the head's own turns alone; expect a likeness from "
                           "the directions in which it was filmed, not around it");
    const int frames = static_cast<int>(c.train.size());
    if (frames > 0 && frames < few_frames)
        v.expect.push_back(c.folder.string() + ": " + count_text(frames, "training frame") +
                           ": expressions, poses and gazes unlike these are guesses; expect lids "
                           "and irises to blur away from the gazes of these frames");
    return v;
}

Capture read_trainable_capture(const fs::path& folder, std::vector<std::string>* expect) {
    std::vector<Problem> problems;
    Capture capture = read_capture(folder, {}, &problems);
    const std::vector<Problem> more = validate(capture);
    problems.insert(problems.end(), more.begin(), more.end());
    warn_of_changes(folder);
    require_none(problems, folder);
    const Verdict verdict = judge(capture, problems);
    if (!verdict.lacks.empty()) throw Error(verdict.lacks.front());
    if (expect) expect->insert(expect->end(), verdict.expect.begin(), verdict.expect.end());
    return capture;
}

Capture read_valid_frame(const CaptureContents& contents, const std::string& frame,
                         const std::vector<std::string>& cameras) {
    std::vector<Problem> problems;
    Capture capture = read_capture_frame(contents, frame, cameras, &problems);
    if (capture.width > 0) {  // no camera has the frame: nothing to check
        const std::vector<Problem> more = validate(capture, ImagesToDecode::none);
        problems.insert(problems.end(), more.begin(), more.end());
    }
    require_none(problems, contents.folder);
    return capture;
}

} // namespace rye::trainer
