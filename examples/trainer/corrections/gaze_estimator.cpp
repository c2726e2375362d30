// SPDX-License-Identifier: Apache-2.0
#include "corrections/gaze_estimator.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <tuple>
#include <vector>

#include <Eigen/Cholesky>

#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "data/median.hpp"

namespace rye::trainer {
namespace {

constexpr double pi = std::numbers::pi;

/// Pixel that may show the eye.
struct Seen {
    Vec3<double> direction; ///< unit, from the eyeball's centre, head frame
    /// Brightness and two tints, red over blue and green over both, which no shadow changes: skin
    /// and brown irises are red, green irises green, the sclera has none.
    Vec3<double> colour;
    Vec2<double> at; ///< offset from the picture of the eyeball's centre [radii]
    double width;    ///< width of the pixel on the eyeball [rad]
    double weight;   ///< probability that it is eye, 0 to 1
    /// For the mixture alone: probability of eye before its colour is known, and density of its
    /// colour if it is something else.
    double prior = 1, other = 0;
    Vec3<double> ray = Vec3<double>::Zero(); ///< unit, from the camera, head frame
};

/// Calls f(x, y, pixel) for each usable pixel of an eye.
template <class F>
void for_usable(const Columns<float>& eye, int width, const F& f) {
    const int height = static_cast<int>(eye.cols()) / width;
    for (int y = 1; y < height; ++y)
        for (int x = 1; x + 1 < width; ++x) {
            const Index p = static_cast<Index>(y) * width + x;
            const auto inside = [&](Index q) { return eye(0, q) >= 0.5f; };
            if (inside(p) && inside(p - 1) && inside(p + 1) && inside(p - width)) f(x, y, p);
        }
}

/// Returns brightness and tints of a pixel. Skin and sclera reflect red, the iris its own colour:
/// as brightness red separates it best from both.
Vec3<double> colour_of(const Vec3<double>& rgb) {
    constexpr double weight = 2; // of tints beside brightness
    constexpr double noise = 0.3; // a darker sum of colours has hardly a tint
    const double of = weight / (rgb.sum() + noise);
    return {0.8 * rgb.x() + 0.2 * rgb.y(), of * (rgb.x() - rgb.z()),
            of * (rgb.y() - 0.5 * (rgb.x() + rgb.z()))};
}

/// Sphere of the iris' rim, as one camera sees it.
struct RimSphere {
    const Pinhole<double>& camera;
    const EyeballGeometry& ball;
    Vec3<double> from = camera.centre();
    double plane = ball.iris_plane > 0
                       ? ball.iris_plane
                       : std::sqrt(std::max(0.0, ball.radius* ball.radius -
                                                     ball.limbus_radius * ball.limbus_radius));
    double radius = std::hypot(plane, ball.limbus_radius);
    double rim = std::atan2(ball.limbus_radius, plane); ///< angle of the rim from the gaze [rad]
    double pixels = camera.fx * radius / (ball.centre - from).norm(); ///< radius of the sphere [px]
    Vec2<double> middle = camera.project_point(ball.centre).head<2>();

    double from_middle(int x, int y) const {
        return (Vec2<double>(x + 0.5, y + 0.5) - middle).norm() / pixels;
    }
    Seen seen(int x, int y, const Vec3<double>& rgb, double weight) const {
        const Vec2<double> pixel(x + 0.5, y + 0.5);
        const Vec3<double> ray = camera.ray(pixel);
        // Closest approach, then half a chord back (no cancelling discriminant); a ray that
        // passes just outside, at the rim, takes the closest point itself.
        const Vec3<double> to = ball.centre - from;
        const Vec3<double> miss = from + to.dot(ray) * ray - ball.centre;
        const double half2 = radius * radius - miss.squaredNorm();
        const Vec3<double> hit =
            normalized(Vec3<double>(miss - std::sqrt(std::max(half2, 0.0)) * ray));
        constexpr double least_slant = 0.35; // keeps pixels at the sphere's edge finite
        const double slant = std::max(least_slant, -hit.dot(ray));
        return {ball.head_rotation.transpose() * hit,
                colour_of(rgb),
                Vec2<double>((pixel - middle) / pixels),
                1 / (pixels * slant),
                weight,
                1,
                0,
                ball.head_rotation.transpose() * ray};
    }
};

Vec3<double> colour(const Image<float>& image, int x, int y) {
    return image.at(x, y).head(3).cast<double>();
}

/// Returns the usable pixels of an exact area.
std::vector<Seen> usable_pixels(const Image<float>& image, const Columns<float>& eye,
                                const RimSphere& sphere) {
    std::vector<Seen> all;
    for_usable(eye, image.width, [&](int x, int y, Index) {
        all.push_back(sphere.seen(x, y, colour(image, x, y), 1));
    });
    return all;
}

/// Returns the distance of each pixel from the nearest one of an area, in steps of 1 and sqrt(2)
/// [px].
std::vector<float> distances(const Image<float>& image, const std::vector<bool>& area) {
    const int w = image.width, h = image.height;
    constexpr float far = 1e9f, across = 1.41421356f;
    std::vector<float> d(area.size());
    for (std::size_t p = 0; p < d.size(); ++p) d[p] = area[p] ? 0 : far;
    const auto shorter = [&](int x, int y, int side) { // neighbours before it in this direction
        float& here = d[static_cast<std::size_t>(y) * static_cast<std::size_t>(w) +
                        static_cast<std::size_t>(x)];
        for (const auto& [dx, dy, step] : {std::tuple(-1, 0, 1.0f), std::tuple(0, -1, 1.0f),
                                           std::tuple(-1, -1, across), std::tuple(1, -1, across)}) {
            const int u = x + side * dx, v = y + side * dy;
            if (u < 0 || v < 0 || u >= w || v >= h) continue;
            here = std::min(here, d[static_cast<std::size_t>(v) * static_cast<std::size_t>(w) +
                                    static_cast<std::size_t>(u)] +
                                      step);
        }
    };
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x) shorter(x, y, 1);
    for (int y = h - 1; y >= 0; --y)
        for (int x = w - 1; x >= 0; --x) shorter(x, y, -1);
    return d;
}

/// Normal distribution of colours.
struct Skin {
    Vec3<double> mean, spread;
    double density(const Seen& s) const {
        const Vec3<double> z = (s.colour - mean).cwiseQuotient(spread);
        return std::exp(-0.5 * z.squaredNorm()) / (std::pow(2 * pi, 1.5) * spread.prod());
    }
};

/// Returns medians and median deviations of the surrounding pixels, some of which may be something
/// else.
std::optional<Skin> skin_of(const std::vector<Seen>& around) {
    constexpr std::size_t fewest = 12;
    if (around.size() < fewest) return std::nullopt;
    Skin skin;
    const Vec3<double> least(0.05, 0.05, 0.05);
    for (Index k = 0; k < 3; ++k) {
        std::vector<double> v;
        for (const Seen& s : around) v.push_back(s.colour[k]);
        skin.mean[k] = median(v);
        for (double& x : v) x = std::abs(x - skin.mean[k]);
        skin.spread[k] = std::max(least[k], 1.48 * median(v));
    }
    return skin;
}

/// Returns the pixels that may be eye, weighted, if the area's rim is off by up to `error` radii.
std::vector<Seen> likely_pixels(const Image<float>& image, const Columns<float>& eye,
                                const RimSphere& sphere, double error) {
    std::vector<bool> inside(static_cast<std::size_t>(image.size())), outside(inside.size());
    for (std::size_t p = 0; p < inside.size(); ++p) {
        inside[p] = eye(0, static_cast<Index>(p)) >= 0.5f;
        outside[p] = !inside[p];
    }
    const std::vector<float> to_area = distances(image, inside),
                             to_rest = distances(image, outside);
    const double margin = error * sphere.pixels;
    const double skin_width = std::max(3.0, 0.4 * sphere.pixels); // [px]
    std::vector<Seen> all, around;
    for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x) {
            const auto p = static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width) +
                           static_cast<std::size_t>(x);
            const double beside = to_area[p], away = sphere.from_middle(x, y);
            const Vec3<double> rgb = colour(image, x, y);
            if (beside <= margin && away <= 0.98) {
                // From 0.1 at a margin outside the rim to 0.6 at a margin inside it; to 0.9 for the
                // mixture, where a share of the pixels may be something else.
                const double depth = inside[p] ? to_rest[p] - 0.5 : 0.5 - beside;
                const double t = std::clamp(0.5 * (depth / margin + 1), 0.0, 1.0);
                all.push_back(sphere.seen(x, y, rgb, 0.1 + 0.5 * t));
                all.back().prior = 0.1 + 0.8 * t;
            }
            const bool background = rgb.minCoeff() >= 0.97; // white
            if (beside > margin && beside < margin + skin_width && away < 1.4 && !background)
                around.push_back(sphere.seen(x, y, rgb, 0));
        }
    const std::optional<Skin> skin = skin_of(around);
    for (Seen& s : all) {
        // Densities over the colours: constant for the eye; skin or lashes for the rest, and in the
        // mixture also lids and corners of every colour.
        constexpr double any = 2, lashes = 0.3, lids = 2;
        const double like_skin = skin ? skin->density(s) : 0;
        s.other = like_skin + lids;
        if (skin)
            s.weight = s.weight * any / (s.weight * any + (1 - s.weight) * (like_skin + lashes));
    }
    return all;
}

/// Errors after the fit of a disc around one gaze.
struct Fit {
    double pitch = 0, yaw = 0;
    /// -log likelihood of an iris, of squared errors of unknown size or of the mixture, up to
    /// constants.
    double error = unfit;
    double squares = unfit; ///< sum of squares
    double dark = unfit;    ///< part of it: of brightness
    double bright = unfit;  ///< the same of a disc that is brighter than the sclera
    static constexpr double unfit = 1e30;
    bool fits() const { return error < unfit; }
};

/// Fit of colour = sclera + (iris - sclera) disc + (pupil - iris) inner disc + light . at.
/// Memberships are soft over the width of a pixel, so that the error is smooth in the gaze.
class DiscFit {
  public:
    DiscFit(const std::vector<Seen>& seen, const RimSphere& sphere, bool exact)
        : seen_(seen),
          even_light_(exact ? 0.09 : 1),
          rim_(chord(sphere.rim)),
          plane_(sphere.plane / sphere.radius),
          pupil_(0.35 * sphere.ball.limbus_radius / sphere.radius),
          from_(sphere.ball.head_rotation.transpose() * (sphere.from - sphere.ball.centre) /
                sphere.radius),
          least_disc_(std::max(1.0, 0.02 * pi * std::pow(rim_ * sphere.pixels, 2))) {
        normal_.setZero();
        sums_.setZero(), squares_.setZero();
        const auto n = static_cast<Index>(seen_.size());
        without_disc_rows_.resize(n, 5);
        for (VecX<double>* v : {&shares_, &priors_, &others_}) v->resize(n);
        colours_.resize(n, 3);
        for (Index i = 0; i < n; ++i) {
            const Seen& s = seen_[static_cast<std::size_t>(i)];
            without_disc_rows_.row(i) = Row(1, 0, s.at.x(), s.at.y(), 0).transpose();
            colours_.row(i) = s.colour.transpose(), shares_[i] = s.weight;
            priors_[i] = s.prior, others_[i] = (1 - s.prior) * s.other;
        }
        for (const Seen& s : seen_) {
            add(Row(1, 0, s.at.x(), s.at.y(), 0), s);
            squares_ += s.weight * s.colour.cwiseAbs2();
        }
        const std::array<Index, 3> light{0, 2, 3};
        Mat3<double> a, b;
        for (Index i = 0; i < 3; ++i) {
            b.row(i) = sums_.row(light[static_cast<std::size_t>(i)]);
            for (Index j = 0; j < 3; ++j)
                a(i, j) =
                    normal_(light[static_cast<std::size_t>(i)], light[static_cast<std::size_t>(j)]);
        }
        a(1, 1) += even_light_, a(2, 2) += even_light_;
        without_ = squares_ - b.cwiseProduct(a.ldlt().solve(b)).colwise().sum().transpose();
    }

    double pixels() const { return normal_(0, 0); }
    /// Returns the squared error of brightness without a disc.
    double without_disc() const { return without_[0]; }
    /// Returns the share of that which a fit explains; of the tints' besides, if that is more.
    double explained(const Fit& fit) const {
        if (!fit.fits()) return 0;
        return std::max(1 - fit.dark / without_[0], 1 - fit.squares / without_.sum());
    }

    /// Returns the least-squares fit at a gaze, weighted by the probability that a pixel is eye.
    Fit at(double pitch, double yaw) const {
        const Vec3<double> g = gaze_vector(pitch, yaw);
        Fit fit{pitch, yaw};
        if (g.z() < least_forward) return fit;
        Normal a = normal_;
        Sums b = sums_;
        for (const Seen& s : seen_) {
            const Cover c = cover(s, g);
            if (c.disc <= 0) continue;
            const double k = s.weight * c.disc, q = s.weight * c.inner;
            a(1, 0) += k, a(1, 1) += k * c.disc;
            a(2, 1) += k * s.at.x(), a(3, 1) += k * s.at.y();
            b.row(1) += k * s.colour.transpose();
            a(4, 0) += q, a(4, 1) += q * c.disc, a(4, 4) += q * c.inner;
            a(4, 2) += q * s.at.x(), a(4, 3) += q * s.at.y();
            b.row(4) += q * s.colour.transpose();
        }
        const Levels l = levels(a, b);
        if (!l.seen || l.sclera <= 0) return fit;
        const Vec3<double> error = squares_ - l.of.cwiseProduct(b).colwise().sum().transpose();
        if (l.iris())
            fit.error = likelihood(error), fit.squares = error.sum(), fit.dark = error[0];
        if (-l.darker >= min_darkening * l.sclera) fit.bright = error[0];
        return fit;
    }

    /// Returns the fit at a gaze as a -log likelihood: each pixel is either eye, with the disc's
    /// brightness and a normal error, or something else. Pixels that the disc does not explain
    /// count as something else, so that lids and their corners, which no ring of skin resembles, do
    /// not attract it.
    Fit mixture(double pitch, double yaw) const {
        constexpr double spread = 0.12; // of brightness around the levels
        constexpr double tint = 0.3;    // ... of the tints
        constexpr int rounds = 3;       // after which the shares hardly change
        const Vec3<double> g = gaze_vector(pitch, yaw);
        Fit fit{pitch, yaw};
        if (g.z() < least_forward) return fit;
        Rows rows = without_disc_rows_;
        for (std::size_t i = 0; i < seen_.size(); ++i) {
            const Cover c = cover(seen_[i], g);
            rows(static_cast<Index>(i), 1) = c.disc, rows(static_cast<Index>(i), 4) = c.inner;
        }
        VecX<double> share = shares_; // probability of eye, per pixel
        double cost = 0;
        for (int round = 0; round < rounds; ++round) {
            const Rows weighted = rows.array().colwise() * share.array();
            const Normal a = weighted.transpose() * rows;
            const Levels l = levels(a, weighted.transpose() * colours_);
            if (!l.seen || l.sclera <= 0 || !l.iris()) return fit;
            const double density = 1 / (spread * tint * tint * std::pow(2 * pi, 1.5));
            Eigen::ArrayX3d off = (colours_ - rows * l.of).array();
            off.col(0) /= spread, off.rightCols(2) /= tint;
            const Eigen::ArrayXd is_eye =
                density * priors_.array() * (-0.5 * off.square().rowwise().sum()).exp();
            const Eigen::ArrayXd both = is_eye + others_.array();
            share = is_eye / both;
            const Mat<double, 2, 3> light = l.of.middleRows<2>(2);
            cost = -both.log().sum() +
                   0.5 * even_light_ * (light.col(0).squaredNorm() / (spread * spread) +
                                        light.rightCols<2>().squaredNorm() / (tint * tint));
        }
        fit.error = cost;
        return fit;
    }

  private:
    using Normal = Mat<double, 5, 5>;
    using Row = Vec<double, 5>;
    using Rows = Eigen::Matrix<double, Eigen::Dynamic, 5>;
    using Sums = Mat<double, 5, 3>;
    static constexpr double least_forward = 0.62; ///< cosine of 52 degrees, an eye's limit

    /// Returns the -log likelihood of squared errors of brightness and tints, whose variances are
    /// unknown: what tells the iris apart counts, be it brightness or a tint. Smaller errors than
    /// `least` count alike.
    double likelihood(const Vec3<double>& squares) const {
        const Vec3<double> least(0.03, 0.05, 0.05);
        return pixels() * (squares / pixels() + least.cwiseAbs2()).array().log().sum();
    }

    /// Shares of a pixel covered by the disc and its inner disc.
    struct Cover {
        double disc = 0, inner = 0;
    };
    Cover cover(const Seen& s, const Vec3<double>& g) const {
        // The disc ends at the rim plus half the widest pixel.
        const double reach = rim_ + 0.25, along = s.direction.dot(g);
        if (along < 1 - reach * reach / 2) return {};
        const double away = std::sqrt(std::max(0.0, 2 - 2 * along));
        const double disc = std::clamp(0.5 + (rim_ - away) / s.width, 0.0, 1.0);
        if (disc <= 0) return {};
        // The pupil lies in the rim's plane, below the sphere: seen aslant it is not where a ray
        // through it meets the sphere.
        const double depth = (plane_ - from_.dot(g)) / s.ray.dot(g);
        const double off = (from_ + depth * s.ray - plane_ * g).norm();
        return {disc, disc * std::clamp(0.5 + (pupil_ - off) / s.width, 0.0, 1.0)};
    }

    /// Brightness of sclera, disc and inner disc, and the light.
    struct Levels {
        Sums of = Sums::Zero();
        bool seen = false; ///< true if enough of disc and sclera is seen
        double sclera = 0; ///< brightness it would have in the disc's place, in this light
        double darker = 0; ///< mean of the disc below that
        double tinted = 0; ///< how much bluer or greener the disc is; skin is redder
        /// Returns true if the disc is dark enough, or has a colour of its own and is not bright.
        bool iris() const {
            return darker >= min_darkening * sclera ||
                   (tinted >= min_tint && darker >= -min_darkening * sclera);
        }
    };
    /// Returns the solution, from the lower half of the normal equations.
    Levels levels(Normal a, const Sums& b) const {
        Levels l;
        const double disc = a(1, 0), inner = a(4, 0);
        const Vec2<double> middle = Vec2<double>(a(2, 1), a(3, 1)) / std::max(disc, 1e-12);
        l.seen = disc >= least_disc_ && a(0, 0) - disc >= 1;
        if (!l.seen) return l;
        constexpr double tiny = 1e-3; // for a pupil that is not seen
        a(1, 1) += tiny, a(4, 4) += tiny;
        a(2, 2) += even_light_, a(3, 3) += even_light_;
        const Normal whole = a.selfadjointView<Eigen::Lower>();
        l.of = whole.ldlt().solve(b);
        if (l.of(4, 0) > 0) { // no pupil is brighter than the iris
            const Mat<double, 4, 4> part = whole.topLeftCorner<4, 4>();
            l.of.topRows<4>() = part.ldlt().solve(b.topRows<4>());
            l.of.row(4).setZero();
        }
        l.sclera = l.of(0, 0) + l.of(2, 0) * middle.x() + l.of(3, 0) * middle.y();
        const Vec3<double> beside = (l.of.row(1) * disc + l.of.row(4) * inner).transpose() / disc;
        l.darker = -beside[0];
        l.tinted = std::max(-beside[1], beside[2]);
        return l;
    }

    static double chord(double angle) { return 2 * std::sin(angle / 2); }
    void add(const Row& row, const Seen& s) {
        normal_ += s.weight * row * row.transpose();
        sums_ += s.weight * row * s.colour.transpose();
    }

    const std::vector<Seen>& seen_;
    /// Penalty of uneven light: of 0.09, a change of 0.1 per radius costs as much as an error of
    /// 0.03 in a pixel. An area that is not exact has lids and lashes in it, which light that falls
    /// off there would explain at the cost of the eye: so it costs more.
    double even_light_;
    // Lengths in radii of the rim's sphere.
    double rim_;           ///< chord from the gaze to the rim
    double plane_, pupil_; ///< distance of the rim's plane from the centre, radius of the pupil
    Vec3<double> from_;    ///< of the camera from the centre, head frame
    double least_disc_;    ///< a fiftieth of the whole disc [px]
    Rows without_disc_rows_;
    Eigen::MatrixX3d colours_;
    VecX<double> shares_, priors_;
    VecX<double> others_; ///< (1 - prior) times the density of something else
    Normal normal_;       ///< without the discs
    Sums sums_;
    Vec3<double> squares_, without_;
};

/// Returns the smallest error around a gaze, found with decreasing steps.
template <class At>
Fit refined(const At& at, Fit best) {
    double step = 1.6 * degree;
    for (int level = 0; level < 6; ++level, step /= 2.5) { // to 0.016 degrees
        const Fit middle = best;
        for (int i = -2; i <= 2; ++i)
            for (int j = -2; j <= 2; ++j) {
                const Fit f = at(middle.pitch + i * step, middle.yaw + j * step);
                if (f.error < best.error) best = f;
            }
    }
    return best;
}

struct CoarseFits {
    std::vector<Fit> least;     ///< local minima of the error on a grid of gazes
    double bright = Fit::unfit; ///< smallest error of a bright disc
};
template <class At>
CoarseFits coarse_fits(const At& fit_at) {
    constexpr int n = 13, row = 2 * n + 1;
    constexpr double step = 4 * degree;
    constexpr std::size_t kept = 3;
    std::vector<Fit> grid;
    CoarseFits fits;
    for (int i = -n; i <= n; ++i)
        for (int j = -n; j <= n; ++j) grid.push_back(fit_at(i * step, j * step));
    const auto at = [&](int i, int j) -> const Fit& {
        return grid[static_cast<std::size_t>(i * row + j)];
    };
    for (int i = 0; i < row; ++i)
        for (int j = 0; j < row; ++j) {
            bool lowest = at(i, j).fits();
            for (int k = std::max(0, i - 1); k <= std::min(row - 1, i + 1); ++k)
                for (int l = std::max(0, j - 1); l <= std::min(row - 1, j + 1); ++l)
                    lowest = lowest && at(i, j).error <= at(k, l).error;
            if (lowest) fits.least.push_back(at(i, j));
        }
    for (const Fit& f : grid) fits.bright = std::min(fits.bright, f.bright);
    std::sort(fits.least.begin(), fits.least.end(),
              [](const Fit& a, const Fit& b) { return a.error < b.error; });
    if (fits.least.size() > kept) fits.least.resize(kept);
    return fits;
}

} // namespace

double least_contrast(double pixels) {
    constexpr double noise = 10; // explained by a search of noise, in pixels' worth of variance
    return std::min(min_contrast, noise / (noise + pixels));
}

int usable_eye_pixels(const Columns<float>& eye, int width) {
    int count = 0;
    for_usable(eye, width, [&](int, int, Index) { ++count; });
    return count;
}

std::optional<GazeEstimate> estimate_gaze(const Image<float>& image, const Columns<float>& eye,
                                          const Pinhole<double>& camera,
                                          const EyeballGeometry& eyeball, double area_error) {
    const RimSphere sphere{camera, eyeball};
    const bool exact = area_error <= 0;
    const std::vector<Seen> seen =
        exact ? usable_pixels(image, eye, sphere) : likely_pixels(image, eye, sphere, area_error);
    const int count = static_cast<int>(seen.size());
    if (exact && count < min_eye_pixels) return std::nullopt;
    const DiscFit disc(seen, sphere, exact);
    constexpr double least_pixels = 10; // sum of weights
    if (disc.pixels() < least_pixels || disc.without_disc() < 1e-8 * disc.pixels())
        return std::nullopt;
    const auto squares = [&](double pitch, double yaw) { return disc.at(pitch, yaw); };
    const auto mixture = [&](double pitch, double yaw) { return disc.mixture(pitch, yaw); };
    const auto least = [](const auto& at, const CoarseFits& coarse) {
        Fit best;
        for (const Fit& f : coarse.least) {
            const Fit finer = refined(at, f);
            if (finer.error < best.error) best = finer;
        }
        return best;
    };
    const CoarseFits coarse = coarse_fits(squares);
    const auto accepted = [&](const Fit& best) -> std::optional<GazeEstimate> {
        const double contrast = disc.explained(best);
        if (contrast < least_contrast(disc.pixels())) return std::nullopt;
        // Dark pixels beside something bright and round are no iris.
        constexpr double beside_bright = 0.25;
        const double bright =
            coarse.bright < Fit::unfit ? 1 - coarse.bright / disc.without_disc() : 0;
        if (contrast < min_contrast && contrast < beside_bright * bright) return std::nullopt;
        return GazeEstimate{gaze_vector(best.pitch, best.yaw), contrast, count};
    };
    const Fit best = least(squares, coarse);
    if (!exact) {
        // A disc that explains much less than another comes from a mixture that takes the iris for
        // something else.
        constexpr double share = 0.5;
        const Fit likeliest = least(mixture, coarse_fits(mixture));
        const Fit there = disc.at(likeliest.pitch, likeliest.yaw);
        if (likeliest.fits() && disc.explained(there) >= share * disc.explained(best))
            if (const std::optional<GazeEstimate> found = accepted(there)) return found;
    }
    return accepted(best);
}

} // namespace rye::trainer
