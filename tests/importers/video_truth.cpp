// SPDX-License-Identifier: Apache-2.0
// video_truth TRUTH CAPTURE: how far a capture that `rye import video` made of a video is from the
// truth, which `rye capture --video` wrote beside the video. Frames are compared by their names.
// Gazes are compared before the camera that both have. A head's pose has a frame of its own, so poses
// are compared after one rotation of that frame, and places of heads after one similarity.
// video_truth TRUTH CAPTURE OUT: also writes a copy of CAPTURE whose test frames have the true gazes, as
// its heads have them, by which `rye evaluate` measures an avatar of CAPTURE.
#include <algorithm>
#include <cstdio>
#include <exception>
#include <vector>

#include <Eigen/SVD>

#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/capture.hpp"
#include "data/changed_labels.hpp"
#include "data/degrees.hpp"
#include "data/json.hpp"
#include "data/median.hpp"
#include "importers/face_geometry.hpp"
#include "video_pairs.hpp"

namespace {

using namespace rye;
using namespace rye::trainer;

constexpr double mm_per_unit = 100;

/// The axis of an eye before the camera.
Vec3<double> gaze_in_camera(const Capture& c, int f, std::size_t eye) {
    return head_in_camera(c, f).rotation * c.frames[static_cast<std::size_t>(f)].eyes[eye].optical;
}

void compare_poses(const Capture& truth, const Capture& got, const std::vector<VideoPair>& pairs) {
    Mat3<double> sum = Mat3<double>::Zero();
    const auto count = static_cast<Index>(pairs.size());
    Columns<double> from(3, count), to(3, count);
    for (Index i = 0; i < count; ++i) {
        const VideoPair p = pairs[static_cast<std::size_t>(i)];
        const Rigid<double> a = head_in_camera(truth, p.truth), b = head_in_camera(got, p.got);
        sum += b.rotation.transpose() * a.rotation;
        const auto middle = [&](const Capture& c, int f) {
            const CaptureFrame& frame = c.frames[static_cast<std::size_t>(f)];
            return Vec3<double>(c.camera(f, 0).camera_from_world.apply(
                Vec3<double>(0.5 * (*frame.eyes[0].centre + *frame.eyes[1].centre))));
        };
        from.col(i) = middle(got, p.got);
        to.col(i) = middle(truth, p.truth);
    }
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
    const Mat3<double> frame = svd.matrixU() * svd.matrixV().transpose();
    double mean = 0, most = 0;
    for (const VideoPair& p : pairs) {
        const double off = degrees * so3_log(Mat3<double>(head_in_camera(truth, p.truth).rotation.transpose() *
                                                          head_in_camera(got, p.got).rotation * frame)).norm();
        mean += off / static_cast<double>(pairs.size());
        most = std::max(most, off);
    }
    const auto spread = [](const Columns<double>& x) {
        return (x.colwise() - Vec3<double>(x.rowwise().mean())).norm();
    };
    const Columns<double> sized = spread(to) / spread(from) * from;
    const Rigid<double> motion = fit_rigid(sized, to);
    double off = 0;
    for (Index i = 0; i < count; ++i)
        off += (motion.apply(Vec3<double>(sized.col(i))) - to.col(i)).norm() / static_cast<double>(count);
    std::printf("head pose      %.2f deg in the mean, %.2f at most; middle of the eyes %.1f mm\n", mean,
                most, mm_per_unit * off);
    std::printf("distance       %+.1f %%\n", 100 * (from.row(2).mean() / to.row(2).mean() - 1));
}

void compare_gazes(const Capture& truth, const Capture& got, const std::vector<VideoPair>& pairs) {
    for (std::size_t e = 0; e < 2; ++e) {
        std::vector<double> all;
        double mean = 0;
        Vec2<double> bias = Vec2<double>::Zero();
        for (const VideoPair& p : pairs) {
            const Vec3<double> a = gaze_in_camera(truth, p.truth, e), b = gaze_in_camera(got, p.got, e);
            all.push_back(degrees * angular_error(a, b));
            mean += all.back() / static_cast<double>(pairs.size());
            const Mat3<double> to_head = head_in_camera(got, p.got).rotation.transpose();
            bias += degrees * (pitch_yaw(Vec3<double>(to_head * b)) - pitch_yaw(Vec3<double>(to_head * a))) /
                    static_cast<double>(pairs.size());
        }
        std::printf("gaze, %s    %.2f deg in the mean, %.2f in the middle; on average %+.1f up, %+.1f "
                    "to the subject's left\n",
                    e == 0 ? "left " : "right", mean, median(all), bias[0], bias[1]);
    }
}

void compare_masks(Capture& truth, Capture& got, const std::vector<VideoPair>& pairs,
                   const std::array<double, 3>& square) {
    double both = 0, either = 0, eyes_both = 0, eyes_either = 0;
    for (const VideoPair& p : pairs) {
        const Image<float> mask = got.mask(p.got, 0), right = truth.mask(p.truth, 0);
        const Image<float> visible = got.visible(p.got, 0);
        const Image<float> eyes = got.eye_mask(p.got, 0), right_eyes = truth.eye_mask(p.truth, 0);
        const double step = square[2] / mask.width;
        for (int y = 0; y < mask.height; ++y)
            for (int x = 0; x < mask.width; ++x) {
                const int u = static_cast<int>(std::floor(square[0] + (x + 0.5) * step)),
                          v = static_cast<int>(std::floor(square[1] + (y + 0.5) * step));
                if (visible.at(x, y)[0] < 0.5f || u < 0 || v < 0 || u >= right.width || v >= right.height)
                    continue;
                const bool a = right.at(u, v)[0] > 0.5f, b = mask.at(x, y)[0] > 0.5f;
                both += a && b ? 1 : 0;
                either += a || b ? 1 : 0;
                for (Index e = 0; e < 2; ++e) {
                    const bool c = right_eyes.at(u, v)[e] > 0.5f, d = eyes.at(x, y)[e] > 0.5f;
                    eyes_both += c && d ? 1 : 0;
                    eyes_either += c || d ? 1 : 0;
                }
            }
    }
    std::printf("masks          %.3f intersection over union of heads, %.3f of eyes\n",
                both / std::max(either, 1.0), eyes_both / std::max(eyes_either, 1.0));
}

void write_true_gazes(const Capture& truth, const Capture& got, const std::vector<VideoPair>& pairs,
                      const char* out) {
    std::vector<LabelChange> changes;
    for (const VideoPair& p : pairs) {
        if (std::find(got.test.begin(), got.test.end(), p.got) == got.test.end()) continue;
        LabelChange change;
        change.frame = got.frames[static_cast<std::size_t>(p.got)].id;
        const Mat3<double> to_head = head_in_camera(got, p.got).rotation.transpose();
        for (std::size_t e = 0; e < 2; ++e)
            change.gaze[e] = pitch_yaw(Vec3<double>(to_head * gaze_in_camera(truth, p.truth, e))) -
                             pitch_yaw(Vec3<double>(to_head * gaze_in_camera(got, p.got, e)));
        changes.push_back(change);
    }
    write_changed_capture(got.folder, out, changes, HeadPoints::kept);
    std::printf("written        %s, with the true gazes of %zu test frames\n", out, changes.size());
}

int run(const char* truth_folder, const char* got_folder, const char* out) {
    if (out != nullptr) check_new_capture(got_folder, out);
    Capture truth = read_capture(truth_folder), got = read_capture(got_folder);
    const auto json = read_json(got.folder / "capture.json");
    require(json.contains("video"), got_folder, "is no capture of `rye import video`");
    const double focal = json.at("video").at("focal").get<double>();
    const auto square = json.at("video").at("square").get<std::array<double, 3>>();
    const std::vector<VideoPair> pairs = pairs_of(truth, got);
    std::printf("frames         %zu\n", pairs.size());
    std::printf("focal length   %+.1f %%\n", 100 * (focal / truth.camera(pairs[0].truth, 0).fx - 1));
    compare_poses(truth, got, pairs);
    compare_gazes(truth, got, pairs);
    compare_masks(truth, got, pairs, square);
    if (out != nullptr) write_true_gazes(truth, got, pairs, out);
    return 0;
}

} // namespace

int main(int count, char** words) {
    if (count != 3 && count != 4) {
        std::fprintf(stderr, "usage: video_truth TRUTH CAPTURE [OUT]\n");
        return 2;
    }
    try {
        return run(words[1], words[2], count > 3 ? words[3] : nullptr);
    } catch (const std::exception& e) {
        std::fprintf(stderr, "video_truth: %s\n", e.what());
        return 1;
    }
}
