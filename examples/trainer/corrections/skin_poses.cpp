// SPDX-License-Identifier: Apache-2.0
#include "corrections/skin_poses.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <rye/math/rotation.hpp>
#include <rye/train/capture_subject.hpp>

#include "corrections/skin_pictures.hpp"
#include "data/degrees.hpp"
#include "data/threads.hpp"

namespace rye::trainer {
namespace {

constexpr double dark = 0.03;              ///< added to grey values before their logarithm
constexpr double spread2 = 0.05 * 0.05;    ///< variance of shine and of moving skin, in logarithms
constexpr double alike = 12;               ///< neighbouring samples that count as one
constexpr double turn_before = 1 * degree; ///< standard deviations known before, of an axis
constexpr double shift_before = 0.02;      ///< [canonical units]
constexpr Index motion = 6, light = 8;

/// Harmonics of degree 1 and 2 of a direction, without factors.
Vec<double, light> harmonics(const Vec3<double>& n) {
    return {n.x(),
            n.y(),
            n.z(),
            n.x() * n.y(),
            n.y() * n.z(),
            n.z() * n.x(),
            n.x() * n.x() - n.y() * n.y(),
            3 * n.z() * n.z() - 1};
}

/// Returns the outward unit normals of these points: of the plane of their nearest neighbours.
Columns<double> normals(const Columns<double>& points, const Columns<double>& all,
                        const Vec3<double>& middle) {
    constexpr std::size_t neighbours = 12;
    Columns<double> out(3, points.cols());
    std::vector<std::pair<double, Index>> near(static_cast<std::size_t>(all.cols()));
    for (Index l = 0; l < points.cols(); ++l) {
        for (Index i = 0; i < all.cols(); ++i)
            near[static_cast<std::size_t>(i)] = {(all.col(i) - points.col(l)).squaredNorm(), i};
        const std::size_t k = std::min(neighbours, near.size());
        std::partial_sort(near.begin(), near.begin() + static_cast<std::ptrdiff_t>(k), near.end());
        Vec3<double> mean = Vec3<double>::Zero();
        for (std::size_t i = 0; i < k; ++i)
            mean += all.col(near[i].second) / static_cast<double>(k);
        Mat3<double> spread = Mat3<double>::Zero();
        for (std::size_t i = 0; i < k; ++i) {
            const Vec3<double> d = all.col(near[i].second) - mean;
            spread += d * d.transpose();
        }
        const Vec3<double> n =
            Eigen::SelfAdjointEigenSolver<Mat3<double>>(spread).eigenvectors().col(0);
        out.col(l) = n.dot(points.col(l) - middle) < 0 ? Vec3<double>(-n) : n;
    }
    return out;
}

/// A point of a frame in a camera.
struct Sample {
    std::size_t place; ///< camera and point: the same in all frames
    Index camera;
    double level;              ///< logarithm of its grey value
    Vec<double, motion> slope; ///< derivative by the head's motion
    Vec<double, light> around; ///< harmonics of its outward direction in the world
};

/// Alignment of all frames.
class Alignment {
  public:
    Alignment(const Capture& capture, const std::vector<int>& frames, const Vec3<double>& head)
        : c_(capture),
          frames_(frames),
          head_(head),
          cameras_(some_cameras(capture)),
          state_(frames.size(), VecX<double>::Zero(motion + light + count())) {
        constexpr Index most_points = 1500;
        const Index stride = 1 + capture.frames[first()].vertices.cols() / most_points;
        for (const int f : frames) {
            const CaptureFrame& frame = capture.frames[static_cast<std::size_t>(f)];
            const Columns<double> all =
                to_canonical(frame, chosen_landmarks(frame.landmarks, frame.vertices, stride));
            if (points_.empty()) {
                told_ = away_from_eyes(all);
                normals_ = normals(
                    all(Eigen::all, told_),
                    to_canonical(frame, chosen_landmarks(frame.landmarks, frame.vertices, 1)),
                    head);
            }
            points_.push_back(all(Eigen::all, told_));
        }
        seen_.resize(frames.size());
        costs_.resize(frames.size());
    }

    SkinPoses run() {
        SkinPoses out;
        SkinPictures fine(c_, frames_, cameras_, 256);
        for (const bool coarse : {true, false}) { // heads that are far off, then all
            pictures_ = coarse ? fine.coarser(128) : std::move(fine);
            align(out, coarse);
        }
        out.after = difference_;
        for (const VecX<double>& s : state_) out.moved.push_back(s.head<motion>());
        return out;
    }

  private:
    void align(SkinPoses& out, bool first) {
        constexpr int views = 4, rounds = 2;
        for (int view = 0; view < views; ++view) {
            each_frame([&](std::size_t i) { sample(i); });
            for (int round = 0; round < rounds; ++round) {
                sum_places();
                each_frame([&](std::size_t i) { solve(i); });
                take_mean_off();
                if (first && view == 0 && round == 0) out.before = difference_;
            }
            for (std::size_t i = 0; i < frames_.size(); ++i) at_[i] = state_[i].head<motion>();
        }
    }
    template <class F>
    void each_frame(const F& f) const {
        program_threads().run(static_cast<Index>(frames_.size()),
                              [&](Index i) { f(static_cast<std::size_t>(i)); });
    }
    /// Returns at most eight cameras, from all of the row.
    static std::vector<std::size_t> some_cameras(const Capture& capture) {
        constexpr std::size_t most = 8;
        const auto all = static_cast<std::size_t>(capture.camera_count());
        std::vector<std::size_t> some(std::min(all, most));
        for (std::size_t k = 0; k < some.size(); ++k) some[k] = k * all / some.size();
        return some;
    }
    /// Returns the points beside eyelids and eyeballs, which move by themselves.
    static std::vector<Index> away_from_eyes(const Columns<double>& points) {
        const Vec3<double> right = rye::detail::eye_landmark_centre(points, 0),
                           left = rye::detail::eye_landmark_centre(points, 1);
        constexpr double lids = 0.4; // of the distance of the eyes
        const double near = lids * (left - right).norm();
        std::vector<Index> away;
        for (Index l = 0; l < points.cols(); ++l)
            if (std::min((points.col(l) - right).norm(), (points.col(l) - left).norm()) >= near)
                away.push_back(l);
        return away;
    }
    std::size_t first() const { return static_cast<std::size_t>(frames_.front()); }
    Index count() const { return static_cast<Index>(cameras_.size()); }

    /// Reads a frame's pictures where its head is now.
    void sample(std::size_t i) {
        const CaptureFrame& f = c_.frames[static_cast<std::size_t>(frames_[i])];
        const Mat3<double> r = so3_exp(Vec3<double>(f.pose.head<3>()));
        const Vec3<double> t = f.pose.tail<3>();
        const Mat3<double> turn = so3_exp(Vec3<double>(at_[i].head<3>()));
        const Columns<double>& p = points_[i];
        seen_[i].clear();
        for (Index k = 0; k < count(); ++k) {
            const auto camera = static_cast<std::size_t>(k);
            if (!pictures_->has(i, camera)) continue;
            const Pinhole<double>& view = c_.camera(frames_[i], static_cast<int>(cameras_[camera]));
            const Vec3<double> eye = view.centre();
            for (Index l = 0; l < p.cols(); ++l) {
                const Vec3<double> arm = turn * (p.col(l) - head_);
                const Vec3<double> in_head = head_ + arm + at_[i].tail<3>();
                const Vec3<double> x = f.scale * (r * in_head) + t;
                const Vec3<double> outward = r * (turn * normals_.col(l));
                if (outward.dot((eye - x).normalized()) < frontal_skin) continue;
                if (normalized(Vec3<double>(r * arm)).dot((eye - x).normalized()) < 0.4) continue;
                const std::optional<SkinValue> v =
                    pictures_->value(i, camera, view.project_point(x).head<2>());
                if (!v) continue;
                const Vec3<double> in_camera = view.camera_from_world.apply(x);
                const double z = in_camera.z();
                const Vec3<double> by_camera(v->slope.x() * view.fx / z, v->slope.y() * view.fy / z,
                                             -(v->slope.x() * view.fx * in_camera.x() +
                                               v->slope.y() * view.fy * in_camera.y()) /
                                                 (z * z));
                const Vec3<double> by_head =
                    f.scale *
                    (r.transpose() * (view.camera_from_world.rotation.transpose() * by_camera));
                Sample s;
                s.place = static_cast<std::size_t>(k * p.cols() + l);
                s.camera = k;
                s.level = std::log(v->grey + dark);
                s.slope << arm.cross(by_head), by_head;
                s.slope /= v->grey + dark;
                s.around = harmonics(outward);
                seen_[i].push_back(s);
            }
        }
    }

    /// Returns a sample's level without the light, and with the motion since it was read.
    double level(std::size_t i, const Sample& s) const {
        const VecX<double>& x = state_[i];
        return s.level + s.slope.dot(x.head<motion>() - at_[i]) -
               s.around.dot(x.segment<light>(motion)) - x[motion + light + s.camera];
    }

    void sum_places() {
        const auto all = static_cast<std::size_t>(count() * points_.front().cols());
        sum_.assign(all, 0);
        by_.assign(all, 0);
        for (std::size_t i = 0; i < frames_.size(); ++i)
            for (const Sample& s : seen_[i]) {
                sum_[s.place] += level(i, s);
                ++by_[s.place];
            }
    }

    void solve(std::size_t i) {
        const Index n = motion + light + count();
        Eigen::MatrixXd a = Eigen::MatrixXd::Zero(n, n);
        VecX<double> b = VecX<double>::Zero(n), row = b;
        double cost = 0, used = 0;
        for (const Sample& s : seen_[i]) {
            constexpr int fewest = 4;
            if (by_[s.place] < fewest) continue;
            const double mine = level(i, s);
            const double off = mine - (sum_[s.place] - mine) / (by_[s.place] - 1);
            const double w = 1 / std::pow(1 + off * off / spread2, 2);
            row.setZero();
            row.head<motion>() = s.slope;
            row.segment<light>(motion) = -s.around;
            row[motion + light + s.camera] = -1;
            a.selfadjointView<Eigen::Lower>().rankUpdate(row, w);
            b -= w * off * row;
            cost += off * off / (1 + off * off / spread2); // Geman and McClure's
            used += 1;
        }
        costs_[i] = {cost, used};
        const double known = alike * spread2;
        for (Index k = 0; k < motion; ++k) {
            const double sigma = k < 3 ? turn_before : shift_before;
            a(k, k) += known / (sigma * sigma);
            b[k] -= known / (sigma * sigma) * state_[i][k];
        }
        for (Index k = motion; k < n; ++k) a(k, k) += 1e-3 * known;
        state_[i] += a.selfadjointView<Eigen::Lower>().ldlt().solve(b);
    }

    void take_mean_off() {
        Vec<double, motion> mean = Vec<double, motion>::Zero();
        double cost = 0, used = 0;
        for (std::size_t i = 0; i < frames_.size(); ++i) {
            mean += state_[i].head<motion>() / static_cast<double>(frames_.size());
            cost += costs_[i][0];
            used += costs_[i][1];
        }
        for (VecX<double>& s : state_) s.head<motion>() -= mean;
        difference_ = used > 0 ? std::sqrt(cost / used) : 0;
    }

    const Capture& c_;
    const std::vector<int>& frames_;
    Vec3<double> head_;
    std::vector<std::size_t> cameras_;
    std::optional<SkinPictures> pictures_;
    std::vector<Index> told_;
    Columns<double> normals_;
    std::vector<Columns<double>> points_; ///< of each frame, head frame
    std::vector<std::vector<Sample>> seen_;
    std::vector<VecX<double>> state_; ///< motion, light, and a level of each camera
    std::vector<Vec<double, motion>> at_ =
        std::vector<Vec<double, motion>>(frames_.size(), Vec<double, motion>::Zero());
    std::vector<double> sum_;
    std::vector<int> by_;
    std::vector<Vec2<double>> costs_; ///< cost and number of samples
    double difference_ = 0;
};

} // namespace

SkinPoses skin_poses(const Capture& capture, const std::vector<int>& frames,
                     const Vec3<double>& head) {
    constexpr Index fewest = 300; // dense vertices, whose planes are known
    if (capture.frames[static_cast<std::size_t>(frames.front())].vertices.cols() < fewest)
        return {};
    return Alignment(capture, frames, head).run();
}

} // namespace rye::trainer
