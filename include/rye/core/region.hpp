// SPDX-License-Identifier: Apache-2.0
/// rye/core/region.hpp: the dirty part of an image, as one run of pixels per row. A row's run spans
/// its first to its last dirty pixel; pixels in between count as dirty.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include <rye/core/config.hpp>

namespace rye {

/// Pixels [left, right) x [top, bottom).
struct Window {
    int left = 0, top = 0, right = 0, bottom = 0;

    int width() const { return right - left; }
    int height() const { return bottom - top; }
    bool operator==(const Window&) const = default;
};

/// Dirty pixels of an image: one run in each row.
class Region {
  public:
    /// An empty region of an image.
    Region(int width, int height) : width_(width), rows_(static_cast<std::size_t>(height)) {}

    int width() const { return width_; }
    int height() const { return static_cast<int>(rows_.size()); }
    bool empty() const {
        return std::all_of(rows_.begin(), rows_.end(), [](const Run& r) { return r.empty(); });
    }

    /// Adds the part of the window that lies in the image.
    void add(const Window& w) {
        const Run run{std::max(0, w.left), std::min(width_, w.right)};
        if (run.empty()) return;
        for (int y = std::max(0, w.top); y < std::min(height(), w.bottom); ++y) row(y).add(run);
    }

    /// Adds a region of the same image.
    void add(const Region& o) {
        for (const Window& w : o.bands()) add(w);
    }

    /// Returns the region grown by one pixel on every side, ends of runs rounded outwards to
    /// multiples of `step`, clipped to the image.
    Region grown(int step) const {
        Region r(width_, height());
        for (const Window& w : bands())
            r.add({(std::max(0, w.left - 1)) / step * step, w.top - 1,
                   (w.right + 1 + step - 1) / step * step, w.bottom + 1});
        return r;
    }

    /// Extends runs shorter than `least` to the whole row.
    void widen(int least) {
        for (Run& r : rows_)
            if (!r.empty() && r.end - r.begin < least) r = {0, width_};
    }

    /// Returns rectangles of consecutive rows with the same run, from the top.
    std::vector<Window> bands() const {
        std::vector<Window> bands;
        for (int y = 0; y < height(); ++y) {
            const Run& r = rows_[static_cast<std::size_t>(y)];
            if (r.empty()) continue;
            Window* const last = bands.empty() ? nullptr : &bands.back();
            if (last != nullptr && last->bottom == y && last->left == r.begin &&
                last->right == r.end)
                ++last->bottom;
            else
                bands.push_back({r.begin, y, r.end, y + 1});
        }
        return bands;
    }

  private:
    struct Run {
        int begin = 0, end = 0;
        bool empty() const { return begin >= end; }
        void add(const Run& o) {
            *this = empty() ? o : Run{std::min(begin, o.begin), std::max(end, o.end)};
        }
    };
    Run& row(int y) { return rows_[static_cast<std::size_t>(y)]; }

    int width_;
    std::vector<Run> rows_;
};

} // namespace rye
