// SPDX-License-Identifier: Apache-2.0
#include <rye/core/region.hpp>

#include <vector>

#include <doctest/doctest.h>

using namespace rye;

namespace {

bool holds(const Region& r, int x, int y) {
    for (const Window& w : r.bands())
        if (x >= w.left && x < w.right && y >= w.top && y < w.bottom) return true;
    return false;
}

} // namespace

TEST_CASE("region: what is added, cut to the image, one run a row") {
    Region r(20, 10);
    CHECK(r.empty());
    r.add({-5, 2, 4, 5});
    r.add({18, 4, 40, 50});
    r.add({7, 3, 7, 9});  // no pixel
    CHECK(!r.empty());
    CHECK(r.bands() == std::vector<Window>{{0, 2, 4, 4}, {0, 4, 20, 5}, {18, 5, 20, 10}});
}

TEST_CASE("region: grown, it holds every neighbour, and ends at steps or at the image") {
    for (const int step : {1, 8}) {
        Region r(37, 30);
        r.add({9, 10, 12, 12});
        r.add({30, 20, 37, 21});
        const Region g = r.grown(step);
        for (int y = 0; y < 30; ++y)
            for (int x = 0; x < 37; ++x) {
                bool near = false;
                for (int j = -1; j <= 1; ++j)
                    for (int i = -1; i <= 1; ++i) near = near || holds(r, x + i, y + j);
                if (near) CHECK(holds(g, x, y));
                if (step == 1) CHECK(holds(g, x, y) == near);
            }
        for (const Window& w : g.bands()) {
            CHECK(w.left % step == 0);
            CHECK((w.right % step == 0 || w.right == 37));
        }
    }
}

TEST_CASE("region: narrow runs become whole rows") {
    Region r(40, 4);
    r.add({3, 1, 9, 2});
    r.add({3, 2, 20, 3});
    r.widen(8);
    CHECK(r.bands() == std::vector<Window>{{0, 1, 40, 2}, {3, 2, 20, 3}});
}
