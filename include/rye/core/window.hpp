// SPDX-License-Identifier: Apache-2.0
/// rye/core/window.hpp: rectangles of an image, in whole pixels, and how to cover marked cells of
/// a grid with a few of them.
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
    bool empty() const { return left >= right || top >= bottom; }
    bool operator==(const Window&) const = default;

    /// `by` pixels more on every side, inside an image of width x height.
    Window grown(int by, int w, int h) const {
        return {std::max(0, left - by), std::max(0, top - by), std::min(w, right + by),
                std::min(h, bottom + by)};
    }
    bool overlaps(const Window& o) const {
        return left < o.right && o.left < right && top < o.bottom && o.top < bottom;
    }
    Window joined(const Window& o) const {
        return {std::min(left, o.left), std::min(top, o.top), std::max(right, o.right),
                std::max(bottom, o.bottom)};
    }
};

/// Adds a window to some that do not overlap; those that it overlaps become one with it.
inline void add_window(std::vector<Window>& windows, Window w) {
    if (w.empty()) return;
    for (std::size_t k = 0; k < windows.size();) {
        if (!windows[k].overlaps(w)) {
            ++k;
            continue;
        }
        w = w.joined(windows[k]);
        windows[k] = windows.back();
        windows.pop_back();
        k = 0;  // it has grown
    }
    windows.push_back(w);
}

/// Windows that hold the cells of a grid of `columns` cells a row, each `edge` pixels: one for each
/// group of cells that touch, corners included. Cells ascend.
inline std::vector<Window> windows_of_cells(const std::vector<Index>& cells, int columns, int edge,
                                            int width, int height) {
    std::vector<Window> windows;  // grown by a pixel, so that neighbours overlap
    for (std::size_t k = 0; k < cells.size();) {
        std::size_t last = k;     // of a run in one row
        while (last + 1 < cells.size() && cells[last + 1] == cells[last] + 1 &&
               cells[last + 1] % columns != 0)
            ++last;
        const int x = static_cast<int>(cells[k] % columns) * edge;
        const int y = static_cast<int>(cells[k] / columns) * edge;
        const int right = (static_cast<int>(cells[last] % columns) + 1) * edge;
        add_window(windows, {x - 1, y - 1, right + 1, y + edge + 1});
        k = last + 1;
    }
    for (Window& w : windows)
        w = {w.left + 1, w.top + 1, std::min(width, w.right - 1), std::min(height, w.bottom - 1)};
    return windows;
}

} // namespace rye
