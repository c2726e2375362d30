// SPDX-License-Identifier: Apache-2.0
#include "importers/video_choice.hpp"

#include <algorithm>
#include <limits>

#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>

#include "data/median.hpp"

namespace rye::trainer {
namespace {

/// Sharpness below which a face is blurred, over the median of the video.
constexpr double least_sharpness = 0.55;
/// Differences that count alike: a turn of the head [rad], a coefficient of the eyes' direction (1 is
/// some 30 degrees), one of an expression.
constexpr double turn_unit = 0.17, look_unit = 0.3, expression_unit = 0.5;

bool touches_border(const TrackedPicture& p, const Tracks& tracks) {
    const Vec2<double> low = p.landmarks.topRows<2>().rowwise().minCoeff(),
                       high = p.landmarks.topRows<2>().rowwise().maxCoeff();
    return low.minCoeff() < 1 || high.x() > tracks.width - 1 || high.y() > tracks.height - 1;
}

bool looks(const std::string& name) { return name.starts_with("eyeLook"); }

/// Numbers whose distance says how different two pictures are.
VecX<double> features(const TrackedPicture& p, const std::vector<std::string>& names) {
    VecX<double> all(3 + p.coefficients.size());
    all.head<3>() = so3_log(p.head.rotation) / turn_unit;
    for (Index i = 0; i < p.coefficients.size(); ++i)
        all[3 + i] =
            p.coefficients[i] / (looks(names[static_cast<std::size_t>(i)]) ? look_unit : expression_unit);
    return all;
}

/// The same of head and expression alone.
VecX<double> without_look(VecX<double> features, const std::vector<std::string>& names) {
    for (std::size_t k = 0; k < names.size(); ++k)
        if (looks(names[k])) features[3 + static_cast<Index>(k)] = 0;
    return features;
}

/// Returns those of the pictures whose head or expression differs from all preferred ones'.
std::vector<int> new_ones(const Tracks& tracks, const std::vector<int>& pictures,
                          const std::vector<int>& preferred) {
    constexpr double new_from = 2; // units
    const auto at = [&](int i) {
        return without_look(features(tracks.pictures[static_cast<std::size_t>(i)], tracks.names), tracks.names);
    };
    std::vector<VecX<double>> known;
    for (const int i : preferred) known.push_back(at(i));
    std::vector<int> found;
    for (const int i : pictures) {
        const VecX<double> own = at(i);
        if (std::none_of(known.begin(), known.end(),
                         [&](const VecX<double>& x) { return (x - own).norm() < new_from; }))
            found.push_back(i);
    }
    return found;
}

/// Returns `most` of the pictures: each is the one farthest from those before.
std::vector<int> most_different(const Tracks& tracks, const std::vector<int>& good, int most) {
    std::vector<VecX<double>> at;
    for (const int i : good)
        at.push_back(features(tracks.pictures[static_cast<std::size_t>(i)], tracks.names));
    std::vector<double> distance(good.size(), std::numeric_limits<double>::infinity());
    std::vector<int> chosen;
    std::size_t next = 0;
    while (static_cast<int>(chosen.size()) < most) {
        chosen.push_back(good[next]);
        for (std::size_t i = 0; i < good.size(); ++i)
            distance[i] = std::min(distance[i], (at[i] - at[next]).squaredNorm());
        next = static_cast<std::size_t>(std::max_element(distance.begin(), distance.end()) -
                                        distance.begin());
        if (distance[next] <= 0) break;
    }
    std::sort(chosen.begin(), chosen.end());
    return chosen;
}

} // namespace

VideoChoice choose_pictures(const Tracks& tracks, int most,
                            const std::function<Wanted(const TrackedPicture&)>& wanted) {
    VideoChoice c;
    std::vector<double> sharpness;
    for (const TrackedPicture& p : tracks.pictures)
        if (p.faces == 1) sharpness.push_back(p.sharpness);
    const double blurred = least_sharpness * median(sharpness);
    std::vector<int> good, otherwise;
    for (std::size_t i = 0; i < tracks.pictures.size(); ++i) {
        const TrackedPicture& p = tracks.pictures[i];
        if (p.faces == 0) ++c.without_face;
        else if (p.faces > 1) ++c.with_several;
        else if (touches_border(p, tracks)) ++c.at_border;
        else if (p.sharpness < blurred) ++c.blurred;
        else if (const Wanted w = wanted(p); w == Wanted::no) ++c.unwanted;
        else (w == Wanted::preferred ? good : otherwise).push_back(static_cast<int>(i));
    }
    const std::vector<int> more = new_ones(tracks, otherwise, good);
    c.unwanted += static_cast<int>(otherwise.size() - more.size());
    good.insert(good.end(), more.begin(), more.end());
    std::sort(good.begin(), good.end());
    require(static_cast<int>(good.size()) >= least_pictures, "rye import video", "got ", good.size(),
            " pictures with one whole, sharp face of ", tracks.pictures.size(), " (", c.without_face,
            " without a face, ", c.with_several, " with several, ", c.at_border,
            " with one cut off, ", c.blurred, " blurred, ", c.unwanted, " not wanted), expected ", least_pictures, " or more");
    c.pictures = static_cast<int>(good.size()) > most ? most_different(tracks, good, most) : good;
    c.spare = static_cast<int>(good.size() - c.pictures.size());
    return c;
}

} // namespace rye::trainer
