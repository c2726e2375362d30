// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/tile_copies.hpp: a rectangle of an image's planes on its way from device memory to
/// shared memory, beside other work. A pixel's groups of 8 channels change places with the pixel's
/// column, so that 8 neighbours of a row, read at once, lie in different banks without padding.
#pragma once

#include <rye/nn/cuda/image_planes.hpp>

namespace rye::detail {

/// Beginning of a rectangle: its first pixel is (x - edge, y - edge), its first channel 8 group.
struct TilePlace {
    int x, y, edge, group;
};

/// A rectangle of wide x tall pixels by 8 groups channels, as `planes` planes, in shared memory.
template <int planes_, int wide_, int tall_, int groups_>
struct TileShape {
    static constexpr int planes = planes_, wide = wide_, tall = tall_, groups = groups_;
    static_assert(groups == 4 || groups == 8);
    static_assert(wide % 2 == 0, "rows begin in the first bank");
    static constexpr int pixel_bytes = 16 * groups, row_bytes = wide * pixel_bytes,
                         plane_bytes = tall * row_bytes;
    static constexpr int rows = planes * tall;

    /// The rectangle in shared memory.
    struct Numbers {
        alignas(16) std::uint16_t at[std::size_t(planes)][std::size_t(plane_bytes / 2)];
    };
    /// Returns the XOR swizzle of a group's slot in the pixel of column x, an involution.
    template <class U>
    RYE_DEVICE static U swapped(const U& group, const U& x) {
        return group ^ (groups == 4 ? x / U(2U) % U(4U) : x % U(8U));
    }
};

/// Starts to copy rows [part[0], part[1]) of a rectangle, those of a plane after those before it,
/// by warp w of `threads` / 32; zeros outside the image. A lane has a group of every few pixels.
template <class W, class Shape, int threads>
RYE_DEVICE void copy_tile(const DeviceImagePlanes& image, const TilePlace& at,
                          typename Shape::Numbers& to, const Array<int, 2>& part, int w) {
    using U = typename W::U;
    const auto number = [](int x) { return U(static_cast<std::uint32_t>(x)); };
    constexpr int groups = Shape::groups, pixels = 32 / groups,
                  steps = (Shape::wide + pixels - 1) / pixels;
    const int all_groups = image.padded() / 8;
    const U lane = W::lane_here(), group = lane % number(groups);
    U source[std::size_t(steps)], target[std::size_t(steps)];
    typename W::M inside[std::size_t(steps)];
    repeated<steps>([&](auto i) {
        // Beyond the rectangle, its last pixel once more.
        const U next = number(i * pixels) + lane / number(groups);
        const U x = select(next < number(Shape::wide), next, number(Shape::wide - 1));
        const U u = x + number(at.x - at.edge); // below 0 it is far above any width
        source[i] = u * number(all_groups) + number(at.group) + group;
        target[i] = x * number(groups) + Shape::swapped(group, x);
        inside[i] = u < number(image.width) && number(at.group) + group < number(all_groups);
    });
    for (int row = part[0] + w; row < part[1]; row += threads / 32) {
        const int plane = Shape::planes == 1 ? 0 : row / Shape::tall;
        const int y = at.y - at.edge + row - plane * Shape::tall;
        const bool in_rows = y >= 0 && y < image.height;
        const auto* const from =
            reinterpret_cast<const Quad4*>(image.data) +
            (plane * image.pixels() + Index(in_rows ? y : 0) * image.width) * all_groups;
        const auto of_image = number(in_rows ? 1 : 0) > U(0U);
        auto* const quads = reinterpret_cast<Quad4*>(&to.at[0][0]) + row * Shape::wide * groups;
        repeated<steps>([&](auto i) {
            W::copy4_or_zero(of_image && inside[i], quads, target[i], from, source[i]);
        });
    }
}

} // namespace rye::detail
