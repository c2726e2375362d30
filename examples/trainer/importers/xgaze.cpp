// SPDX-License-Identifier: Apache-2.0
/// Imports HDF5 files of ETH-XGaze's normalisation and of GazeNeRF. Landmarks are triangulated from
/// those in the patches; both eyes get the gaze of the face.
///
/// Normalisation: a patch is the view of a camera at the real camera's position that looks at the
/// middle of the face, with focal length F d / D for a face at distance d: rotation face_mat_norm
/// times that of the calibration. d follows from the point where the axes of a frame's patches
/// meet.
/// GazeNeRF: w2c and inmat of each patch; the world is the head of its 3DMM.
/// Pixels of both are OpenCV's, whose first pixel has its centre at 0: half a pixel is added.
/// Source of the layouts: ETH-XGaze (Zhang et al., 2020), normalization_example; GazeNeRF (Ruzzi et
/// al., 2023), dataset_pre_processing.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>

#include <Eigen/LU>

#include <rye/io/npy.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "importers/face_geometry.hpp"
#include "importers/hdf5_file.hpp"
#include "importers/import_folder.hpp"
#include "importers/opencv_xml.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = ImportFolder::Json;

constexpr int camera_count = 18;
constexpr Index landmark_count = 68;
/// Middle of the lids in the head frame.
const Vec3<double> lids_in_head(0, 0.35, 0.95);
/// Cameras of ETH-XGaze that hang upside down; their pictures are rotated before normalisation.
constexpr std::array upside_down{3, 6, 13};

/// Patch of the file.
struct Patch {
    Index row = 0;
    int camera = 0;
    Pinhole<double> pinhole;                ///< of the patch, in the world
    Columns<double> landmarks;              ///< 2 x 68 [px]
    std::optional<Vec3<double>> gaze_world; ///< from face_gaze
};

struct XgazeFrame {
    std::string id;
    std::vector<Patch> patches;
    std::vector<double> expression;
    std::optional<Vec3<double>> gaze_head; ///< from pitchyaw_head
};

struct XgazeSource {
    const Hdf5File* file = nullptr;
    int side = 0; ///< of the patches [px]
    bool gazenerf = false, masks = false;
    std::vector<XgazeFrame> frames;
    std::set<int> cameras;
    Index empty_rows = 0;
    std::string calibration; ///< description of the calibration's reading
    double factor = 1;       ///< lengths of the file to rye's
};

/// Array with one entry per patch; `per_patch` numbers each, or any number if 0.
class Rows {
  public:
    Rows(const Hdf5File& file, const std::string& name, Index rows, Index per_patch)
        : who_(file.name() + ": " + name) {
        const std::vector<Index> shape = file.shape(name);
        require(
            !shape.empty() && shape[0] == rows, who_, "got shape ",
            [&] { return shape_text(shape); }, ", expected ", rows, " rows as face_patch has");
        width_ = 1;
        for (std::size_t d = 1; d < shape.size(); ++d) width_ *= shape[d];
        require(
            per_patch == 0 || width_ == per_patch, who_, "got shape ",
            [&] { return shape_text(shape); }, ", expected ", per_patch, " numbers a row");
        values_ = file.numbers(name);
    }
    Index width() const { return width_; }
    const double* row(Index i) const { return values_.data() + i * width_; }
    /// Returns the row, after a check that its numbers are finite.
    const double* finite(Index i) const {
        for (Index k = 0; k < width_; ++k)
            require(
                std::isfinite(row(i)[k]), who_, "row ", i, ": number ", k, " is ",
                [&] { return std::to_string(row(i)[k]); }, ", expected a finite number");
        return row(i);
    }
    Mat3<double> rotation(Index i) const {
        const Mat3<double> r =
            Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(finite(i));
        const double off = (r * r.transpose() - Mat3<double>::Identity()).cwiseAbs().maxCoeff();
        require(off < 1e-3 && r.determinant() > 0, who_, "row ", i,
                " is no rotation: R R^T differs from the identity by ",
                [&] { return std::to_string(off); });
        return r;
    }
    const std::string& who() const { return who_; }

  private:
    std::string who_;
    Index width_ = 1;
    std::vector<double> values_;
};

Index whole(const Rows& rows, Index i, double most) {
    const double x = rows.row(i)[0];
    require(
        x >= 0 && x <= most && std::floor(x) == x, rows.who(), "row ", i, ": got ",
        [&] { return std::to_string(x); }, ", expected a whole number from 0 to ",
        [&] { return factor_text(most); });
    return static_cast<Index>(x);
}

/// Returns the distinct frames: rows of one frame follow one another, each with another camera.
/// frame_index may wrap at 256, so only its changes count.
std::vector<XgazeFrame> frames_of(const Hdf5File& file, Index rows, const Rows& rotations,
                                  Index& empty_rows) {
    const Rows cameras(file, "cam_index", rows, 1), numbers(file, "frame_index", rows, 1);
    std::vector<XgazeFrame> frames;
    std::set<int> seen;
    Index last = -1;
    for (Index i = 0; i < rows; ++i) {
        bool empty = true; // the file has room for more patches than were written
        for (Index k = 0; k < rotations.width(); ++k) empty = empty && rotations.row(i)[k] == 0;
        if (empty) {
            ++empty_rows;
            continue;
        }
        const int camera = static_cast<int>(whole(cameras, i, camera_count - 1));
        const Index number = whole(numbers, i, 1e9);
        if (frames.empty() || number != last || seen.contains(camera)) {
            std::string id = std::to_string(frames.size());
            frames.emplace_back();
            frames.back().id = std::string(id.size() < 4 ? 4 - id.size() : 0, '0') + id;
            seen.clear();
            last = number;
        }
        seen.insert(camera);
        Patch patch;
        patch.row = i;
        patch.camera = camera;
        frames.back().patches.push_back(patch);
    }
    require(!frames.empty(), file.name(), "all of its rows are empty");
    return frames;
}

// ---- cameras -----------------------------------------------------------------------------------

/// Interpretation of the calibration: the direction of its rotation, and whether the pictures of
/// the cameras that hang upside down were rotated after it.
struct Reading {
    bool to_camera, turned;
    std::string text() const {
        return std::string(to_camera ? "world to camera" : "camera to world") +
               (turned ? ", cameras 3, 6 and 13 turned by half a turn" : "");
    }
};

Rigid<double> camera_pose(const Rigid<double>& stored, int camera, const Reading& reading) {
    Rigid<double> pose = reading.to_camera ? stored : stored.inverse();
    const bool hangs =
        std::find(upside_down.begin(), upside_down.end(), camera) != upside_down.end();
    if (reading.turned && hangs) {
        const Vec3<double> half(-1, -1, 1);
        pose.rotation = half.asDiagonal() * pose.rotation;
        pose.translation = half.cwiseProduct(pose.translation);
    }
    return pose;
}

/// Returns the point where the axes of a frame's patches meet.
NearestPoint face_middle(const XgazeFrame& frame, const Rows& rotations,
                         const std::map<int, Rigid<double>>& stored, const Reading& reading) {
    const auto n = static_cast<Index>(frame.patches.size());
    Columns<double> from(3, n), along(3, n);
    for (Index i = 0; i < n; ++i) {
        const Patch& p = frame.patches[static_cast<std::size_t>(i)];
        const Rigid<double> pose = camera_pose(stored.at(p.camera), p.camera, reading);
        from.col(i) = pose.inverse().translation;
        along.col(i) = (rotations.rotation(p.row) * pose.rotation).row(2).transpose();
    }
    return nearest_to_lines(from, along);
}

void place_normalized(XgazeSource& s, const Rows& rotations, const ImportOptions& o) {
    require(!o.calibration.empty(), s.file->name() + ": face_mat_norm",
            "needs the cameras' calibration: give its folder by --calibration (cam00.xml to "
            "cam17.xml)");
    const std::vector<double> usual{960, 300, 448};
    const std::vector<double>& norm = o.normalization.empty() ? usual : o.normalization;
    require(norm.size() == 3, "--normalization", "got ", norm.size(),
            " numbers, expected 3: focal length [px], "
            "distance [mm], side [px]");
    for (const double x : norm)
        require(
            std::isfinite(x) && x > 0, "--normalization", "got ", [&] { return std::to_string(x); },
            ", expected > 0");
    std::map<int, Rigid<double>> stored;
    for (const XgazeFrame& f : s.frames)
        for (const Patch& p : f.patches)
            if (!stored.contains(p.camera))
                stored[p.camera] =
                    read_opencv_xml(o.calibration / ("cam" + std::string(p.camera < 10 ? "0" : "") +
                                                     std::to_string(p.camera) + ".xml"))
                        .pose();
    // The calibration's files do not state these, so the reading that makes the axes meet is used.
    Reading best{true, false};
    double least = std::numeric_limits<double>::infinity();
    for (const Reading& reading :
         {Reading{true, false}, Reading{true, true}, Reading{false, false}, Reading{false, true}}) {
        double sum = 0;
        for (const XgazeFrame& f : s.frames) {
            if (f.patches.size() < 2) continue;
            const NearestPoint at = face_middle(f, rotations, stored, reading);
            double distance = 0;
            for (const Patch& p : f.patches)
                distance +=
                    (camera_pose(stored.at(p.camera), p.camera, reading).inverse().translation -
                     at.point)
                        .norm() /
                    static_cast<double>(f.patches.size());
            sum += at.error / distance / static_cast<double>(s.frames.size());
        }
        if (sum < least) {
            least = sum;
            best = reading;
        }
    }
    require(
        least < 0.05, o.calibration.string(),
        "the axes of the patches of a frame miss one another by ",
        [&] { return factor_text(100 * least); },
        " % of the distance of the face, expected below 5: calibration and patches do not "
        "belong together");
    s.calibration = best.text() + "; the axes of a frame's patches meet to " +
                    factor_text(100 * least) + " % of the face's distance";
    for (XgazeFrame& f : s.frames) {
        require(f.patches.size() >= 2, s.file->name() + ": frame_index", "frame ", f.id, " has ",
                f.patches.size(),
                " patch, expected two cameras or more: landmarks are triangulated");
        const Vec3<double> face = face_middle(f, rotations, stored, best).point;
        for (Patch& p : f.patches) {
            const Rigid<double> pose = camera_pose(stored.at(p.camera), p.camera, best);
            const Vec3<double> centre = pose.inverse().translation;
            Pinhole<double>& c = p.pinhole;
            c.camera_from_world.rotation = rotations.rotation(p.row) * pose.rotation;
            c.camera_from_world.translation = -(c.camera_from_world.rotation * centre);
            c.fx = c.fy = norm[0] * s.side / norm[2] * (centre - face).norm() / norm[1];
            c.cx = c.cy = 0.5 * s.side + 0.5;
        }
    }
}

void place_gazenerf(XgazeSource& s, const Rows& rotations, Index rows) {
    const Rows translations(*s.file, "w2c_Tvec", rows, 3), intrinsics(*s.file, "inmat", rows, 9);
    for (XgazeFrame& f : s.frames)
        for (Patch& p : f.patches) {
            Pinhole<double>& c = p.pinhole;
            c.camera_from_world.rotation = rotations.rotation(p.row);
            c.camera_from_world.translation =
                Eigen::Map<const Vec3<double>>(translations.finite(p.row));
            const double* k = intrinsics.finite(p.row);
            require(
                k[0] > 0 && k[4] > 0, intrinsics.who(), "row ", p.row, ": got focal lengths ",
                [&] { return std::to_string(k[0]); }, " and ", [&] { return std::to_string(k[4]); },
                ", expected > 0 [px]");
            c.fx = k[0];
            c.fy = k[4];
            c.cx = k[2] + 0.5;
            c.cy = k[5] + 0.5;
        }
}

// ---- labels ------------------------------------------------------------------------------------

/// Returns pitch and yaw of a gaze. A camera beside the head sees it look away from itself: the yaw
/// goes to pi.
Vec2<double> angles(const Rows& rows, Index i) {
    const double* a = rows.finite(i);
    const auto within = [&](int d, double bound, const char* name, const char* range) {
        require(
            std::abs(a[d]) <= bound, rows.who(), "row ", i, ": got the ", name, " ",
            [&] { return std::to_string(a[d]); }, ", expected radians, ", range);
    };
    within(0, 1.6, "pitch", "-pi/2 to pi/2");
    within(1, 3.2, "yaw", "-pi to pi");
    return {a[0], a[1]};
}

void read_gazes(XgazeSource& s, Index rows) {
    if (s.file->has("face_gaze")) {
        const Rows gaze(*s.file, "face_gaze", rows, 2);
        for (XgazeFrame& f : s.frames)
            for (Patch& p : f.patches) {
                // In the frame of the patch's camera, x right, y down, z forward, with the sign
                // inverted so that a gaze into the camera is 0.
                const Vec2<double> a = angles(gaze, p.row);
                p.gaze_world =
                    p.pinhole.camera_from_world.turn_back(Vec3<double>(-gaze_vector(a[0], a[1])));
            }
        return;
    }
    require(s.file->has("pitchyaw_head"), s.file->name(),
            "has neither face_gaze nor pitchyaw_head, expected the gaze of each patch");
    const Rows gaze(*s.file, "pitchyaw_head", rows, 2);
    for (XgazeFrame& f : s.frames) {
        // In the frame of ETH-XGaze's face model, x to the subject's left, y down, z into the head.
        Vec3<double> sum = Vec3<double>::Zero();
        for (const Patch& p : f.patches) {
            const Vec2<double> a = angles(gaze, p.row);
            const Vec3<double> v = gaze_vector(a[0], a[1]);
            sum += Vec3<double>(-v.x(), -v.y(), v.z());
        }
        f.gaze_head = normalized(sum);
    }
}

/// Reads the expression codes of GazeNeRF's 3DMM, which follow 100 codes of the identity.
void read_expressions(XgazeSource& s, Index rows) {
    constexpr Index first = 100, count = 79;
    if (!s.file->has("latent_codes")) return;
    const Rows codes(*s.file, "latent_codes", rows, 306);
    for (XgazeFrame& f : s.frames) {
        const double* code = codes.finite(f.patches.front().row) + first;
        f.expression.assign(code, code + count);
    }
}

XgazeSource read_xgaze(const Hdf5File& file, const ImportOptions& o) {
    XgazeSource s;
    s.file = &file;
    const std::vector<Index> shape = file.shape("face_patch");
    require(
        shape.size() == 4 && shape[0] > 0 && shape[1] == shape[2] && shape[3] == 3 &&
            shape[1] >= 16 && shape[1] <= max_image_edge,
        file.name() + ": face_patch", "got shape ", [&] { return shape_text(shape); },
        ", expected (N, side, side, 3), side from 16 on");
    const Index rows = shape[0];
    s.side = static_cast<int>(shape[1]);
    s.gazenerf = file.has("w2c_Rmat");
    require(s.gazenerf || file.has("face_mat_norm"), file.name(),
            "has neither face_mat_norm (ETH-XGaze's normalization_example stores it) nor w2c_Rmat "
            "(GazeNeRF), so that its patches have no cameras");
    require(file.has("facial_landmarks"), file.name() + ": facial_landmarks",
            "is missing, expected 68 points of each patch: ETH-XGaze's normalization_example and "
            "GazeNeRF's dataset_pre_processing store them");
    const Rows rotations(file, s.gazenerf ? "w2c_Rmat" : "face_mat_norm", rows, 9);
    s.frames = frames_of(file, rows, rotations, s.empty_rows);
    if (s.gazenerf)
        place_gazenerf(s, rotations, rows);
    else
        place_normalized(s, rotations, o);
    const Rows landmarks(file, "facial_landmarks", rows, 2 * landmark_count);
    for (XgazeFrame& f : s.frames)
        for (Patch& p : f.patches) {
            p.landmarks =
                Eigen::Map<const Columns<double>>(landmarks.finite(p.row), 2, landmark_count)
                    .array() +
                0.5;
            p.pinhole.width = p.pinhole.height = s.side;
            s.cameras.insert(p.camera);
        }
    read_gazes(s, rows);
    read_expressions(s, rows);
    s.masks = file.has("head_mask") && file.has("left_eye_mask") && file.has("right_eye_mask");
    return s;
}

// ---- landmarks and head ------------------------------------------------------------------------

/// 3D landmarks of a frame and their mean distance from the patches' landmarks [px].
struct Triangulated {
    Columns<double> points; ///< 3 x 68
    double error = 0;
};

Triangulated triangulated(const XgazeFrame& f) {
    const auto n = static_cast<Index>(f.patches.size());
    Triangulated t{Columns<double>(3, landmark_count), 0};
    for (Index i = 0; i < landmark_count; ++i) {
        Columns<double> from(3, n), along(3, n);
        for (Index k = 0; k < n; ++k) {
            const Patch& p = f.patches[static_cast<std::size_t>(k)];
            from.col(k) = p.pinhole.centre();
            along.col(k) = p.pinhole.ray(Vec2<double>(p.landmarks.col(i)));
        }
        Vec3<double> point = nearest_to_lines(from, along).point;
        // Points hidden in a view are guesses of the detector: the better half decides.
        std::vector<std::pair<double, Index>> off;
        for (Index k = 0; k < n; ++k) {
            const Vec3<double> to = point - from.col(k);
            off.emplace_back(cross(to, Vec3<double>(along.col(k))).norm(), k);
        }
        std::sort(off.begin(), off.end());
        const Index kept = std::max<Index>(2, (n + 1) / 2);
        Columns<double> near_from(3, kept), near_along(3, kept);
        for (Index k = 0; k < kept; ++k) {
            near_from.col(k) = from.col(off[static_cast<std::size_t>(k)].second);
            near_along.col(k) = along.col(off[static_cast<std::size_t>(k)].second);
        }
        point = nearest_to_lines(near_from, near_along).point;
        t.points.col(i) = point;
        for (Index k = 0; k < kept; ++k) {
            const Patch& p =
                f.patches[static_cast<std::size_t>(off[static_cast<std::size_t>(k)].second)];
            t.error += (p.pinhole.project_point(point).head<2>() - p.landmarks.col(i)).norm() /
                       static_cast<double>(kept * landmark_count);
        }
    }
    return t;
}

/// Returns the head frame of these landmarks: x from the right to the left lids, y from mouth to
/// lids, orthogonal to x.
Rigid<double> head_of(const Columns<double>& points) {
    const Vec3<double> right = points.middleCols(36, 6).rowwise().mean();
    const Vec3<double> left = points.middleCols(42, 6).rowwise().mean();
    const Vec3<double> mouth = points.middleCols(48, 20).rowwise().mean();
    const Vec3<double> lids = 0.5 * (left + right);
    const Vec3<double> x = normalized(Vec3<double>(left - right));
    const Vec3<double> z = normalized(cross(x, Vec3<double>(lids - mouth)));
    Rigid<double> pose;
    pose.rotation << x, cross(z, x), z;
    pose.translation = lids - pose.rotation * lids_in_head;
    return pose;
}

/// Properties shared by all frames.
struct XgazeShared {
    Columns<double> reference; ///< landmarks of the mean of the frames, head frame
    VecX<double> weights;      ///< of the landmarks, by how little they move in the head
};

/// Returns the mean of the frames' landmarks, each moved onto it, in the place of the first frame,
/// and the weights by which they were: those that expressions move count less. `floor`: of a
/// landmark's deviation.
XgazeShared aligned(const std::vector<Columns<double>>& frames, double floor) {
    XgazeShared s{frames.front(), VecX<double>::Ones(landmark_count)};
    const auto n = static_cast<double>(frames.size());
    constexpr int rounds = 10;
    // Neighbours move alike, so that inverse variances trust many that move too much. Of powers 1
    // to 3 heads of a face model are off by 1.2, 0.5 and 0.4 degrees, by nose and corners of the
    // eyes alone by 2.0.
    constexpr double power = 3;
    for (int round = 0; round < rounds; ++round) {
        std::vector<Columns<double>> moved;
        Columns<double> mean = Columns<double>::Zero(3, landmark_count);
        for (const Columns<double>& points : frames) {
            const Rigid<double> m = fit_rigid(points, s.reference, s.weights);
            moved.push_back((m.rotation * points).colwise() + m.translation);
            mean += moved.back() / n;
        }
        VecX<double> variance = VecX<double>::Constant(landmark_count, floor * floor);
        for (const Columns<double>& points : moved)
            variance += (points - mean).colwise().squaredNorm().transpose() / (3 * n);
        s = {mean, variance.array().pow(-power)};
    }
    return s;
}

// ---- pictures ----------------------------------------------------------------------------------

/// Returns 0 for black pixels connected to the border: warping fills pixels there that the camera
/// did not see.
Image8 padding_of(const Image8& picture) {
    const int w = picture.width, h = picture.height;
    Image8 visible = plain_image(w, h, 255);
    const auto black = [&](std::size_t i) {
        return picture.values[3 * i] == 0 && picture.values[3 * i + 1] == 0 &&
               picture.values[3 * i + 2] == 0;
    };
    std::vector<std::size_t> open;
    const auto visit = [&](int x, int y) {
        if (x < 0 || y < 0 || x >= w || y >= h) return;
        const std::size_t i =
            static_cast<std::size_t>(y) * static_cast<std::size_t>(w) + static_cast<std::size_t>(x);
        if (visible.values[i] == 0 || !black(i)) return;
        visible.values[i] = 0;
        open.push_back(i);
    };
    for (int x = 0; x < w; ++x) visit(x, 0), visit(x, h - 1);
    for (int y = 0; y < h; ++y) visit(0, y), visit(w - 1, y);
    while (!open.empty()) {
        const int x = static_cast<int>(open.back() % static_cast<std::size_t>(w)),
                  y = static_cast<int>(open.back() / static_cast<std::size_t>(w));
        open.pop_back();
        visit(x + 1, y), visit(x - 1, y), visit(x, y + 1), visit(x, y - 1);
    }
    return visible;
}

Image8 mask_of(const Hdf5File& file, const char* name, Index row, int side) {
    Image8 mask{side, side, 1, file.bytes(name, row)};
    const std::size_t count = static_cast<std::size_t>(side) * static_cast<std::size_t>(side);
    require(mask.values.size() == count, file.name() + ": " + name, "got ", mask.values.size(),
            " pixels a row, expected ", count);
    const std::uint8_t most = *std::max_element(mask.values.begin(), mask.values.end());
    if (most == 1)
        for (std::uint8_t& v : mask.values) v = v > 0 ? 255 : 0;
    return mask;
}

/// Returns both masks of the file in one; each belongs to the side with the nearer lids.
Image8 stored_eyes(const XgazeSource& s, const Patch& p, const Columns<double>& points) {
    Image8 eyes = plain_image(s.side, s.side, 0);
    for (const char* name : {"left_eye_mask", "right_eye_mask"}) {
        const Image8 mask = mask_of(*s.file, name, p.row, s.side);
        Vec2<double> middle = Vec2<double>::Zero();
        double n = 0;
        for (int y = 0; y < s.side; ++y)
            for (int x = 0; x < s.side; ++x)
                if (mask.values[static_cast<std::size_t>(y * s.side + x)] >= 128) {
                    middle += Vec2<double>(x + 0.5, y + 0.5);
                    ++n;
                }
        if (n == 0) continue;
        middle /= n;
        std::array<double, 2> away{};
        for (int e = 0; e < 2; ++e) {
            const Vec3<double> lids =
                points.middleCols(eye_landmarks(e).front(), 6).rowwise().mean();
            away[static_cast<std::size_t>(e)] =
                (p.pinhole.project_point(lids).head<2>() - middle).norm();
        }
        const int eye = away[0] <= away[1] ? 0 : 1;
        for (std::size_t i = 0; i < mask.values.size(); ++i)
            if (mask.values[i] >= 128) eyes.values[i] = eye_mask_value(eye);
    }
    return eyes;
}

/// Returns the face inside the landmarks, and a forehead as high as the nose is long.
Image8 face_mask(const Columns<double>& points, const Pinhole<double>& camera) {
    const Vec3<double> brows = points.middleCols(17, 10).rowwise().mean();
    const Vec3<double> up = 0.8 * (brows - Vec3<double>(points.col(33)));
    Columns<double> image(2, landmark_count + 10);
    for (Index i = 0; i < landmark_count + 10; ++i) {
        const Vec3<double> x = i < landmark_count
                                   ? Vec3<double>(points.col(i))
                                   : Vec3<double>(points.col(17 + i - landmark_count) + up);
        image.col(i) = camera.project_point(x).head<2>();
    }
    return hull_mask(image, {camera.width, camera.height});
}

ImportView view_of(const XgazeSource& s, const Patch& p, const Columns<double>& points) {
    ImportView view;
    view.camera = "cam" + std::string(p.camera < 10 ? "0" : "") + std::to_string(p.camera);
    view.pinhole = p.pinhole;
    view.picture = {s.side, s.side, 3, s.file->bytes("face_patch", p.row)};
    for (std::size_t i = 0; i + 2 < view.picture.values.size(); i += 3) // stored as BGR
        std::swap(view.picture.values[i], view.picture.values[i + 2]);
    view.visible = padding_of(view.picture);
    view.mask =
        s.masks ? mask_of(*s.file, "head_mask", p.row, s.side) : face_mask(points, p.pinhole);
    view.eyes = s.masks ? stored_eyes(s, p, points) : lid_eye_mask(points, p.pinhole);
    for (std::size_t i = 0; i < view.mask.values.size(); ++i)
        if (view.visible.values[i] == 0) view.mask.values[i] = view.eyes.values[i] = 0;
    clip_to_mask(view.eyes, view.mask);
    return view;
}

/// Throws an Error for a patch whose landmarks are far from those of the other cameras: its camera
/// is a wrong one.
void require_landmarks(const XgazeSource& s, const XgazeFrame& f, const Columns<double>& points) {
    constexpr double most = 0.1; // times the side of a patch
    for (const Patch& p : f.patches) {
        double off = 0;
        for (Index i = 0; i < landmark_count; ++i)
            off += (p.pinhole.project_point(points.col(i)).head<2>() - p.landmarks.col(i)).norm() /
                   static_cast<double>(landmark_count);
        require(
            off < most * s.side, s.file->name() + ": facial_landmarks", "row ", p.row,
            ": its landmarks are ", [&] { return factor_text(off); },
            " pixels from those that the other cameras of frame ", f.id, " see, expected below ",
            [&] { return factor_text(most * s.side); }, ": the camera ", p.camera,
            " of the calibration is not that of the patch");
    }
}

ImportFrame frame_of(const XgazeSource& s, const XgazeShared& shared, const XgazeFrame& f,
                     Json& facts) {
    const Triangulated t = triangulated(f);
    require_landmarks(s, f, t.points);
    const Rigid<double> pose =
        s.gazenerf ? Rigid<double>{} : fit_rigid(shared.reference, t.points, shared.weights);
    ImportHead head;
    head.expression = f.expression.empty() ? std::vector<double>{0} : f.expression;
    head.landmarks = t.points;
    head.pose.head<3>() = so3_log(pose.rotation);
    head.pose.tail<3>() = pose.translation;
    head.has_gaze = true;
    Vec3<double> gaze = Vec3<double>::Zero();
    if (f.gaze_head) {
        gaze = *f.gaze_head;
    } else {
        for (const Patch& p : f.patches) gaze += *p.gaze_world;
        gaze = normalized(Vec3<double>(pose.rotation.transpose() * gaze));
    }
    double spread = 0;
    if (!f.gaze_head)
        for (const Patch& p : f.patches)
            spread += degrees *
                      angular_error(gaze, Vec3<double>(pose.rotation.transpose() * *p.gaze_world)) /
                      static_cast<double>(f.patches.size());
    require(
        !beyond_gaze_range(gaze), s.file->name() + ": frame " + f.id, "its gaze is ",
        [&] { return factor_text(degrees * angular_error(gaze, Vec3<double>(0, 0, 1))); },
        " degrees from straight ahead, expected at most ",
        [&] { return factor_text(degrees * gaze_range); });
    for (CaptureEye& eye : head.eyes) eye.optical = gaze;
    facts = {{"error", t.error}, {"spread", spread}, {"views", f.patches.size()}};
    ImportFrame frame{f.id, head, {}};
    for (const Patch& p : f.patches) frame.views.push_back(view_of(s, p, t.points));
    return frame;
}

/// Converts the file's lengths to rye's units, and takes the head frame from all frames.
XgazeShared prepared(XgazeSource& s) {
    const Columns<double> first = triangulated(s.frames.front()).points;
    const double span = (first.rowwise().maxCoeff() - first.rowwise().minCoeff()).norm();
    require(std::isfinite(span) && span > 0, s.file->name() + ": facial_landmarks",
            "the landmarks of the first frame triangulate to one place");
    s.factor = unit_factor(span);
    for (XgazeFrame& f : s.frames)
        for (Patch& p : f.patches) p.pinhole.camera_from_world.translation *= s.factor;
    // Enough frames to know what moves.
    constexpr std::size_t most = 200;
    const std::size_t stride = (s.frames.size() + most - 1) / most;
    std::vector<Columns<double>> frames;
    for (std::size_t i = 0; i < s.frames.size(); i += stride)
        frames.push_back(triangulated(s.frames[i]).points);
    constexpr double floor = 0.005; // of the span: about a millimetre
    XgazeShared shared = aligned(frames, floor * s.factor * span);
    const Rigid<double> head = head_of(shared.reference);
    shared.reference = (head.rotation.transpose() *
                        (shared.reference.colwise() - head.translation)).eval();
    return shared;
}

struct XgazeTotals {
    double error = 0, spread = 0;
    int views = 0;
};

void summarize(const XgazeSource& s, const XgazeTotals& t, ImportSummary& summary) {
    const double frames = summary.frames;
    const bool codes = !s.frames.front().expression.empty();
    summary.found.push_back(
        std::to_string(t.views) + " patches of " + std::to_string(s.side) + " x " +
        std::to_string(s.side) + " pixels" +
        (s.empty_rows > 0 ? ", " + std::to_string(s.empty_rows) + " empty rows" : ""));
    summary.found.push_back(s.gazenerf ? "a camera of each patch (w2c, inmat)"
                                       : "the calibration, read as " + s.calibration);
    if (s.masks) summary.found.push_back("masks of the head and of both eyes");
    if (codes) summary.found.push_back("79 expression codes of GazeNeRF's 3DMM");
    summary.derived.push_back("68 landmarks from those of the patches, which they miss by " +
                              factor_text(t.error / frames) + " pixels in the mean");
    summary.derived.push_back(
        s.gazenerf
            ? "head poses: the world of GazeNeRF's fit is the head; gaze of both eyes: that of the "
              "face, in the frame of ETH-XGaze's face model, which may differ by a few degrees"
            : "head poses from landmarks, less from those that move; gaze of both eyes: that of the face, on which the "
              "cameras agree to " +
                  factor_text(t.spread / frames) + " degrees");
    if (!s.masks)
        summary.derived.push_back(
            "masks: the face inside the landmarks, without hair, ears and "
            "neck; eye masks: the polygons of the lids");
    summary.derived.push_back("`visible`: black pixels that reach the border are padding");
    if (s.factor != 1)
        summary.derived.push_back("lengths times " + factor_text(s.factor) +
                                  ", so that a head spans about 2 units");
    if (!codes)
        summary.missing.push_back(
            "expression coefficients: one that is 0; face, eyes and what "
            "follows pose and gaze are trained, expressions are averaged");
    summary.missing.push_back(
        "eyeballs' centres, size of the iris and kappa: a training places the eyeballs by the "
        "irises; the gaze is a line of sight, not an optical axis");
}

} // namespace

ImportSummary import_xgaze(const ImportOptions& o) {
    Json job = import_job("xgaze", o);
    job["calibration"] = o.calibration.empty() ? "" : fs::weakly_canonical(o.calibration).string();
    job["normalization"] = o.normalization;
    require(fs::is_regular_file(o.source), o.source.string(),
            "is a folder, expected one HDF5 file, of one subject");
    const Hdf5File file(o.source);
    XgazeSource s = read_xgaze(file, o);
    const XgazeShared shared = prepared(s);
    ImportFolder folder(o.out, job);
    ImportSummary summary;
    XgazeTotals totals;
    Json train = Json::array(), test = Json::array();
    for (const XgazeFrame& f : s.frames) {
        if (!folder.has(f.id)) {
            Json facts;
            const ImportFrame frame = frame_of(s, shared, f, facts);
            folder.write(frame, facts);
            ++summary.written;
        }
        const Json& facts = folder.facts(f.id);
        totals.error += facts.value("error", 0.0);
        totals.spread += facts.value("spread", 0.0);
        totals.views += facts.value("views", 0);
        const std::size_t tests =
            s.frames.size() > 1 ? std::max<std::size_t>(1, s.frames.size() / 5) : 0;
        (static_cast<std::size_t>(summary.frames) + tests < s.frames.size() ? train : test)
            .push_back(f.id);
        o.progress(++summary.frames, static_cast<int>(s.frames.size()));
    }
    summary.cameras = static_cast<int>(s.cameras.size());
    summarize(s, totals, summary);
    folder.finish({{"subject", o.source.stem().string()},
                   {"image_size", {s.side, s.side}},
                   {"train_frames", train},
                   {"test_frames", test},
                   {"conventions",
                    {{"image", "photographs; multiplied by the mask when read"},
                     {"world", "that of the source, lengths times " + factor_text(s.factor)}}}},
                  summary);
    return summary;
}

} // namespace rye::trainer
