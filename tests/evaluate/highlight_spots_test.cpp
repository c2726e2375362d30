// SPDX-License-Identifier: Apache-2.0
// Highlights on irises as spots: painted ones are found where they were painted, and compared.
#include "corrections/highlight_spots.hpp"

#include <cmath>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

#include "../support/hostile.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

constexpr int radius = 15, pictures = 24;

/// A spot to be painted: picture, place from the iris' middle [px], what it adds.
struct Painted {
    int picture;
    double x, y, adds;
};

/// Pixels of irises of a colour that changes from the pupil outwards, in pictures whose light
/// changes from one to the next and from one side to the other, with noise of this deviation.
std::vector<MirroredPixel> irises(const std::vector<Painted>& spots, double noise = 0) {
    const Random random(5);
    std::vector<MirroredPixel> all;
    for (int picture = 0; picture < pictures; ++picture)
        for (int y = -radius; y <= radius; ++y)
            for (int x = -radius; x <= radius; ++x) {
                const double r = std::hypot(x, y) / radius;
                if (r > 0.85) continue;
                MirroredPixel p;
                p.iris = Vec2<float>(float(x) / radius, float(y) / radius);
                p.eye = picture % 2;
                p.picture = picture;
                p.x = 40 + x;
                p.y = 50 + y;
                p.iris_radius = radius;
                const double gain = 0.6 + 0.1 * (picture % 5) + 0.02 * (picture % 7) * x / radius;
                double v = gain * (0.2 + 0.05 * p.eye + 0.1 * r) + 0.01 * (picture % 3);
                v += noise * random.normal(2 * all.size());
                for (const Painted& s : spots)
                    if (s.picture == picture)
                        v += s.adds *
                             std::exp(-0.5 * (std::pow(x - s.x, 2) + std::pow(y - s.y, 2)) / 2.25);
                p.colour.setConstant(static_cast<float>(v));
                all.push_back(p);
            }
    return all;
}

} // namespace

TEST_CASE("highlight spots: those painted on irises are found, the brightest first, and no other") {
    const auto found = [](std::vector<MirroredPixel> pixels) {
        subtract_own_colours(pixels);
        return highlight_spots(pixels);
    };
    CHECK(found({}).empty());
    CHECK(found(irises({})).empty());
    const std::vector<HighlightSpot> spots =
        found(irises({{3, 4.3, -2.2, 0.3}, {3, -6, 5, 0.5}, {4, 0, 0, 0.08}, {5, 14, 0, 0.4}}));
    REQUIRE(spots.size() == 4);
    const auto at = [](const HighlightSpot& s, double x, double y) {
        return (s.at - Vec2<double>(40.5 + x, 50.5 + y)).norm();
    };
    CHECK(spots[0].picture == 3);
    CHECK(at(spots[0], -6, 5) < 0.15);
    CHECK(spots[0].brightness == doctest::Approx(0.5).epsilon(0.05));
    CHECK(at(spots[1], 4.3, -2.2) < 0.25);
    CHECK(spots[0].clear());
    CHECK(spots[1].clear());
    CHECK(spots[2].picture == 4);
    CHECK(spots[2].peaks);
    CHECK_FALSE(spots[2].clear()); // faint
    CHECK(spots[3].picture == 5);
    CHECK_FALSE(spots[3].peaks);
    CHECK_FALSE(spots[3].clear()); // cut by the rim
}

TEST_CASE("highlight spots: what renders have of photographs' spots, and what they have besides") {
    Reflections r;
    r.photograph = irises({{3, 4, -2, 0.3}, {3, -6, 5, 0.2}, {5, 0, 3, 0.3}, {8, 1, 1, 0.3}});
    r.render = irises({{3, 5, -2, 0.07}, {5, 0, -5, 0.3}, {8, 1, 3, 0.25}, {9, -3, 0, 0.3}});
    const HighlightMatch m = match_highlights(r);
    CHECK(m.photographs == 3);
    CHECK(m.found == 2); // that of picture 3 is faint, but there
    REQUIRE(m.distance.size() == 2);
    CHECK(m.distance[0] == doctest::Approx(1).epsilon(0.2));
    CHECK(m.distance[1] == doctest::Approx(2).epsilon(0.1));
    CHECK(m.renders == 3);
    CHECK(m.unlike == 2); // pictures 5 and 9
    const auto json = m.json();
    CHECK(json.at("photographs") == 3);
    CHECK(json.at("median_px").get<double>() == doctest::Approx(m.median_distance()));

    Reflections same = r;
    same.render = same.photograph;
    const HighlightMatch all = match_highlights(same);
    CHECK(all.found == all.photographs);
    CHECK(all.unlike == 0);
    CHECK(all.median_distance() == 0);

    r.render = irises({});
    const HighlightMatch none = match_highlights(r);
    CHECK(none.found == 0);
    CHECK(none.json().at("median_px").is_null());
    std::erase_if(r.photograph, [](const MirroredPixel& p) { return p.picture >= 11; });
    CHECK_FAULT(match_highlights(r), "pixels of renders beside");
    std::erase_if(r.render, [](const MirroredPixel& p) { return p.picture >= 11; });
    CHECK(match_highlights(r).pictures == 11);
    CHECK(match_highlights(r).json().is_null()); // too few to know the irises' own colours
}

TEST_CASE("highlight spots: noise is none, and hides no spot that a render is right to have") {
    const std::vector<Painted> painted{{3, 4, -2, 0.6}, {8, 1, 1, 0.12}};
    Reflections r;
    r.photograph = irises(painted, 0.04);
    r.render = irises({{3, 4, -2, 0.5}, {8, 1, 1, 0.15}, {9, -3, 0, 0.3}});
    std::vector<MirroredPixel> noisy = r.photograph;
    subtract_own_colours(noisy);
    int clear = 0;
    for (const HighlightSpot& s : highlight_spots(noisy)) {
        CHECK(s.noise == doctest::Approx(0.04).epsilon(0.2));
        clear += s.clear() ? 1 : 0;
    }
    CHECK(clear == 1); // noise reaches 0.1 in most pictures
    const HighlightMatch m = match_highlights(r);
    CHECK(m.photographs == 1);
    CHECK(m.found == 1);
    CHECK(m.renders == 3);
    CHECK(m.unlike == 1); // of picture 9
}
