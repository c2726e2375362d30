// SPDX-License-Identifier: Apache-2.0
#include "corrections/highlight_spots.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include <rye/core/error.hpp>

#include "data/median.hpp"

namespace rye::trainer {
namespace {

/// Least brightness of a spot's pixels, also in deviations of the noise, and their fewest number.
constexpr double least = 0.05, least_deviations = 2;
constexpr std::size_t fewest = 3;
/// Share of a render's spot by which a photograph that has it is brighter there.
constexpr double least_part = 1.0 / 3;
/// Fewest pictures of an eye that tell an iris' own colours.
constexpr int fewest_pictures = 12;
/// Farthest that two pictures' middles of a spot are apart, in radii of the iris.
constexpr double reach = 0.25;

using Place = std::pair<int, int>;

/// A pixel of an iris, and how much brighter it is than irises are there.
struct BrightPixel {
    double over;
    bool inside;        ///< its four neighbours are pixels of the iris too
    std::size_t number; ///< in the list of all pixels
};

/// Takes the group of adjacent pixels that `start` belongs to out of `left`.
std::vector<Place> taken_group(std::map<Place, BrightPixel>& left, Place start) {
    std::vector<Place> group, next{start};
    left.erase(start);
    while (!next.empty()) {
        const Place p = next.back();
        next.pop_back();
        group.push_back(p);
        for (int dy = -1; dy <= 1; ++dy)
            for (int dx = -1; dx <= 1; ++dx) {
                const auto beside = left.find({p.first + dy, p.second + dx});
                if (beside == left.end()) continue;
                next.push_back(beside->first);
                left.erase(beside);
            }
    }
    return group;
}

/// Appends the spots of one picture, whose pixels are `iris`. Those begin as `empty`.
void add_spots(const std::map<Place, BrightPixel>& iris, const HighlightSpot& empty,
               std::vector<HighlightSpot>& spots) {
    std::map<Place, BrightPixel> bright;
    for (const auto& [place, p] : iris)
        if (p.over > std::max(least, least_deviations * empty.noise)) bright.emplace(place, p);
    const std::size_t before = spots.size();
    while (!bright.empty()) {
        const std::vector<Place> group = taken_group(bright, bright.begin()->first);
        if (group.size() < fewest) continue;
        HighlightSpot spot = empty;
        double sum = 0;
        for (const Place& place : group) {
            const BrightPixel& p = iris.at(place);
            spot.at += p.over * Vec2<double>(place.second + 0.5, place.first + 0.5);
            sum += p.over;
            spot.pixels.push_back(p.number);
            if (p.over > spot.brightness) {
                spot.brightness = p.over;
                spot.peaks = p.inside;
            }
        }
        spot.at /= sum;
        spots.push_back(spot);
    }
    std::stable_sort(
        spots.begin() + static_cast<std::ptrdiff_t>(before), spots.end(),
        [](const HighlightSpot& a, const HighlightSpot& b) { return a.brightness > b.brightness; });
}

/// Returns the distance of the nearest spot of the same picture in radii of the iris; infinite
/// without any.
double nearest(const HighlightSpot& spot, const std::vector<HighlightSpot>& others) {
    double best = std::numeric_limits<double>::infinity();
    for (const HighlightSpot& o : others)
        if (o.picture == spot.picture)
            best = std::min(best, (o.at - spot.at).norm() / spot.iris_radius);
    return best;
}

/// Returns the mean of what pixels of these numbers show over their irises.
double mean_over(const std::vector<MirroredPixel>& pixels, const std::vector<std::size_t>& which) {
    double sum = 0;
    for (const std::size_t i : which) sum += static_cast<double>(pixels[i].colour.mean());
    return sum / static_cast<double>(which.size());
}

} // namespace

std::vector<HighlightSpot> highlight_spots(const std::vector<MirroredPixel>& pixels) {
    struct Picture {
        std::map<Place, BrightPixel> iris;
        double radius = 0;
    };
    std::map<int, Picture> pictures;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
        const MirroredPixel& p = pixels[i];
        Picture& of = pictures[p.picture];
        of.iris[{p.y, p.x}] = {static_cast<double>(p.colour.mean()), false, i};
        of.radius = static_cast<double>(p.iris_radius);
    }
    std::vector<HighlightSpot> spots;
    for (auto& [number, of] : pictures) {
        std::vector<double> sizes;
        for (auto& [place, p] : of.iris) {
            const auto [y, x] = place;
            p.inside = of.iris.count({y - 1, x}) && of.iris.count({y + 1, x}) &&
                       of.iris.count({y, x - 1}) && of.iris.count({y, x + 1});
            sizes.push_back(std::abs(p.over));
        }
        add_spots(
            of.iris,
            {number, Vec2<double>::Zero(), 0, 1.4826 * median(std::move(sizes)), true, of.radius},
            spots);
    }
    return spots;
}

HighlightMatch match_highlights(const Reflections& r) {
    std::vector<MirroredPixel> photograph = r.photograph, render = r.render;
    require(photograph.size() == render.size(), "highlights", "got ", render.size(),
            " pixels of renders beside ", photograph.size(), " of photographs");
    subtract_own_colours(photograph);
    subtract_own_colours(render);
    const std::vector<HighlightSpot> photographs = highlight_spots(photograph),
                                     renders = highlight_spots(render);
    HighlightMatch m;
    std::set<int> pictures;
    for (const MirroredPixel& p : photograph) pictures.insert(p.picture);
    m.pictures = static_cast<int>(pictures.size());
    int last = -1;
    for (const HighlightSpot& spot : photographs) {
        if (!spot.clear() || spot.picture == last) continue;
        last = spot.picture;
        ++m.photographs;
        if (const double d = nearest(spot, renders); d < reach) {
            ++m.found;
            m.distance.push_back(d * spot.iris_radius);
        }
    }
    for (const HighlightSpot& spot : renders) {
        if (!spot.clear()) continue;
        ++m.renders;
        if (nearest(spot, photographs) < reach) continue;
        if (mean_over(photograph, spot.pixels) < least_part * mean_over(render, spot.pixels))
            ++m.unlike;
    }
    return m;
}

double HighlightMatch::median_distance() const {
    return distance.empty() ? std::nan("") : median(distance);
}

nlohmann::ordered_json HighlightMatch::json() const {
    if (pictures < fewest_pictures) return nullptr;
    nlohmann::ordered_json r = {{"photographs", photographs},
                                {"found", found},
                                {"median_px", nullptr},
                                {"spots_of_renders", renders},
                                {"not_in_photographs", unlike}};
    if (!distance.empty()) r["median_px"] = median_distance();
    return r;
}

} // namespace rye::trainer
