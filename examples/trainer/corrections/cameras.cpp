// SPDX-License-Identifier: Apache-2.0
#include "corrections/cameras.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <optional>

#include <Eigen/Cholesky>

#include <rye/math/rotation.hpp>

#include "corrections/camera_fit.hpp"
#include "corrections/centre_errors.hpp"
#include "corrections/seen_gazes.hpp"
#include "corrections/skin_positions.hpp"
#include "data/corrected_cameras.hpp"
#include "data/degrees.hpp"
#include "data/median.hpp"
#include "data/samples.hpp"
#include "data/threads.hpp"
#include "model/draws.hpp"

namespace rye::trainer {
namespace {

/// Bound on CameraFinding::off [mm]. The correct cameras of six rendered heads, of rye's own, ICT's
/// and MakeHuman's, seem off by up to 0.8 mm, and by 1.1 with wrong poses and landmarks.
constexpr double bound_mm = 1.5;
constexpr std::size_t fewest_frames = 6;
constexpr int fewest_eyes = 6; ///< in a camera's pictures
constexpr double fewest_facing = 0.7; ///< cosine: irises that are seen more from the side mislead
/// Distance by which irises seem nearer to the eyeball's centre, in its radii, seen from many sides:
/// the cornea refracts, and turns them towards each camera. Chosen on four rendered heads.
constexpr double seems_nearer = 0.04;

/// Correction of the cameras of one capture.
class CameraCorrector {
  public:
    CameraCorrector(Capture& capture, const TrainConfig& config) : c_(capture), config_(config) {
        found_.bound = bound_mm;
        if (!can_judge()) return;
        choose_frames();
        if (judged_.empty()) return;
        see_masks();
        priors_.loose = 0.03; // of masks, whose middle is elsewhere in the head, and of the skin
        priors_.first_loose = lids_.cols();
        // Masks bring irises close to where they are searched, then irises refine the fit.
        CameraFit fit = fit_cameras(cameras_, lids_, masks_, of_masks());
        constexpr int rounds = 2;
        for (int round = 0; round < rounds; ++round) {
            put(fit.changes);
            fit = by_irises();
        }
        fit = by_skin(std::move(fit));
        put(std::vector<CameraChange>(cameras_.size()));
        judge(fit);
    }
    CameraFindings take() { return std::move(found_); }

  private:
    const CaptureFrame& frame(std::size_t i) const {
        return c_.frames[static_cast<std::size_t>(frames_[i])];
    }
    static int point(std::size_t i, std::size_t e) { return static_cast<int>(2 * i + e); }
    std::size_t view_of(int f, std::size_t camera) const {
        return static_cast<std::size_t>(f) * static_cast<std::size_t>(c_.camera_count()) + camera;
    }

    bool can_judge() {
        if (c_.train.size() < fewest_frames)
            found_.not_judged.push_back("cameras: " + std::to_string(c_.train.size()) +
                                        " training frames say too little about them, " +
                                        std::to_string(fewest_frames) + " are needed");
        else if (!c_.has_eye_masks || !c_.has_centres() || !config_.measured_eyes)
            found_.not_judged.push_back("cameras: the pictures tell of them where the capture has "
                                        "eye masks and eyeball centres");
        return found_.not_judged.empty();
    }

    /// Chooses training frames, evenly, and the cameras whose numbers are the same in all of them.
    void choose_frames() {
        constexpr std::size_t most = 32; // the unknowns of one least-squares problem are few
        const std::size_t n = c_.train.size(), taken = std::min(n, most);
        for (std::size_t i = 0; i < taken; ++i) frames_.push_back(c_.train[i * n / taken]);
        for (int k = 0; k < c_.camera_count(); ++k) {
            std::optional<Pinhole<double>> first;
            bool moves = false;
            for (const int f : c_.train) {
                if (!c_.view(f, k).present) continue;
                if (first && !same_numbers(*first, c_.camera(f, k))) moves = true;
                if (!first) first = c_.camera(f, k);
            }
            const auto camera = static_cast<std::size_t>(k);
            if (moves)
                found_.not_judged.push_back("camera " + c_.camera_ids[camera] +
                                            ": its numbers differ between training frames");
            if (moves || !first) continue;
            judged_.push_back(camera);
            cameras_.push_back(*first);
        }
    }

    /// Puts changed cameras into the chosen frames; cameras without a change keep their bits.
    void put(const std::vector<CameraChange>& changes) {
        for (std::size_t k = 0; k < judged_.size(); ++k) {
            const CameraChange& by = changes[k];
            const bool none = by.turn.isZero(0) && by.shift.isZero(0) && by.log_focal == 0;
            const Pinhole<double> camera = none ? cameras_[k] : changed(cameras_[k], by);
            for (const int f : frames_)
                if (CaptureView& view = c_.views[view_of(f, judged_[k])]; view.present)
                    view.camera = camera;
        }
    }

    /// Finds the middles of lids, and of the eyes in the masks.
    void see_masks() {
        lids_.resize(3, 2 * static_cast<Index>(frames_.size()));
        std::vector<std::vector<SeenPoint>> seen(frames_.size());
        program_threads().run(static_cast<Index>(frames_.size()), [&](Index frame_number) {
            const auto i = static_cast<std::size_t>(frame_number);
            for (std::size_t e = 0; e < 2; ++e) {
                Vec3<double> middle = Vec3<double>::Zero();
                for (const int l : eye_landmarks(static_cast<int>(e)))
                    middle += frame(i).landmarks.col(l) / 6;
                lids_.col(point(i, e)) = middle;
            }
            for (std::size_t k = 0; k < judged_.size(); ++k) {
                const CaptureView& view = c_.views[view_of(frames_[i], judged_[k])];
                if (!view.present || view.eye_mask.empty()) continue;
                const Image<float> mask = c_.eye_mask(frames_[i], static_cast<int>(judged_[k]));
                for (std::size_t e = 0; e < 2; ++e)
                    if (const auto middle = see_mask(i, k, e, mask)) seen[i].push_back(*middle);
            }
        });
        for (const std::vector<SeenPoint>& s : seen) masks_.insert(masks_.end(), s.begin(), s.end());
    }
    std::optional<SeenPoint> see_mask(std::size_t i, std::size_t k, std::size_t e,
                                      const Image<float>& mask) const {
        Vec2<double> sum = Vec2<double>::Zero();
        int count = 0;
        for (int y = 0; y < mask.height; ++y)
            for (int x = 0; x < mask.width; ++x)
                if (mask.at(x, y)[static_cast<Index>(e)] >= 0.5F) {
                    sum += Vec2<double>(x + 0.5, y + 0.5);
                    ++count;
                }
        if (count < min_eye_pixels) return std::nullopt;
        std::array<Vec2<double>, 6> at;
        const auto lids = eye_landmarks(static_cast<int>(e));
        for (std::size_t l = 0; l < 6; ++l)
            at[l] = cameras_[k]
                        .project_point(Vec3<double>(frame(i).landmarks.col(lids[l])))
                        .head<2>();
        double area = 0;
        for (std::size_t l = 0; l < 6; ++l) {
            const Vec2<double>&a = at[l], &b = at[(l + 1) % 6];
            area += (a.x() * b.y() - a.y() * b.x()) / 2;
        }
        // The middle is elsewhere for closed eyes and eyes that the nose partly hides.
        const double shown = count / std::max(1.0, std::abs(area));
        if (shown < 0.5 || shown > 2) return std::nullopt;
        constexpr double off = 0.3; // times the eye's width: masks say little compared with irises
        return SeenPoint{static_cast<int>(k), point(i, e), sum / count,
                         std::max(0.5, off * (at[3] - at[0]).norm())};
    }
    static CameraPriors of_masks() {
        CameraPriors priors;
        priors.point = 0.02; // the middle of the lids is not that of the visible eye
        return priors;
    }

    /// Returns the fit to masks and to irises, which are searched with the current cameras.
    CameraFit by_irises() {
        const Index eyes = lids_.cols();
        std::vector<std::array<EyeballInHead, 2>> balls(frames_.size());
        Columns<double> points(3, 2 * eyes);
        for (std::size_t i = 0; i < frames_.size(); ++i)
            for (std::size_t e = 0; e < 2; ++e) {
                const CaptureFrame& f = frame(i);
                const CaptureEye& eye = f.eyes[e];
                const EyeSizes s = eye_sizes(eye, f.scale, config_.gaussians.eyeball.radius);
                balls[i][e] = {Vec3<double>(to_canonical(f, *eye.centre)), s.radius,
                               s.limbus_radius, s.iris_plane};
                const Mat3<double> rotation = so3_exp(Vec3<double>(f.pose.head<3>()));
                points.col(point(i, e)) =
                    *eye.centre +
                    f.scale * (s.iris_plane - seems_nearer * s.radius) * (rotation * eye.optical);
            }
        points.rightCols(eyes) = lids_;
        std::vector<int> index(static_cast<std::size_t>(c_.camera_count()), -1);
        for (std::size_t k = 0; k < judged_.size(); ++k) index[judged_[k]] = static_cast<int>(k);
        const auto irises = seen_irises(c_, frames_, balls);
        seen_.clear();
        for (std::size_t i = 0; i < frames_.size(); ++i)
            for (std::size_t e = 0; e < 2; ++e)
                for (const SeenIris& s : irises[i][e]) {
                    constexpr double off = 0.03; // error of a sharp iris, times its edge
                    const int k = index[static_cast<std::size_t>(s.camera)];
                    if (k >= 0 && facing(i, e, cameras_[static_cast<std::size_t>(k)]) > fewest_facing)
                        seen_.push_back({k, point(i, e), s.at, off * s.edge / s.sharpness});
                }
        irises_ = seen_.size();
        for (SeenPoint mask : masks_) {
            mask.point += static_cast<int>(eyes);
            seen_.push_back(mask);
        }
        skin_ = seen_.size();
        points_ = points;
        CameraFit fit = fit_cameras(cameras_, points_, seen_, priors_);
        priors_.point = errors_of_labels(fit);
        return fit;
    }
    /// Returns the standard deviation of a coordinate of the irises' offsets in the head about each
    /// eye's mean [world unit]: they are errors of labels, and those say how much of what all
    /// cameras share is in the cameras.
    double errors_of_labels(const CameraFit& fit) const {
        constexpr double least = 0.003, most = 0.015; // [world unit]
        Columns<double> offsets(3, lids_.cols()), mean = Columns<double>::Zero(3, 2);
        for (Index p = 0; p < offsets.cols(); ++p) {
            const CaptureFrame& f = frame(static_cast<std::size_t>(p / 2));
            offsets.col(p) = so3_exp(Vec3<double>(f.pose.head<3>())).transpose() * fit.offsets.col(p);
            mean.col(p % 2) += 2 * offsets.col(p) / static_cast<double>(offsets.cols());
        }
        for (Index p = 0; p < offsets.cols(); ++p) offsets.col(p) -= mean.col(p % 2);
        return std::clamp(std::sqrt(offsets.squaredNorm() / static_cast<double>(offsets.size())),
                          least, most);
    }
    /// Returns the cosine of the angle between an eye's optical axis and the line to a camera.
    double facing(std::size_t i, std::size_t e, const Pinhole<double>& camera) const {
        const CaptureFrame& f = frame(i);
        const Vec3<double> axis = so3_exp(Vec3<double>(f.pose.head<3>())) * f.eyes[e].optical;
        return axis.dot((camera.centre() - *f.eyes[e].centre).normalized());
    }

    /// Returns the fit to masks, irises and the skin, which is compared with other cameras' pictures
    /// by the current fit.
    CameraFit by_skin(CameraFit fit) {
        constexpr std::size_t fewest_cameras = 3;
        if (cameras_.size() < fewest_cameras || irises_ < frames_.size()) return fit;
        const Vec3<double> head = describe_subject(c_, config_).head_centre;
        const SkinPositions skin(c_, frames_, judged_, head);
        const std::size_t eyes = skin_ = seen_.size();
        Columns<double> points(3, points_.cols() + skin.landmarks().cols());
        points << points_, skin.landmarks();
        const auto compare = [&](const SkinPositions& by, int rounds) {
            for (int round = 0; round < rounds; ++round) {
                std::vector<Pinhole<double>> now;
                for (std::size_t k = 0; k < cameras_.size(); ++k)
                    now.push_back(changed(cameras_[k], fit.changes[k]));
                seen_.resize(eyes);
                for (SeenPoint s : by.seen(now)) {
                    s.point += static_cast<int>(points_.cols());
                    seen_.push_back(s);
                }
                fit = fit_cameras(cameras_, points, seen_, priors_);
            }
        };
        compare(skin, 4);
        std::vector<bool> worse = skin_worse(skin, fit);
        if (std::find(worse.begin(), worse.end(), true) != worse.end()) { // too far off for it
            for (const int small : {64, 128})
                compare(SkinPositions(c_, frames_, judged_, head, small), 2);
            compare(skin, 4);
            worse = skin_worse(skin, fit);
        }
        const auto misled = [&](const SeenPoint& s) {
            return s.point >= static_cast<int>(points_.cols()) &&
                   worse[static_cast<std::size_t>(s.camera)];
        };
        if (std::none_of(seen_.begin(), seen_.end(), misled)) return fit;
        seen_.erase(std::remove_if(seen_.begin(), seen_.end(), misled), seen_.end());
        fit = fit_cameras(cameras_, points, seen_, priors_);
        for (std::size_t k = 0; k < worse.size(); ++k)
            if (worse[k] && irises_of(static_cast<int>(k)) < fewest_eyes) fit.changes[k] = {};
        return fit;
    }
    int irises_of(int camera) const {
        return static_cast<int>(
            std::count_if(seen_.begin(), seen_.begin() + static_cast<std::ptrdiff_t>(irises_),
                          [&](const SeenPoint& s) { return s.camera == camera; }));
    }
    /// Returns true for cameras whose skin does not look clearly more like that of the others by
    /// the fit than by the capture's numbers, though the fit moves it: its comparison was misled,
    /// as by hair.
    std::vector<bool> skin_worse(const SkinPositions& skin, const CameraFit& fit) const {
        constexpr double clearly = 0.9;
        std::vector<Pinhole<double>> now;
        for (std::size_t k = 0; k < cameras_.size(); ++k)
            now.push_back(changed(cameras_[k], fit.changes[k]));
        const std::vector<double> after = skin.differences(now);
        std::vector<bool> worse(cameras_.size(), false);
        for (std::size_t k = 0; k < cameras_.size(); ++k) {
            CameraFinding moved;
            displacement(k, now[k], moved);
            if (moved.off <= bound_mm) continue;
            std::vector<Pinhole<double>> but_one = now;
            but_one[k] = cameras_[k];
            const double before = skin.differences(but_one)[k];
            worse[k] = before > 0 && after[k] > clearly * before;
        }
        return worse;
    }

    void judge(const CameraFit& fit) {
        if (irises_ < frames_.size()) {
            found_.not_judged.push_back("cameras: too few irises are seen");
            return;
        }
        std::vector<CorrectedCamera> wrong;
        for (std::size_t k = 0; k < judged_.size(); ++k) {
            CameraFinding f;
            f.camera = c_.camera_ids[judged_[k]];
            // Of irises and of the skin.
            std::array<std::vector<double>, 2> before, after;
            int masks = 0;
            for (std::size_t s = 0; s < seen_.size(); ++s) {
                if (seen_[s].camera != static_cast<int>(k)) continue;
                if (s >= irises_ && s < skin_) {
                    ++masks;
                    continue;
                }
                before[s < irises_ ? 0 : 1].push_back(fit.before[s]);
                after[s < irises_ ? 0 : 1].push_back(fit.after[s]);
            }
            f.irises = static_cast<int>(before[0].size());
            const bool skin = !before[1].empty();
            if (const int eyes = std::max(f.irises, masks); eyes < fewest_eyes && !skin) {
                found_.not_judged.push_back("camera " + f.camera + ": its pictures show " +
                                            std::to_string(eyes) + " eyes, " +
                                            std::to_string(fewest_eyes) + " are needed");
                continue;
            }
            const CameraChange& by = fit.changes[k];
            const Pinhole<double> right = changed(cameras_[k], by);
            const std::size_t by_what = f.irises >= fewest_eyes || !skin ? 0 : 1;
            f.by_skin = by_what == 1;
            f.before = median(before[by_what]);
            f.after = median(after[by_what]);
            f.turn = by.turn.norm() / degree;
            f.shift = mm_per_unit * by.shift.norm();
            f.focal = 100 * (std::exp(by.log_focal) - 1);
            displacement(k, right, f);
            f.wrong = f.off > found_.bound;
            if (f.wrong) wrong.push_back({f.camera, cameras_[k], right});
            found_.all.push_back(f);
        }
        if (const double labels = common_offset(fit); !wrong.empty() && labels > 0) {
            char text[120];
            std::snprintf(text, sizeof text,
                          "cameras: all of them show the eyes %.1f mm off in the head alike, as "
                          "labels would that are off; none is changed",
                          labels);
            found_.not_judged.push_back(text);
            for (CameraFinding& f : found_.all) f.wrong = false;
            return;
        }
        take_corrected(c_, wrong);
    }
    /// Returns the length of the one offset in the head, of both eyes in all frames, that explains
    /// to within the bound where all cameras show the eyes [mm]; 0 if none does. The labels have
    /// it, or its source cannot be told.
    double common_offset(const CameraFit& fit) const {
        Mat3<double> squares = Mat3<double>::Zero();
        Vec3<double> sum = Vec3<double>::Zero(), offset = sum;
        std::vector<double> rest(judged_.size());
        for (const bool solved : {false, true}) {
            for (std::size_t k = 0; k < judged_.size(); ++k)
                for (Index p = 0; p < lids_.cols(); ++p) {
                    const Vec3<double> x = lids_.col(p), is = cameras_[k].project_point(x),
                                       seen = changed(cameras_[k], fit.changes[k]).project_point(x);
                    const CaptureFrame& f = frame(static_cast<std::size_t>(p / 2));
                    const Mat3<double> rotation = cameras_[k].camera_from_world.rotation *
                                                  so3_exp(Vec3<double>(f.pose.head<3>()));
                    const Mat<double, 2, 3> across = rotation.topRows<2>();
                    const Vec2<double> off = (seen - is).head<2>() * (is.z() / cameras_[k].fx);
                    squares += across.transpose() * across;
                    sum += across.transpose() * off;
                    if (solved)
                        rest[k] += (off - across * offset).squaredNorm() /
                                   static_cast<double>(lids_.cols());
                }
            if (!solved) offset = squares.ldlt().solve(sum);
        }
        const double worst = mm_per_unit * std::sqrt(*std::max_element(rest.begin(), rest.end()));
        const double length = mm_per_unit * offset.norm();
        return worst <= found_.bound && length > found_.bound / 2 ? length : 0;
    }
    /// Computes the root mean square distance between the landmarks as two cameras show them.
    void displacement(std::size_t k, const Pinhole<double>& right, CameraFinding& f) const {
        double pixels = 0, lengths = 0, count = 0;
        for (const int i : frames_) {
            const Columns<double> world = frame_landmarks(c_, i);
            for (Index l = 0; l < world.cols(); ++l) {
                const Vec3<double> x = world.col(l), a = cameras_[k].project_point(x),
                                   b = right.project_point(x);
                const double apart = (a - b).head<2>().norm();
                pixels += apart * apart;
                lengths += std::pow(mm_per_unit * apart * b.z() / right.fx, 2);
                ++count;
            }
        }
        f.pixels = std::sqrt(pixels / count);
        f.off = std::sqrt(lengths / count);
    }

    Capture& c_;
    const TrainConfig& config_;
    std::vector<int> frames_;
    std::vector<std::size_t> judged_;      ///< indices of cameras
    std::vector<Pinhole<double>> cameras_; ///< judged_ cameras, as they are in training frames
    Columns<double> lids_;                 ///< middles of lids, 3 x (2 per frame)
    std::vector<SeenPoint> masks_;         ///< middles of eyes in masks
    std::vector<SeenPoint> seen_;          ///< irises, masks, then points of the skin
    Columns<double> points_;               ///< of seen_, world
    std::size_t irises_ = 0, skin_ = 0;    ///< numbers of irises, and of these and masks
    CameraPriors priors_;
    CameraFindings found_;
};

template <class... Numbers>
std::string text(const char* format, Numbers... numbers) {
    char out[160];
    std::snprintf(out, sizeof out, format, numbers...);
    return out;
}

} // namespace

std::vector<std::string> CameraFindings::lines() const {
    std::vector<std::string> out;
    std::size_t right = 0;
    for (const CameraFinding& f : all) {
        right += f.off <= bound_mm ? 1 : 0;
        if (!f.wrong) continue;
        out.push_back("camera " + f.camera +
                      text(": %.2f deg, %.1f mm, focal %+.1f %%; shows the head %.1f px off, its "
                           "%s %.1f px, then %.1f px: corrected",
                           f.turn, f.shift, f.focal, f.pixels, f.by_skin ? "skin" : "irises",
                           f.before, f.after));
    }
    if (!all.empty())
        out.push_back("cameras: " + std::to_string(right) + " of " + std::to_string(all.size()) +
                      text(" show the head within %.2g mm of where labels say", bound_mm));
    out.insert(out.end(), not_judged.begin(), not_judged.end());
    return out;
}

nlohmann::ordered_json CameraFindings::json() const {
    nlohmann::ordered_json cameras = nlohmann::ordered_json::array();
    for (const CameraFinding& f : all)
        cameras.push_back({{"camera", f.camera}, {"off_mm", f.off}, {"off_px", f.pixels},
                           {"wrong", f.wrong}, {"irises", f.irises}, {"before_px", f.before},
                           {"after_px", f.after}, {"turn_deg", f.turn}, {"shift_mm", f.shift},
                           {"focal_percent", f.focal}});
    return {{"bound_mm", bound_mm}, {"cameras", cameras}, {"not_judged", not_judged}};
}

CameraFindings correct_cameras(Capture& capture, const TrainConfig& config) {
    return CameraCorrector(capture, config).take();
}

std::string refine_further(const CameraFindings& findings, const Capture& capture,
                           TrainConfig& config) {
    const bool wrong = std::any_of(findings.all.begin(), findings.all.end(),
                                   [](const CameraFinding& f) { return f.wrong; });
    AvatarRates& rates = config.gaussians.rates;
    if (!wrong || rates.delta_view > 0 || config.gaze_mechanism != GazeMechanismName::rotation)
        return {};
    // Before the head has its shape, cameras would take the errors of that.
    constexpr double rate = 1e-4, share = 0.3;
    rates.delta_view = rate;
    rates.delta_view_from =
        static_cast<int>(share * static_cast<double>(total_steps(config.gaussians, capture)));
    return "stage 2 goes on refining the poses of cameras";
}

std::vector<CorrectedCamera> trained_cameras(const Capture& capture,
                                             const Columns<float>& delta_view) {
    if (delta_view.size() == 0) return capture.corrected_cameras;
    std::vector<CorrectedCamera> all;
    const auto of_picture = [&](int f, int k) {
        const Pinhole<double> now = capture.camera(f, k);
        const std::string& name = capture.camera_ids[static_cast<std::size_t>(k)];
        CorrectedCamera c{name, now, now};
        for (const CorrectedCamera& before : capture.corrected_cameras)
            if (before.camera == name && same_numbers(before.right, now)) c.wrong = before.wrong;
        const auto same = [&](const CorrectedCamera& a) {
            return a.camera == name && same_numbers(a.wrong, c.wrong);
        };
        if (std::any_of(all.begin(), all.end(), same)) return;
        c.right = seen_camera<double>(now, delta_view.col(k).cast<double>(),
                                      seen_by(capture, k).pivot.cast<double>());
        all.push_back(c);
    };
    for (int k = 0; k < capture.camera_count(); ++k)
        for (const int f : capture.train)
            if (capture.view(f, k).present) of_picture(f, k);
    return all;
}

} // namespace rye::trainer
