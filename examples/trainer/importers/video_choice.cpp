// SPDX-License-Identifier: Apache-2.0
#include "importers/video_choice.hpp"

#include <algorithm>
#include <limits>
#include <span>

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

/// Returns true if head or expression of a picture differ from all others'.
bool is_new(const Tracks& tracks, int picture, std::span<const int> others) {
    constexpr double new_from = 2; // units
    const auto without_look = [&](int i) {
        VecX<double> x = features(tracks.pictures[static_cast<std::size_t>(i)], tracks.names);
        for (std::size_t k = 0; k < tracks.names.size(); ++k)
            if (looks(tracks.names[k])) x[3 + static_cast<Index>(k)] = 0;
        return x;
    };
    const VecX<double> own = without_look(picture);
    return std::none_of(others.begin(), others.end(),
                        [&](int i) { return (without_look(i) - own).norm() < new_from; });
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
    const std::size_t preferred = good.size();
    for (const int i : otherwise) {
        if (is_new(tracks, i, {good.data(), preferred})) good.push_back(i);
        else ++c.unwanted;
    }
    std::sort(good.begin(), good.end());
    require(static_cast<int>(good.size()) >= least_pictures, "rye import video", "got ", good.size(),
            " pictures with one whole, sharp face of ", tracks.pictures.size(), " (", c.without_face,
            " without a face, ", c.with_several, " with several, ", c.at_border,
            " with one cut off, ", c.blurred, " blurred), expected ", least_pictures, " or more");
    c.pictures = static_cast<int>(good.size()) > most ? most_different(tracks, good, most) : good;
    c.spare = static_cast<int>(good.size() - c.pictures.size());
    return c;
}

} // namespace rye::trainer
