// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/tile_quads.hpp: a rectangle of an image's planes on its way from device memory to
/// shared memory: a block reads it into registers, goes on with other work, and writes it.
#pragma once

#include <rye/nn/cuda/image_planes.hpp>

namespace rye {

/// Where a rectangle begins: its first pixel is (x - edge, y - edge), its first channel 8 group.
struct TilePlace {
    int x, y, edge, group;
};

/// A rectangle of wide x tall pixels by 8 groups channels, as `planes` planes of rows of `stride`
/// numbers a pixel; `count` quads of it at a time, by a block of `threads`.
template <int planes_, int wide_, int tall_, int groups_, int stride_>
struct TileShape {
    static constexpr int planes = planes_, wide = wide_, tall = tall_, groups = groups_,
                         stride = stride_;
    static constexpr int rows = wide * tall, quads = planes * rows * groups;
};

/// What a warp of `threads` / 32 has of `count` quads of a rectangle.
template <class W, class Shape, int count, int threads>
struct TileQuads {
    using U = typename W::U;
    static constexpr int own = (count + threads - 1) / threads;
    Array<typename W::F, 4> quad[std::size_t(own)];
    U place[std::size_t(own)]; ///< in shared memory
    typename W::M there[std::size_t(own)];

    /// Quads [begin, begin + count), zero outside the image.
    RYE_DEVICE void read(const DeviceImagePlanes& image, const TilePlace& at, int begin, int w) {
        const auto number = [](int x) { return U(static_cast<std::uint32_t>(x)); };
        const U pixels(static_cast<std::uint32_t>(image.pixels()));
        const int groups = image.padded() / 8;
        const auto* const all = reinterpret_cast<const Quad4*>(image.data);
        expanded<own>([&](auto i) {
            const U index = number(i * threads + 32 * w) + W::lane(), q = number(begin) + index;
            const U row = q / number(Shape::groups) % number(Shape::rows);
            const U plane = q / number(Shape::groups * Shape::rows);
            const U group = q % number(Shape::groups);
            // `edge` more than the place in the image.
            const U x = number(at.x) + row % number(Shape::wide);
            const U y = number(at.y) + row / number(Shape::wide);
            const auto inside = x >= number(at.edge) && x < number(image.width + at.edge) &&
                                y >= number(at.edge) && y < number(image.height + at.edge) &&
                                number(at.group) + group < number(groups);
            const U pixel = (y - number(at.edge)) * number(image.width) + x - number(at.edge);
            const U from = (plane * pixels + pixel) * number(groups) + number(at.group) + group;
            there[i] = index < number(count);
            quad[i] = W::read4_where(there[i] && inside, all, from);
            place[i] = (plane * number(Shape::rows) + row) * number(Shape::stride / 8) + group;
        });
    }
    RYE_DEVICE void write(std::uint16_t* to) const {
        auto* const quads = reinterpret_cast<Quad4*>(to);
        expanded<own>([&](auto i) { W::write4_where(there[i], quads, place[i], quad[i]); });
    }
};

} // namespace rye
