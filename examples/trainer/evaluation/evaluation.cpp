// SPDX-License-Identifier: Apache-2.0
#include "evaluation/evaluation.hpp"

#include <algorithm>

#include <rye/loss/photometric.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>
#include <rye/train/lid_margin.hpp>

#include "corrections/highlight_spots.hpp"
#include "corrections/lights.hpp"
#include "data/degrees.hpp"
#include "data/panel.hpp"
#include "data/threads.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;

/// Areas over which image quality is measured, as 1 x pixels masks of 0 and 1.
struct Areas {
    Columns<float> head;  ///< the subject's mask
    Columns<float> face;  ///< the head inside the convex hull of the projected landmarks
    Columns<float> eyes;  ///< rectangles around the visible eyeballs, enlarged by half
    Columns<float> lids;  ///< the part of eyes near the lids' lines
    Columns<float> skin;  ///< all except the visible eyeballs
};

/// Sets pixels to `to` whose middles are less than `radius` from a place [px].
void fill_disc(const Vec2<double>& middle, double radius, const Image<float>& from,
               Columns<float>& to) {
    const auto first = [&](double at, int size) {
        return std::clamp(static_cast<int>(std::ceil(at - radius - 0.5)), 0, size);
    };
    const auto last = [&](double at, int size) {
        return std::clamp(static_cast<int>(std::floor(at + radius - 0.5)) + 1, 0, size);
    };
    for (int y = first(middle.y(), from.height); y < last(middle.y(), from.height); ++y)
        for (int x = first(middle.x(), from.width); x < last(middle.x(), from.width); ++x)
            if ((Vec2<double>(x + 0.5, y + 0.5) - middle).norm() < radius)
                to(0, static_cast<Index>(y) * from.width + x) = 1;
}

/// Returns the pixels less than lid_margin_mm from the lines of an eye's lids.
Columns<float> near_lids(const CaptureFrame& f, const Pinhole<double>& view, int eye,
                         const Image<float>& mask) {
    const double unit = 0.01 * f.scale; // of the world in a mm
    Columns<float> near = Columns<float>::Zero(1, mask.size());
    const LidLines<double> lids = lid_lines<double>(f.landmarks, eye, 0.2 * unit);
    for (const Columns<double>* line : {&lids.upper, &lids.lower})
        for (Index k = 0; k < line->cols(); ++k) {
            const Vec3<double> at = view.project_point(line->col(k));
            if (at.z() <= 0) continue;
            fill_disc(at.head<2>(), lid_margin_mm * unit * view.fx / at.z(), mask, near);
        }
    return near;
}

/// Returns the convex hull of points [px], counter-clockwise (Andrew's monotone chain).
std::vector<Vec2<double>> convex_hull(std::vector<Vec2<double>> p) {
    std::sort(p.begin(), p.end(), [](const auto& a, const auto& b) {
        return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
    });
    std::vector<Vec2<double>> hull;
    const auto cross = [](const Vec2<double>& o, const Vec2<double>& a, const Vec2<double>& b) {
        return (a.x() - o.x()) * (b.y() - o.y()) - (a.y() - o.y()) * (b.x() - o.x());
    };
    for (int pass = 0; pass < 2; ++pass) {
        const std::size_t base = hull.size();
        for (const Vec2<double>& q : p) {
            while (hull.size() >= base + 2 && cross(hull[hull.size() - 2], hull.back(), q) <= 0)
                hull.pop_back();
            hull.push_back(q);
        }
        hull.pop_back();
        std::reverse(p.begin(), p.end());
    }
    return hull;
}

/// Photograph of a view, on white, and its masks.
struct Photograph {
    Image<float> truth, mask, eyes;
};

Areas areas_of(const Photograph& photograph, const CaptureFrame& f, const Pinhole<double>& view) {
    const Image<float>&mask = photograph.mask, &eyes = photograph.eyes;
    Areas a;
    a.head = (mask.pixels.array() >= 0.5f).cast<float>();
    std::vector<Vec2<double>> points;
    for (Index k = 0; k < f.landmarks.cols(); ++k)
        points.push_back(view.project_point(f.landmarks.col(k)).head<2>());
    const std::vector<Vec2<double>> hull = convex_hull(points);
    a.face = a.head;
    for (int y = 0; y < mask.height; ++y)
        for (int x = 0; x < mask.width; ++x)
            for (std::size_t k = 0; k < hull.size(); ++k) {
                const Vec2<double>&p = hull[k], &q = hull[(k + 1) % hull.size()];
                if ((q.x() - p.x()) * (y + 0.5 - p.y()) - (q.y() - p.y()) * (x + 0.5 - p.x()) < 0)
                    a.face(0, static_cast<Index>(y) * mask.width + x) = 0;
            }
    a.skin = (eyes.pixels.topRows(2).colwise().maxCoeff().array() < 0.5f).cast<float>();
    a.eyes = a.lids = Columns<float>::Zero(1, mask.size());
    for (int eye = 0; eye < 2; ++eye) {
        int x0 = mask.width, x1 = -1, y0 = mask.height, y1 = -1;
        for (int y = 0; y < mask.height; ++y)
            for (int x = 0; x < mask.width; ++x)
                if (eyes.at(x, y)(eye) > 0.5f) {
                    x0 = std::min(x0, x), x1 = std::max(x1, x);
                    y0 = std::min(y0, y), y1 = std::max(y1, y);
                }
        if (x1 < 0) continue;
        const int dx = (x1 - x0 + 1) / 4 + 1, dy = (y1 - y0 + 1) / 4 + 1;
        const Columns<float> near = near_lids(f, view, eye, mask);
        for (int y = std::max(0, y0 - dy); y <= std::min(mask.height - 1, y1 + dy); ++y)
            for (int x = std::max(0, x0 - dx); x <= std::min(mask.width - 1, x1 + dx); ++x) {
                const Index p = static_cast<Index>(y) * mask.width + x;
                a.eyes(0, p) = a.head(0, p);
                a.lids(0, p) = std::max(a.lids(0, p), a.head(0, p) * near(0, p));
            }
    }
    return a;
}

Image<float> white_outside(const Image<float>& image, const Columns<float>& area) {
    Image<float> out = image;
    for (Index p = 0; p < out.size(); ++p)
        if (area(0, p) < 0.5f) out.pixels.col(p).setOnes();
    return out;
}

/// Returns the quality over an area: PSNR over its own pixels. With both pictures white outside the
/// area: SSIM, the mean over the windows whose middle is in the area, and a second PSNR over the
/// whole picture.
Quality quality(const Image<float>& shown, const Image<float>& truth, const Columns<float>& area) {
    Quality q;
    if (area.sum() < 1) return q;
    const Image<float> a = white_outside(shown, area), b = white_outside(truth, area);
    const auto finite = [](double db) { return std::min(db, 99.0); };  // equal pictures: infinity
    q.psnr.add(finite(psnr<float>(shown.pixels, truth.pixels, area)));
    q.psnr_full.add(finite(psnr<float>(a.pixels, b.pixels, Columns<float>())));
    q.ssim.add(masked_ssim(a, b, area));
    return q;
}

/// Returns the rectangle around an area: x, y, width, height.
std::array<int, 4> box_of(const Columns<float>& area, int width) {
    int x0 = width, x1 = -1, y0 = -1, y1 = -1;
    for (Index p = 0; p < area.cols(); ++p) {
        if (area(0, p) < 0.5f) continue;
        const int x = static_cast<int>(p % width);
        y1 = static_cast<int>(p / width);
        if (y0 < 0) y0 = y1;
        x0 = std::min(x0, x), x1 = std::max(x1, x);
    }
    return x1 < 0 ? std::array<int, 4>{} : std::array<int, 4>{x0, y0, x1 - x0 + 1, y1 - y0 + 1};
}

Columns<float> area_of(const EyesOfView& eyes, std::size_t eye) {
    return eyes.area.pixels.row(static_cast<Index>(eye));
}

} // namespace

Json Mean::json() const { return count > 0 ? Json(value()) : Json(nullptr); }

void Quality::add(const Quality& q) {
    psnr.add(q.psnr), psnr_full.add(q.psnr_full), ssim.add(q.ssim);
}
Json Quality::json() const {
    return {{"psnr", psnr.json()}, {"ssim", ssim.json()}, {"psnr_full_image", psnr_full.json()}};
}

void GazeErrors::add(const std::optional<GazeEstimate>& here,
                     const std::optional<GazeEstimate>& photograph, const Vec3<double>& label) {
    found += here ? 1 : 0;
    const double from_label = here ? degrees * angular_error(here->gaze, label) : missed_degrees;
    to_label.add(from_label);
    if (here) to_label_where_found.add(from_label);
    if (here && photograph) {
        const double error = degrees * angular_error(here->gaze, photograph->gaze);
        to_photograph.add(error);
        where_found.add(error);
    } else {
        to_photograph.add(missed_degrees);
    }
}
void GazeErrors::add(const GazeErrors& g) {
    to_photograph.add(g.to_photograph), where_found.add(g.where_found), to_label.add(g.to_label);
    to_label_where_found.add(g.to_label_where_found);
    found += g.found;
}
Json GazeErrors::json() const {
    return {{"degrees", to_photograph.json()}, {"degrees_where_found", where_found.json()},
            {"degrees_to_label", to_label.json()}, {"found", found},
            {"degrees_to_label_where_found", to_label_where_found.json()}};
}

void GazeTable::add(const GazeTable& t) {
    photograph.add(t.photograph), render.add(t.render), rest.add(t.rest), nearest.add(t.nearest);
}
Json GazeTable::json() const {
    return {{"photograph",
             {{"degrees_to_label", photograph.to_label.json()}, {"found", photograph.found},
              {"degrees_to_label_where_found", photograph.to_label_where_found.json()}}},
            {"render", render.json()}, {"at_rest", rest.json()},
            {"nearest_training", nearest.json()}};
}

void ViewResult::add(const ViewResult& v) {
    head.add(v.head), face.add(v.face), eyes.add(v.eyes), eye_skin.add(v.eye_skin);
    eyeballs.add(v.eyeballs), lid_margins.add(v.lid_margins);
    lpips.add(v.lpips);
    eyes_in_view += v.eyes_in_view, eyes_visible += v.eyes_visible;
    measured.add(v.measured), own.add(v.own);
    reflections.add(v.reflections);
}
Json ViewResult::json() const {
    return {{"head", head.json()},
            {"face", face.json()},
            {"eyes", eyes.json()},
            {"eyes_painted_white", eye_skin.json()},
            {"eyeballs", eyeballs.json()},
            {"lid_margins", lid_margins.json()},
            {"lpips", lpips.json()},
            {"eyes_in_view", eyes_in_view},
            {"eyes_visible", eyes_visible},
            {"gaze", measured.json()},
            {"gaze_without_labels", own.json()},
            {"reflections", reflections.json()},
            {"highlights", match_highlights(reflections).json()}};
}

EyesOfView Evaluation::labelled_eyes(int frame, Image<float> mask) const {
    const CaptureFrame& f = capture_.frames[static_cast<std::size_t>(frame)];
    const Subject& s = state_.subject;
    EyesOfView eyes;
    eyes.area = std::move(mask);
    for (std::size_t e = 0; e < 2; ++e) {
        const CaptureEye& label = f.eyes[e];
        EyeballGeometry& ball = eyes.ball[e];
        ball.head_rotation = so3_exp(Vec3<double>(f.pose.head<3>()));
        ball.radius = label.radius.value_or(s.eye_radius[e] * f.scale);
        ball.limbus_radius = label.limbus_radius.value_or(s.limbus_radius[e] * f.scale);
        ball.iris_plane = label.iris_plane.value_or(s.iris_plane[e] * f.scale);
        const Vec3<double> in_head = f.scale * s.eye_centre[e];
        ball.centre = label.centre.value_or(
            Vec3<double>(ball.head_rotation * in_head + f.pose.tail<3>()));
    }
    return eyes;
}

EyesOfView Evaluation::measured_eyes(int frame, int camera) const {
    return labelled_eyes(frame, capture_.eye_mask(frame, camera));
}

EyesOfView Evaluation::eyes_of(const Drivers<float>& drivers, PosedEyes posed) const {
    EyesOfView eyes;
    eyes.area = std::move(posed.area);
    eyes.area_error = own_area_error;
    for (std::size_t e = 0; e < 2; ++e) {
        const auto scale = static_cast<double>(drivers.scale);
        const Vec3<double> turn = drivers.pose.head<3>().cast<double>();
        eyes.ball[e] = {posed.centre[e], state_.subject.eye_radius[e] * scale,
                        state_.subject.limbus_radius[e] * scale, so3_exp(turn),
                        state_.subject.iris_plane[e] * scale};
    }
    return eyes;
}

EyesOfView Evaluation::own_eyes(const Drivers<float>& drivers,
                                const Pinhole<double>& camera) const {
    return eyes_of(drivers, posed_eyes(state_, {drivers, camera.cast<float>(), dilation_}));
}

/// Picture of the avatar, and its own eyes for the estimator.
struct Evaluation::Render {
    Image<float> image;
    EyesOfView own;
};
/// Renders with the frame's gaze, with the gaze at rest, and with each eye at its nearest training
/// gaze.
struct Evaluation::Renders {
    Render frame, rest, nearest;
};
/// Results of a view, and those of its pictures that were asked for.
struct Evaluation::Measured {
    ViewResult result;
    Image<float> picture;
    Image<float> head, head_truth; ///< white outside the head, for LPIPS
};

Evaluation::Renders Evaluation::renders(const MeasuredView& v) const {
    const Pinhole<float> camera = capture_.camera(v.frame, v.camera).cast<float>();
    const Drivers<float> drivers = frame_drivers(capture_, v.frame, state_.config.gaze_axis);
    Drivers<float> at_rest = drivers, at_nearest = drivers;
    for (std::size_t e = 0; e < 2; ++e) {
        at_rest.gaze[e] = Vec3<float>(0, 0, 1);
        at_nearest.gaze[e] = nearest_training_gaze(drivers.gaze[e], e);
    }
    const auto render = [&](const Drivers<float>& d) {
        ShownAvatar shown = drawer_.shown({d, camera, dilation_});
        return Render{std::move(shown.picture), eyes_of(d, std::move(shown.eyes))};
    };
    return {render(drivers), render(at_rest), render(at_nearest)};
}

Evaluation::Measured Evaluation::measured(const MeasuredView& v, Renders shown) const {
    const CaptureFrame& f = capture_.frames[static_cast<std::size_t>(v.frame)];
    const Pinhole<double>& view = capture_.camera(v.frame, v.camera);
    const Photograph photograph = [&] {
        Photograph p{{}, capture_.mask(v.frame, v.camera), capture_.eye_mask(v.frame, v.camera)};
        p.truth = on_background(capture_.image(v.frame, v.camera), p.mask, 1.0f);
        return p;
    }();
    const Image<float>&truth = photograph.truth, &image = shown.frame.image;
    const EyesOfView labelled = labelled_eyes(v.frame, photograph.eyes);
    const Areas areas = areas_of(photograph, f, view);
    Measured m;
    ViewResult& r = m.result;
    r.head = quality(image, truth, areas.head);
    r.face = quality(image, truth, areas.face);
    r.eyes = quality(image, truth, areas.eyes);
    r.eyes_box = box_of(areas.eyes, truth.width);
    r.eye_skin =
        quality(white_outside(image, areas.skin), white_outside(truth, areas.skin), areas.eyes);
    r.eyeballs = quality(image, truth, (1 - areas.skin.array()).matrix());
    r.lid_margins = quality(image, truth, areas.lids);
    if (lpips_) {
        m.head = white_outside(image, areas.head);
        m.head_truth = white_outside(truth, areas.head);
    }
    for (std::size_t e = 0; e < 2; ++e) {
        ++r.eyes_in_view;
        if (usable_eye_pixels(area_of(labelled, e), truth.width) < min_eye_pixels) continue;
        ++r.eyes_visible;
        // The visible iris follows the optical axis.
        const Vec3<double> label = f.eyes[e].optical;
        const auto fill = [&](const auto& eyes_in, GazeTable& table) {
            const auto estimate = [&](const Image<float>& picture, const EyesOfView& eyes) {
                return estimate_gaze(picture, area_of(eyes, e), view, eyes.ball[e],
                                     eyes.area_error);
            };
            const auto of = [&](const Render& s) { return estimate(s.image, eyes_in(s)); };
            // On the photograph, the estimator searches where the avatar has its eyes.
            const std::optional<GazeEstimate> reference = estimate(truth, eyes_in(shown.frame));
            table.photograph.add(reference, reference, label);
            table.render.add(of(shown.frame), reference, label);
            table.rest.add(of(shown.rest), reference, label);
            table.nearest.add(of(shown.nearest), reference, label);
        };
        fill([&](const Render&) -> const EyesOfView& { return labelled; }, r.measured);
        fill([](const Render& s) -> const EyesOfView& { return s.own; }, r.own);
        const CorneaInPicture cornea = cornea_in_picture(f, view, state_.subject, e,
                                                         usual_cornea(state_.subject, e));
        const Columns<float> area = area_of(labelled, e);
        const int eye = static_cast<int>(e);
        add_mirrored_pixels(truth, area, cornea, eye, eye, r.reflections.photograph);
        add_mirrored_pixels(image, area, cornea, eye, eye, r.reflections.render);
        r.reflections.pictures = 2;
    }
    if (v.pictured) m.picture = side_by_side({truth, image, shown.rest.image});
    return m;
}

std::vector<ViewResult> Evaluation::views(const std::vector<MeasuredView>& which,
                                          const TakePicture& take) const {
    const auto threads = static_cast<std::size_t>(program_threads().size());
    // Number of views whose pictures are held at once. A device draws while other threads measure;
    // the CPU draws with all threads and the memory of one frame.
    const std::size_t most = std::clamp<std::size_t>(4 * threads, 8, 64);
    std::vector<ViewResult> results(which.size());
    for (std::size_t first = 0; first < which.size(); first += most) {
        const std::size_t n = std::min(most, which.size() - first);
        std::vector<Renders> shown(n);
        std::vector<Measured> found(n);
        if (!drawer_.on_device())
            for (std::size_t i = 0; i < n; ++i) shown[i] = renders(which[first + i]);
        program_threads().run(static_cast<Index>(n), [&](Index k) {
            const auto i = static_cast<std::size_t>(k);
            const MeasuredView& v = which[first + i];
            found[i] = measured(v, drawer_.on_device() ? renders(v) : std::move(shown[i]));
            shown[i] = {};
            if (v.pictured) take(first + i, found[i].picture);
            found[i].picture = {};
        });
        for (std::size_t i = 0; i < n; ++i) {
            if (lpips_) found[i].result.lpips.add(lpips_(found[i].head, found[i].head_truth));
            results[first + i] = std::move(found[i].result);
        }
    }
    return results;
}

ViewResult Evaluation::view(int frame, int camera, Image<float>& picture) const {
    return views({{frame, camera, true}}, [&](std::size_t, const Image<float>& p) { picture = p; })
        .front();
}

Vec3<float> Evaluation::nearest_training_gaze(const Vec3<float>& gaze, std::size_t eye) const {
    Vec3<float> best(0, 0, 1);
    float least = 10;
    for (const int f : capture_.train) {
        const Vec3<float> g = gaze_of(capture_.frames[static_cast<std::size_t>(f)].eyes[eye],
                                      state_.config.gaze_axis)
                                  .cast<float>();
        const float angle = angular_error(g, gaze);
        if (angle < least) least = angle, best = g;
    }
    return best;
}

} // namespace rye::trainer
