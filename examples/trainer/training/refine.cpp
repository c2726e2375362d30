// SPDX-License-Identifier: Apache-2.0
#include "training/refine.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>

#include <rye/avatar/drawn_size.hpp>
#include <rye/avatar/hold.hpp>
#include <rye/train/host_label_drawing.hpp>

#include "corrections/gaze_mean.hpp"
#include "data/degrees.hpp"
#include "data/median.hpp"
#include "data/samples.hpp"
#include "drawing/playable.hpp"
#include "model/types.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;

/// Returns the mask widened by `reach` pixels.
Columns<float> widened(const Image<float>& mask, int reach) {
    Columns<float> out(1, mask.size());
    for (int y = 0; y < mask.height; ++y)
        for (int x = 0; x < mask.width; ++x) {
            float most = 0;
            for (int v = std::max(0, y - reach); v <= std::min(mask.height - 1, y + reach); ++v)
                for (int u = std::max(0, x - reach); u <= std::min(mask.width - 1, x + reach); ++u)
                    most = std::max(most, mask.at(u, v)(0));
            out(0, static_cast<Index>(y) * mask.width + x) = most;
        }
    return out;
}

/// Returns a photograph, averaged over blocks, on white, with weights for the head and the pixels
/// beside it.
LabelView<float> label_view(const Capture& capture, int frame, int camera, int block) {
    constexpr int beside = 2; // [px]
    LabelView<float> v;
    v.camera = reduced(capture.camera(frame, camera).cast<float>(), block);
    const Image<float> mask = extended(capture.mask(frame, camera), block);
    v.truth =
        shrunk(on_background(extended(capture.image(frame, camera), block), mask, 1.0F), block)
            .pixels;
    const Image<float> visible = extended(capture.visible(frame, camera), block, Border::zero);
    v.weight = widened(shrunk(mask, block), beside)
                   .cwiseProduct(shrunk(visible, block).pixels);
    return v;
}

/// The inputs of refine_frames.
struct FramesToRefine {
    GazeAxis axis;
    const Capture& capture;
    const std::vector<int>& frames;
    const RefineOptions& options;
    const std::function<void(const RefinedFrame&)>& told;
};

/// Refines frames by these pictures of the avatar.
template <LabelDrawing D>
void refine_frames(RefinedCapture& r, D& drawing, const FramesToRefine& of) {
    const Capture& capture = of.capture;
    LabelRefiner refiner(train_backend().threads, drawing, r.unknowns, of.options.settings);
    for (const int f : of.frames) {
        RefinedFrame one;
        one.frame = f;
        std::vector<LabelView<float>> views;
        for (int c = 0; c < capture.camera_count(); ++c)
            if (capture.view(f, c).present) views.push_back(label_view(capture, f, c, r.block));
        one.views = static_cast<int>(views.size());
        try {
            one.found = refiner.refine(
                restricted<TrainedEffects>(frame_drivers(capture, f, of.axis)), views);
        } catch (const Error& e) {
            throw Error(capture.folder.string() + ": frame '" +
                        capture.frames[static_cast<std::size_t>(f)].id + "': " + e.what());
        }
        r.frames.push_back(std::move(one));
        if (of.told) of.told(r.frames.back());
    }
}

/// Marks frames whose residual exceeds the median by three deviations and by a quarter of it.
void mark_outliers(std::vector<RefinedFrame>& frames) {
    std::vector<double> residuals, apart;
    for (const RefinedFrame& f : frames) residuals.push_back(f.found.residual);
    const double middle = median(residuals);
    for (const double r : residuals) apart.push_back(std::abs(r - middle));
    const double far = std::max(0.25 * middle, 3 * 1.4826 * median(apart));
    for (RefinedFrame& f : frames) f.outlier = f.found.residual > middle + far;
}

/// Marks eyes of which all pictures of a frame show less than a tenth of what they show in the
/// median.
void mark_closed(std::vector<RefinedFrame>& frames, const Capture& capture) {
    if (!capture.has_eye_masks) return;
    std::vector<std::array<double, 2>> seen;
    for (const RefinedFrame& f : frames) {
        seen.push_back({});
        for (int c = 0; c < capture.camera_count(); ++c) {
            const CaptureView& view = capture.view(f.frame, c);
            if (!view.present || view.eye_mask.empty()) continue;
            const Image<float> eyes = capture.eye_mask(f.frame, c);
            for (std::size_t e = 0; e < 2; ++e)
                seen.back()[e] += static_cast<double>(eyes.pixels.row(static_cast<Index>(e)).sum());
        }
    }
    for (std::size_t e = 0; e < 2; ++e) {
        std::vector<double> all;
        for (const auto& s : seen) all.push_back(s[e]);
        const double usual = median(all);
        for (std::size_t i = 0; i < frames.size(); ++i)
            frames[i].closed[e] = seen[i][e] < 0.1 * usual;
    }
}

/// Mean change of some unknowns over frames, and the variance of that mean, itself their mean.
struct MeanChange {
    VecX<double> mean;
    double variance;
};
/// Returns the mean change of `count` unknowns from `at` on, in the frames that are `counted`;
/// nothing of less than two.
std::optional<MeanChange> mean_change(const std::vector<RefinedFrame>& frames, Index at, Index count,
                                      const std::function<bool(const RefinedFrame&)>& counted) {
    MeanChange m{VecX<double>::Zero(count), 0};
    double n = 0;
    for (const RefinedFrame& f : frames)
        if (counted(f)) m.mean += f.found.change.segment(at, count), ++n;
    if (n < 2) return std::nullopt;
    m.mean /= n;
    for (const RefinedFrame& f : frames)
        if (counted(f)) m.variance += (f.found.change.segment(at, count) - m.mean).squaredNorm();
    m.variance /= static_cast<double>(count) * (n - 1) * n;
    return m;
}

/// Subtracts from the frames what their mean change does not say of the labels: of gazes the rest
/// is the avatar's kappa, or its own labels' mean; that of poses is the head's frame. Ignores
/// outliers. For a single frame the mean would be all of it. Closed eyes get the mean of the
/// others.
VecX<double> take_mean(RefinedCapture& refined, const RefineOptions& options) {
    const LabelUnknowns& u = refined.unknowns;
    VecX<double> taken = VecX<double>::Zero(u.count());
    for (Index e = 0; e < u.gaze_count() / 2; ++e) {
        const auto shut = [e](const RefinedFrame& f) { return f.closed[static_cast<std::size_t>(e)]; };
        const auto m = mean_change(refined.frames, 2 * e, 2,
                                   [&](const RefinedFrame& f) { return !f.outlier && !shut(f); });
        for (RefinedFrame& f : refined.frames)
            if (shut(f)) {
                f.found.change.segment<2>(2 * e) = m ? m->mean : VecX<double>::Zero(2);
                f.found.sigma.segment<2>(2 * e).setConstant(u.gaze_sigma);
            }
        if (!m || options.keep_gaze_mean) continue;
        taken.segment<2>(2 * e) =
            m->mean - mean_error_of_labels(Vec2<double>(m->mean), m->variance);
    }
    if (u.pose && !options.keep_pose_mean)
        if (const auto m = mean_change(refined.frames, u.gaze_count(), u.pose_count(),
                                       [](const RefinedFrame& f) { return !f.outlier; }))
            taken.segment(u.gaze_count(), u.pose_count()) = m->mean;
    for (RefinedFrame& f : refined.frames) f.found.change -= taken;
    return taken;
}

Json numbers(const VecX<double>& v, double unit) {
    Json list = Json::array();
    for (Index i = 0; i < v.size(); ++i) list.push_back(v[i] * unit);
    return list;
}

/// Returns the parts of a vector of unknowns, by name and in readable units.
Json parts_of(const LabelUnknowns& u, const VecX<double>& v) {
    Json parts = Json::object();
    if (u.gaze) {
        parts["gaze_left"] = numbers(v.head(2), degrees);
        parts["gaze_right"] = numbers(v.segment(2, 2), degrees);
    }
    if (u.pose) {
        parts["rotation"] = numbers(v.segment(u.gaze_count(), 3), degrees);
        parts["translation"] = numbers(v.segment(u.gaze_count() + 3, 3), 1);
    }
    if (!u.expression.empty())
        parts["expression"] = numbers(v.tail(static_cast<Index>(u.expression.size())), 1);
    return parts;
}

} // namespace

PlayableAvatar<float> refined_avatar(const TrainState& drawn, const Capture& capture) {
    const int frame = capture.train.empty() ? 0 : capture.train.front();
    PlayableAvatar<float> p = playable_avatar(drawn, capture, frame, 0);
    p.avatar.eyes.optics = {}; // views of one moment see highlights and refraction elsewhere
    return p;
}

std::vector<Index> refined_coefficients(const Capture& capture, RefinedExpression which) {
    std::vector<Index> chosen;
    if (which == RefinedExpression::none) return chosen;
    for (int k = 0; k < capture.expression_width(); ++k) {
        const auto of = [k](const CaptureFrame& f) {
            return f.expression[static_cast<std::size_t>(k)];
        };
        const float first = of(capture.frames.front());
        if (which == RefinedExpression::all ||
            std::any_of(capture.frames.begin(), capture.frames.end(),
                        [&](const CaptureFrame& f) { return std::abs(of(f) - first) > 1e-6F; }))
            chosen.push_back(k);
    }
    return chosen;
}

RefinedCapture refine_capture(const PlayableAvatar<float>& avatar, GazeAxis axis,
                              const Capture& capture, const std::vector<int>& frames,
                              const RefineOptions& options,
                              const std::function<void(const RefinedFrame&)>& told) {
    require(!frames.empty(), capture.folder.string(), "got no frames to refine");
    RefinedCapture r;
    r.unknowns = options.unknowns;
    r.unknowns.expression = refined_coefficients(capture, options.expression);
    const int side = std::max(capture.width, capture.height);
    const int trained = 1 << avatar.avatar.upsampler.shape.doublings;
    r.block = std::max(trained, (side + options.size - 1) / options.size);
    // With a whole dilation smaller pictures have wider edges, which heads and gazes are turned to
    // make up for.
    const double dilation =
        resized_dilation(trained_dilation, static_cast<double>(trained) / r.block);
    if (options.device != nullptr) {
        options.device->set_dilation(dilation);
        refine_frames(r, *options.device, {axis, capture, frames, options, told});
    } else {
        Rasterizer<FeaturesOnly<Balanced>> rasterizer;
        rasterizer.accuracy.dilation = dilation;
        rasterizer.accuracy.max_memory = memory_limit();
        HostLabelDrawing drawing(train_backend(), avatar.avatar, avatar.config, avatar.roles,
                                 rasterizer);
        refine_frames(r, drawing, {axis, capture, frames, options, told});
    }
    mark_outliers(r.frames);
    mark_closed(r.frames, capture);
    r.mean = take_mean(r, options);
    return r;
}

std::vector<LabelChange> label_changes(const RefinedCapture& refined, const Capture& capture) {
    const LabelUnknowns& u = refined.unknowns;
    std::vector<LabelChange> changes;
    for (const RefinedFrame& f : refined.frames) {
        LabelChange c;
        const CaptureFrame& frame = capture.frames[static_cast<std::size_t>(f.frame)];
        c.frame = frame.id;
        const VecX<double>& x = f.found.change;
        if (u.gaze) c.gaze = {Vec2<double>(x.head(2)), Vec2<double>(x.segment(2, 2))};
        if (u.pose) c.pose = x.segment(u.gaze_count(), 6);
        if (!u.expression.empty()) c.expression.assign(frame.expression.size(), 0);
        for (std::size_t k = 0; k < u.expression.size(); ++k)
            c.expression[static_cast<std::size_t>(u.expression[k])] =
                x[u.gaze_count() + u.pose_count() + static_cast<Index>(k)];
        changes.push_back(c);
    }
    return changes;
}

Json refine_record(const RefinedCapture& refined, const Capture& capture,
                   const RefineOptions& options) {
    const LabelUnknowns& u = refined.unknowns;
    Json record = {{"block", refined.block},
                   {"alike", options.settings.alike},
                   {"expression_coefficients", u.expression},
                   {"prior_sigma", parts_of(u, u.sigma())},
                   {"mean_taken_off", parts_of(u, refined.mean)}};
    Json frames = Json::object();
    for (const RefinedFrame& f : refined.frames)
        frames[capture.frames[static_cast<std::size_t>(f.frame)].id] = {
            {"cameras", f.views},
            {"cost_before", f.found.first_cost},
            {"cost", f.found.cost},
            {"residual_before", f.found.first_residual},
            {"residual", f.found.residual},
            {"noise", f.found.noise},
            {"steps", f.found.steps},
            {"refused_steps", f.found.refused},
            {"settled", f.found.settled},
            {"outlier", f.outlier},
            {"closed", f.closed},
            {"change", parts_of(u, f.found.change)},
            {"sigma", parts_of(u, f.found.sigma)}};
    record["frames"] = frames;
    return record;
}

} // namespace rye::trainer
