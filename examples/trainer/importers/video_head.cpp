// SPDX-License-Identifier: Apache-2.0
#include "importers/video_head.hpp"

#include <algorithm>
#include <cmath>

#include <rye/core/error.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "data/median.hpp"
#include "importers/face_mesh.hpp"
#include "importers/import_folder.hpp"

namespace rye::trainer {
namespace {

/// Field of view by which the tracker's matrices place a head, from above to below [deg].
constexpr double tracker_view_deg = 63;
/// Likely focal length over the longer side: cameras of phones and webcams, as they film.
constexpr double likely_focal = 1.0;
/// Deviations of the focal length's logarithm: of what is likely, and of it beside the landmarks,
/// which hardly count: by four rendered heads they say 8 to 15 % too much.
constexpr double focal_deviation = 0.1, focal_sigma = 0.01;
/// Error of the tracker's turn of a head: landmarks alone give worse ones.
constexpr double turn_sigma_deg = 1;
/// Turns of an eye by a coefficient of 1, aside (eyeLookInLeft) and up (eyeLookUpLeft) [deg], and
/// the share of the camera's direction, seen from the head, by which the tracker takes eyes to look
/// at it. Of five rendered heads that turn by 40 degrees.
constexpr double look_aside_deg = 27, look_up_deg = 30, drawn_to_camera = 0.2;
/// Distance at which eyes that look around converge [dm].
constexpr double usual_distance = 8;
/// Typical angles between optical and visual axis of a left eye, (yaw, pitch) [deg].
const Vec2<double> usual_kappa_deg(5, -1.5);
/// Centre of an eyeball from the middle of its lids, in radii: the upper lid covers more of an eye
/// than the lower one.
const Vec3<double> behind_lids(0, 0.13, -0.88);

/// Axes of a camera (x right, y down, z forward) by those of the world.
Mat3<double> camera_axes() { return Vec3<double>(1, -1, -1).asDiagonal(); }

Vec3<double> median_of(const std::vector<Vec3<double>>& all) {
    Vec3<double> middle;
    for (Index d = 0; d < 3; ++d) {
        std::vector<double> list;
        for (const Vec3<double>& x : all) list.push_back(x[d]);
        middle[d] = median(list);
    }
    return middle;
}

/// Says in which direction the tracker's coefficients look, (yaw, pitch), and that of an
/// expression.
class Drivers {
  public:
    explicit Drivers(const std::vector<std::string>& names) : names_(names) {
        for (std::size_t i = 0; i < names.size(); ++i)
            if (!is_no_expression(names[i])) expressions_.push_back(static_cast<int>(i));
    }
    const std::vector<int>& expressions() const { return expressions_; }
    VecX<double> of(const TrackedPicture& p) const {
        const Index n = static_cast<Index>(expressions_.size());
        VecX<double> all(n + 2); // lids follow the gaze
        for (Index i = 0; i < n; ++i)
            all[i] = p.coefficients[expressions_[static_cast<std::size_t>(i)]];
        all.tail<2>() = tracked_look(names_, p);
        return all;
    }

  private:
    const std::vector<std::string>& names_;
    std::vector<int> expressions_;
};

/// The tracker's guess of a head before a camera of this focal length.
Rigid<double> guessed_head(const TrackedPicture& p, double focal, int height) {
    const double own_focal = 0.5 * height / std::tan(0.5 * tracker_view_deg * degree);
    Rigid<double> head{camera_axes() * p.head.rotation, camera_axes() * p.head.translation};
    head.translation.z() *= focal / own_focal;
    return head;
}

/// Places a landmark in the head by the tracker's depth of it, which is that behind a plane of its
/// own: at + offset * by.
struct Lifted {
    Vec3<double> at, by;
};
Lifted lifted(const Vec3<double>& seen, const Rigid<double>& head, const BundleSettings& s) {
    const Vec3<double> ray((seen.x() - s.cx) / s.focal, (seen.y() - s.cy) / s.focal, 1);
    const double depth = head.translation.z() * (1 + seen.z() / s.focal);
    return {head.turn_back(Vec3<double>(depth * ray - head.translation)),
            head.turn_back(Vec3<double>(head.rotation(2, 2) * ray))};
}

/// Returns the landmarks of a head at rest that the tracker's depths say: the median of the
/// pictures that show the face from the front, or of all if few do. The plane of the depths is the
/// one, across the head's z axis, by which landmarks stay where they are in the head when it turns.
Columns<double> guessed_rest(const std::vector<const TrackedPicture*>& pictures,
                             const std::vector<FaceView>& views, const BundleSettings& s) {
    const auto count = static_cast<double>(views.size());
    const auto each = [&](Index i) {
        std::vector<Lifted> all;
        for (std::size_t f = 0; f < views.size(); ++f)
            all.push_back(lifted(pictures[f]->landmarks.col(i), views[f].head, s));
        return all;
    };
    double along = 0, square = 1e-9;
    for (Index i = 0; i < skin_landmarks; ++i) {
        const std::vector<Lifted> all = each(i);
        Vec3<double> at = Vec3<double>::Zero(), by = at;
        for (const Lifted& l : all) {
            at += l.at / count;
            by += l.by / count;
        }
        for (const Lifted& l : all) {
            along += (l.at - at).dot(l.by - by);
            square += (l.by - by).squaredNorm();
        }
    }
    const double offset = -along / square;
    constexpr double frontal = 0.9; // cosine
    const auto faces_camera = [&](const FaceView& v) { return -v.head.rotation(2, 2) > frontal; };
    const bool enough = std::count_if(views.begin(), views.end(), faces_camera) >= 3;
    Columns<double> rest(3, skin_landmarks);
    for (Index i = 0; i < skin_landmarks; ++i) {
        const std::vector<Lifted> all = each(i);
        std::vector<Vec3<double>> chosen;
        for (std::size_t f = 0; f < views.size(); ++f)
            if (!enough || faces_camera(views[f])) chosen.push_back(all[f].at + offset * all[f].by);
        rest.col(i) = median_of(chosen);
    }
    return rest;
}

Vec3<double> middle_of_lids(const Columns<double>& landmarks, std::size_t eye) {
    Vec3<double> sum = Vec3<double>::Zero();
    for (const int i : face_lids[eye]) sum += landmarks.col(i) / 16;
    return sum;
}

/// Diameter of an iris in the picture [px]: the longer axis of the ellipse through its rim, of
/// which two diameters that were at right angles are seen.
double iris_pixels(const TrackedPicture& p, std::size_t eye) {
    const Index rim = face_iris[eye] + 1;
    const Vec2<double> a = (p.landmarks.col(rim) - p.landmarks.col(rim + 2)).head<2>(),
                       b = (p.landmarks.col(rim + 1) - p.landmarks.col(rim + 3)).head<2>();
    const double sum = a.squaredNorm() + b.squaredNorm(), area = a.x() * b.y() - a.y() * b.x();
    return std::sqrt(0.5 * (sum + std::sqrt(std::max(0.0, sum * sum - 4 * area * area))));
}

/// Returns the optical axes of a look. Irises are a worse measure: they follow the lids more than
/// the eye. video_gaze.hpp corrects it.
std::array<Vec3<double>, 2> gazes_of(const Vec2<double>& look, const Vec3<double>& to_camera,
                                     const std::array<VideoEye, 2>& eyes) {
    const Vec2<double> seen = pitch_yaw(direction_of(look));
    const double aside = seen[1] - drawn_to_camera * pitch_yaw(normalized(to_camera))[1];
    const Vec3<double> between = 0.5 * (eyes[0].centre + eyes[1].centre);
    const Vec3<double> at = between + usual_distance * gaze_vector(seen[0], aside);
    std::array<Vec3<double>, 2> axes;
    for (std::size_t e = 0; e < 2; ++e)
        axes[e] = usual_optical_axis(normalized(Vec3<double>(at - eyes[e].centre)), e);
    return axes;
}

} // namespace

Vec2<double> tracked_look(const std::vector<std::string>& names, const TrackedPicture& picture) {
    const auto value = [&](const std::string& name) {
        const auto at = std::find(names.begin(), names.end(), "eyeLook" + name);
        return at == names.end() ? 0 : picture.coefficients[at - names.begin()];
    };
    return 0.5 * Vec2<double>(value("OutLeft") - value("InLeft") + value("InRight") - value("OutRight"),
                              value("UpLeft") - value("DownLeft") + value("UpRight") - value("DownRight"));
}

Vec3<double> direction_of(const Vec2<double>& look) {
    return gaze_vector(degree * look_up_deg * look.y(), degree * look_aside_deg * look.x());
}

Vec3<double> usual_optical_axis(const Vec3<double>& visual, std::size_t eye) {
    const Vec2<double> angles = pitch_yaw(visual);
    const double kappa = eye == 0 ? usual_kappa_deg.x() : -usual_kappa_deg.x();
    return gaze_vector(angles[0] + degree * usual_kappa_deg.y(), angles[1] + degree * kappa);
}

VideoHead video_head(const Tracks& tracks, const std::vector<int>& pictures,
                     const HeadOptions& options) {
    const Drivers drivers(tracks.names);
    BundleSettings s;
    s.cx = 0.5 * tracks.width;
    s.cy = 0.5 * tracks.height;
    s.focal = options.focal > 0 ? options.focal
                                : likely_focal * std::max(tracks.width, tracks.height);
    s.focal_sigma = options.focal > 0 ? 1e-3 : focal_sigma;
    s.turn_sigma = turn_sigma_deg * degree;
    std::vector<const TrackedPicture*> shown;
    std::vector<FaceView> views;
    std::vector<double> apart;
    for (const int i : pictures) {
        const TrackedPicture& p = tracks.pictures[static_cast<std::size_t>(i)];
        shown.push_back(&p);
        views.push_back({p.landmarks.leftCols<skin_landmarks>(),
                         guessed_head(p, s.focal, tracks.height), drivers.of(p)});
        apart.push_back((p.landmarks.col(face_iris[0]) - p.landmarks.col(face_iris[1])).norm());
    }
    s.first_sigma = 0.01 * median(apart);
    const FaceBundle b = bundle_face(views, guessed_rest(shown, views, s), s);

    VideoHead head;
    head.focal_deviation = options.focal > 0 ? b.focal_deviation : focal_deviation;
    head.drivers = drivers.expressions();
    std::vector<double> errors;
    for (Index i = 0; i < skin_landmarks; ++i) errors.push_back(b.sigma(0, i));
    head.landmark_error = median(errors);
    // The iris gives the scale; the eyes give the origin.
    std::array<Vec3<double>, 2> lids{middle_of_lids(b.rest, 0), middle_of_lids(b.rest, 1)};
    std::vector<double> irises;
    for (std::size_t f = 0; f < views.size(); ++f)
        for (std::size_t e = 0; e < 2; ++e)
            irises.push_back(iris_pixels(*shown[f], e) * b.heads[f].apply(lids[e]).z() / b.focal);
    constexpr double dm_per_mm = 0.01;
    const double scale = options.iris_mm * dm_per_mm / median(irises);
    for (std::size_t e = 0; e < 2; ++e) {
        VideoEye& eye = head.eyes[e];
        eye.centre = scale * lids[e] + eye.radius * behind_lids;
    }
    const Vec3<double> shift = eyes_in_head - 0.5 * (head.eyes[0].centre + head.eyes[1].centre);
    for (VideoEye& eye : head.eyes) eye.centre += shift;
    head.shapes = scale * b.shapes.leftCols(static_cast<Index>(head.drivers.size()));

    std::vector<Rigid<double>> to_camera;
    std::vector<Vec3<double>> places;
    for (const Rigid<double>& h : b.heads) {
        to_camera.push_back({h.rotation, scale * h.translation - h.rotation * shift});
        places.push_back(to_camera.back().translation);
    }
    Pinhole<double>& camera = head.camera;
    camera.width = tracks.width;
    camera.height = tracks.height;
    camera.fx = camera.fy = b.focal;
    camera.cx = s.cx;
    camera.cy = s.cy;
    camera.camera_from_world = {camera_axes(), median_of(places)};
    const Rigid<double> world_from_camera = camera.camera_from_world.inverse();
    for (std::size_t f = 0; f < views.size(); ++f) {
        VideoPose pose;
        pose.picture = pictures[f];
        pose.residual = b.residual[f];
        pose.world_from_head = {world_from_camera.rotation * to_camera[f].rotation,
                                world_from_camera.apply(to_camera[f].translation)};
        const Columns<double> in_head = scale * b.landmarks(views[f].drivers);
        pose.landmarks.resize(3, skin_landmarks);
        for (Index i = 0; i < skin_landmarks; ++i)
            pose.landmarks.col(i) =
                pose.world_from_head.apply(Vec3<double>(in_head.col(i) + shift));
        pose.gaze = gazes_of(views[f].drivers.tail<2>(),
                             pose.world_from_head.inverse().apply(camera.centre()), head.eyes);
        head.poses.push_back(std::move(pose));
    }
    return head;
}

} // namespace rye::trainer
