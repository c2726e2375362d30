// SPDX-License-Identifier: Apache-2.0
#include "importers/subject_eyes.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include <rye/math/levenberg.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>
#include <rye/train/capture_subject.hpp>

#include "data/config.hpp"
#include "data/median.hpp"
#include "importers/import_folder.hpp"
#include "training/labels.hpp"

namespace rye::trainer {
namespace {

constexpr double degree = 3.14159265358979323846 / 180;
constexpr std::size_t fewest_frames = 6;
constexpr double of_ray = 0.004; ///< error of a sharp iris across its ray, canonical units

/// Centres of both eyes, then the distance of the iris' plane.
using Rig = VecX<double>;
Vec3<double> centre_of(const Rig& x, std::size_t e) {
    return x.segment<3>(3 * static_cast<Index>(e));
}

/// Residuals of the points, in standard deviations.
class RigResiduals {
  public:
    RigResiduals(const std::vector<IrisPoint>& points, const Rig& start, GivenGazes given,
                 double centre_sigma)
        : points_(points),
          start_(start),
          given_(given),
          centre_sigma_(centre_sigma) {}

    /// Returns the residuals: robust_ of points first, then those of the priors.
    VecX<double> operator()(const Rig& x) const {
        std::vector<double> r;
        for (const IrisPoint& p : points_) {
            const Vec3<double> out = p.at - centre_of(x, p.eye);
            const Vec3<double> u = normalized(out);
            constexpr double shape = 0.002; // an eye is no sphere
            r.push_back((out.norm() - x[6]) / std::sqrt(u.dot(p.covariance * u) + shape * shape));
            if (given_ == GivenGazes::none) continue;
            constexpr double of_gaze = 4.5 * degree;
            const Mat3<double> spread =
                p.covariance + std::pow(of_gaze * x[6], 2) * Mat3<double>::Identity();
            const Vec3<double> off =
                spread.llt().matrixL().solve(Vec3<double>(out - x[6] * p.gaze));
            for (Index d = 0; d < 3; ++d) r.push_back(off[d]);
        }
        robust_ = r.size();
        for (Index i = 0; i < 6; ++i) r.push_back((x[i] - start_[i]) / centre_sigma_);
        constexpr double of_distance = 0.15;
        r.push_back(std::log(std::max(x[6], 1e-6) / start_[6]) / of_distance);
        if (given_ == GivenGazes::none) add_convergence(x, r);
        return Eigen::Map<const VecX<double>>(r.data(), static_cast<Index>(r.size()));
    }
    /// Returns the number of residuals that may be false irises; of the last call.
    std::size_t robust() const { return robust_; }

  private:
    /// Adds what average eyes have in common: their axes are each 5 degrees temporal of lines of
    /// sight that meet at about a metre, at the same height.
    void add_convergence(const Rig& x, std::vector<double>& r) const {
        std::vector<double> yaw, pitch;
        for (const IrisPoint& a : points_)
            for (const IrisPoint& b : points_) {
                if (a.frame != b.frame || a.eye != 0 || b.eye != 1) continue;
                const Vec2<double> left =
                    pitch_yaw(normalized(Vec3<double>(a.at - centre_of(x, 0))));
                const Vec2<double> right =
                    pitch_yaw(normalized(Vec3<double>(b.at - centre_of(x, 1))));
                pitch.push_back(left[0] - right[0]);
                yaw.push_back(left[1] - right[1]);
            }
        if (yaw.empty()) return;
        r.push_back((median(yaw) - 6 * degree) / (3 * degree));
        r.push_back(median(pitch) / degree);
    }

    const std::vector<IrisPoint>& points_;
    Rig start_;
    GivenGazes given_;
    double centre_sigma_;
    mutable std::size_t robust_ = 0;
};

/// Returns the fit, with residuals of points linear beyond two standard deviations.
Rig fitted(const RigResiduals& residuals, const Rig& start) {
    constexpr double bound = 2;
    const auto weight = [&](double r) {
        return std::min(1.0, bound / std::max(std::abs(r), 1e-12));
    };
    const auto cost = [&](const VecX<double>& x) {
        const VecX<double> r = residuals(x);
        double sum = 0;
        for (Index i = 0; i < r.size(); ++i) {
            const double a = std::abs(r[i]);
            const bool far = a > bound && static_cast<std::size_t>(i) < residuals.robust();
            sum += far ? bound * (2 * a - bound) : a * a;
        }
        return sum;
    };
    const auto linearized = [&](const VecX<double>& x) {
        const VecX<double> r = residuals(x);
        Columns<double> j(r.size(), x.size());
        for (Index k = 0; k < x.size(); ++k) {
            constexpr double step = 1e-5;
            const VecX<double> d = step * VecX<double>::Unit(x.size(), k);
            j.col(k) = (residuals(x + d) - residuals(x - d)) / (2 * step);
        }
        VecX<double> w = VecX<double>::Ones(r.size());
        for (std::size_t i = 0; i < residuals.robust(); ++i)
            w[static_cast<Index>(i)] = weight(r[static_cast<Index>(i)]);
        NormalEquations<double> n;
        n.cost = cost(x);
        n.matrix = j.transpose() * w.asDiagonal() * j;
        n.gradient = j.transpose() * w.cwiseProduct(r);
        return n;
    };
    LevenbergSettings settings;
    settings.steps = 30;
    settings.tolerance = 1e-8;
    return levenberg(VecX<double>(start), settings, linearized, cost).x;
}

/// Returns the point nearest to the rays through irises of one eye in a frame, and its covariance;
/// nothing for fewer than two cameras that agree, or cameras on a line.
std::optional<IrisPoint> iris_point(const Capture& c, int f, std::size_t e,
                                    const std::vector<SeenIris>& seen) {
    const CaptureFrame& frame = c.frames[static_cast<std::size_t>(f)];
    const Mat3<double> back = so3_exp(Vec3<double>(frame.pose.head<3>())).transpose();
    const auto n = seen.size();
    std::vector<Vec3<double>> from, along;
    for (const SeenIris& s : seen) {
        const Pinhole<double>& camera = c.camera(f, s.camera);
        from.push_back(back * (camera.centre() - frame.pose.tail<3>()) / frame.scale);
        along.push_back(back * camera.ray(s.at));
    }
    IrisPoint p;
    p.frame = f;
    p.eye = e;
    p.at = Vec3<double>::Zero();
    p.gaze = frame.eyes[e].optical;
    std::vector<double> weight(n, 1);
    constexpr int rounds = 5;
    constexpr double far = 3 * of_ray;
    for (int round = 0; round < rounds; ++round) {
        Mat3<double> a = Mat3<double>::Zero();
        Vec3<double> b = Vec3<double>::Zero();
        for (std::size_t i = 0; i < n; ++i) {
            const Mat3<double> across = Mat3<double>::Identity() - along[i] * along[i].transpose();
            const double w = weight[i] * std::pow(seen[i].sharpness / of_ray, 2);
            a += w * across;
            b += w * across * from[i];
        }
        const Eigen::LDLT<Eigen::Matrix3d> solver{Eigen::Matrix3d(a)};
        p.at = solver.solve(b);
        p.covariance = solver.solve(Mat3<double>::Identity());
        for (std::size_t i = 0; i < n; ++i) {
            const Vec3<double> to = p.at - from[i];
            weight[i] =
                std::min(1.0, far / std::max((to - to.dot(along[i]) * along[i]).norm(), 1e-12));
        }
    }
    int near = 0;
    for (const double w : weight) near += w > 0.5 ? 1 : 0;
    constexpr double deepest = 0.03; // standard deviation along the rays
    if (near < 2 || !p.at.allFinite() || !(p.covariance.trace() < deepest * deepest))
        return std::nullopt;
    return p;
}

std::vector<std::array<EyeballInHead, 2>> for_frames(const std::vector<int>& frames,
                                                     const std::array<EyeballInHead, 2>& eyes) {
    return {frames.size(), eyes};
}

/// Puts the eyes, where the aligned pose has them, into a frame.
void put(const std::array<EyeballInHead, 2>& eyes, const CaptureFrame& aligned, CaptureFrame& f) {
    const Mat3<double> r = so3_exp(Vec3<double>(aligned.pose.head<3>()));
    for (std::size_t e = 0; e < 2; ++e) {
        f.eyes[e].centre = aligned.scale * (r * eyes[e].centre) + aligned.pose.tail<3>();
        f.eyes[e].radius = f.scale * eyes[e].radius;
        f.eyes[e].limbus_radius = f.scale * eyes[e].limbus_radius;
        f.eyes[e].iris_plane = f.scale * eyes[e].iris_plane;
    }
    f.has_centres = true;
}

} // namespace

std::optional<SubjectEyes> fit_eyes(const std::vector<IrisPoint>& points,
                                    const std::array<EyeballInHead, 2>& start, GivenGazes given,
                                    double centre_sigma) {
    std::vector<int> frames;
    for (const IrisPoint& p : points) frames.push_back(p.frame);
    std::sort(frames.begin(), frames.end());
    frames.erase(std::unique(frames.begin(), frames.end()), frames.end());
    if (frames.size() < fewest_frames) return std::nullopt;
    Rig x(7);
    x << start[0].centre, start[1].centre, 0.5 * (start[0].iris_plane + start[1].iris_plane);
    const RigResiduals residuals(points, x, given, centre_sigma);
    x = fitted(residuals, x);
    SubjectEyes found;
    found.frames = static_cast<int>(frames.size());
    for (std::size_t e = 0; e < 2; ++e) {
        const double rim = start[e].limbus_radius / start[e].iris_plane * x[6];
        found.eye[e] = {centre_of(x, e), std::hypot(x[6], rim), rim, x[6]};
    }
    for (const IrisPoint& p : points)
        found.off += std::pow((p.at - centre_of(x, p.eye)).norm() - x[6], 2) /
                     static_cast<double>(points.size());
    found.off = std::sqrt(found.off);
    return found;
}

std::array<EyeballInHead, 2> average_eyes(const Capture& capture) {
    // The upper lid covers more of an eye than the lower one, so its centre is above their middle.
    const double radius = EyeballConfig{}.radius;
    std::array<EyeballInHead, 2> eyes;
    for (int e = 0; e < 2; ++e) {
        std::array<std::vector<double>, 3> all;
        for (const int i : capture.train) {
            const CaptureFrame& f = capture.frames[static_cast<std::size_t>(i)];
            const Vec3<double> lids =
                rye::detail::eye_landmark_centre(to_canonical(f, f.landmarks), e);
            for (std::size_t d = 0; d < 3; ++d) all[d].push_back(lids[static_cast<Index>(d)]);
        }
        const Vec3<double> lids(median(all[0]), median(all[1]), median(all[2]));
        const EyeSizes sizes = eye_sizes(CaptureEye{}, 1, radius);
        eyes[static_cast<std::size_t>(e)] = {lids + radius * Vec3<double>(0, 0.13, -0.88), radius,
                                             sizes.limbus_radius, sizes.iris_plane};
    }
    return eyes;
}

double rim_of_iris(const Capture& capture, const std::vector<int>& frames,
                   const std::vector<std::array<EyeballInHead, 2>>& balls) {
    constexpr int count = 7;
    constexpr double least = 0.36, step = 0.06;
    std::array<double, count> explained{};
    for (int i = 0; i < count; ++i) {
        std::vector<std::array<EyeballInHead, 2>> changed = balls;
        for (std::array<EyeballInHead, 2>& both : changed)
            for (EyeballInHead& ball : both)
                ball.limbus_radius = (least + i * step) * ball.iris_plane;
        for (const auto& both : seen_irises(capture, frames, changed))
            for (const std::vector<SeenIris>& irises : both)
                for (const SeenIris& s : irises)
                    explained[static_cast<std::size_t>(i)] += s.sharpness * s.contrast;
    }
    const auto most = std::max_element(explained.begin(), explained.end());
    if (*most <= 0) return 0;
    const auto i = most - explained.begin();
    double between = 0; // of a parabola through the neighbours
    if (i > 0 && i + 1 < count) {
        const double a = *(most - 1), b = *most, c = *(most + 1), bend = a - 2 * b + c;
        if (bend < 0) between = 0.5 * (a - c) / bend;
    }
    return least + (static_cast<double>(i) + between) * step;
}

std::string SubjectEyes::text() const {
    return "eyeballs' centres and sizes, one pair for all frames, from " + std::to_string(irises) +
           " irises of " + std::to_string(frames) + " training frames: the middles of irises are " +
           factor_text(eye[0].iris_plane) + " units from the centres, to " + factor_text(off) +
           ", and their rims have a radius of " + factor_text(eye[0].limbus_radius);
}

double measure_iris(Capture& capture) {
    std::array<Vec3<double>, 2> centre{Vec3<double>::Zero(), Vec3<double>::Zero()};
    for (const int i : capture.train)
        for (std::size_t e = 0; e < 2; ++e) {
            const CaptureFrame& f = capture.frames[static_cast<std::size_t>(i)];
            centre[e] += Vec3<double>(to_canonical(f, *f.eyes[e].centre)) /
                         static_cast<double>(capture.train.size());
        }
    double rim = 0;
    constexpr int rounds = 2;
    for (int round = 0; round < rounds; ++round) {
        std::vector<std::array<EyeballInHead, 2>> balls;
        for (const int i : capture.train) {
            const CaptureFrame& f = capture.frames[static_cast<std::size_t>(i)];
            balls.emplace_back();
            for (std::size_t e = 0; e < 2; ++e) {
                const EyeSizes s = eye_sizes(f.eyes[e], f.scale, EyeballConfig{}.radius);
                balls.back()[e] = {centre[e], s.radius, s.limbus_radius, s.iris_plane};
            }
        }
        rim = rim_of_iris(capture, capture.train, balls);
        if (rim <= 0) return 0;
        // The rim lies on the eyeball.
        const double plane = 1 / std::hypot(1, rim);
        for (CaptureFrame& f : capture.frames)
            for (CaptureEye& eye : f.eyes) {
                eye.iris_plane = plane * *eye.radius;
                eye.limbus_radius = rim * plane * *eye.radius;
            }
    }
    return rim / std::hypot(1, rim);
}

std::optional<SubjectEyes> place_eyes(Capture& capture, GivenGazes given,
                                      const std::optional<std::array<EyeballInHead, 2>>& start) {
    const std::vector<CaptureFrame> before = capture.frames;
    for (CaptureFrame& f : capture.frames) {
        for (CaptureEye& eye : f.eyes) {
            eye.centre.reset(); // so that poses and landmarks alone are corrected
            if (given == GivenGazes::none) eye.optical = Vec3<double>::UnitZ();
        }
        f.has_centres = false;
    }
    correct_labels(capture, preset("cpu"));
    const std::array<EyeballInHead, 2> first = start ? *start : average_eyes(capture);
    std::array<EyeballInHead, 2> eyes = first;
    std::optional<SubjectEyes> found;
    constexpr int rounds = 4;
    for (int round = 0; round < rounds; ++round) {
        if (round == 0 || round + 1 == rounds)
            if (const double rim =
                    rim_of_iris(capture, capture.train, for_frames(capture.train, eyes));
                rim > 0)
                for (EyeballInHead& eye : eyes) eye.limbus_radius = rim * eye.iris_plane;
        std::vector<IrisPoint> points;
        int irises = 0;
        const auto seen = seen_irises(capture, capture.train, for_frames(capture.train, eyes));
        for (std::size_t i = 0; i < seen.size(); ++i)
            for (std::size_t e = 0; e < 2; ++e)
                if (auto p = iris_point(capture, capture.train[i], e, seen[i][e])) {
                    points.push_back(*p);
                    irises += static_cast<int>(seen[i][e].size());
                }
        std::array<EyeballInHead, 2> prior = first;
        for (std::size_t e = 0; e < 2; ++e)
            prior[e].limbus_radius =
                eyes[e].limbus_radius / eyes[e].iris_plane * first[e].iris_plane;
        constexpr double of_labels = 0.03, of_lids = 0.02;
        found = fit_eyes(points, prior, given, given == GivenGazes::labels ? of_labels : of_lids);
        if (!found) break;
        found->irises = irises;
        eyes = found->eye;
    }
    std::vector<int> all(before.size());
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = static_cast<int>(i);
    std::vector<std::array<SeenGaze, 2>> gazes;
    if (found && given == GivenGazes::none) gazes = seen_gazes(capture, all, for_frames(all, eyes));
    for (std::size_t i = 0; i < before.size(); ++i) {
        CaptureFrame f = before[i];
        if (found) put(eyes, capture.frames[i], f);
        for (std::size_t e = 0; e < 2; ++e) {
            if (gazes.empty() || gazes[i][e].views == 0) continue;
            f.eyes[e].optical = gaze_vector(gazes[i][e].angles[0], gazes[i][e].angles[1]);
            ++found->gazes;
            found->views += gazes[i][e].views;
        }
        capture.frames[i] = std::move(f);
    }
    return found;
}

} // namespace rye::trainer
