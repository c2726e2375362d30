// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/staged.hpp: a batch of a tile's entries in a block's shared memory, with the lists
/// of those that each strip of 8 x 8 pixels visits. Offsets are from the tile's centre, so that they
/// are small numbers without error.
#pragma once

#include <cstdint>

#include <rye/splat/cuda/records.hpp>

namespace rye {

/// How many bf16 numbers stand for one float in products of matrices: their relative errors are
/// about 2.4e-3, 4.2e-6 and 6e-9. The policy may say so by a static `planes`.
template <class A>
inline constexpr int planes_of = [] {
    if constexpr (requires { A::planes; })
        return A::planes;
    else
        return A::exp2_degree == 0 || A::exp2_degree > 5 || std::derived_from<A, Tight> ? 3 : 2;
}();

/// What a blending kernel reads.
struct DeviceScene {
    DeviceColumns<const float> feature;  ///< C x N
    const float* background;             ///< C numbers
    Index first_channel;                 ///< channels [first, first + channels) are drawn
    int channels;
    float cx, cy;                        ///< [px]
    int width, height;                   ///< [px]

    RYE_DEVICE float background_of(int c) const {
        return c < channels ? background[first_channel + c] : 0.0F;
    }
    RYE_DEVICE float feature_of(std::uint32_t i, int c) const {
        return c < channels ? feature.data[Index(i) * feature.rows + first_channel + c] : 0.0F;
    }
};

/// Entries [0, batch), and one more that reaches no pixel and has the background's colour.
template <class A, int C>
struct Staged {
    using Layout = ChannelLayout<C>;
    static constexpr int batch = Layout::batch;
    static constexpr int none = batch;
    static constexpr int N = planes_of<A>;
    /// Halves of a row of features; the last are idle, so that rows begin in different banks.
    static constexpr int row = Layout::products ? Layout::padded + 8 : 8;

    Quad4 place[batch + 1];              ///< u = x + y px, v = z + w px + vy py
    Quad4 shape[batch + 1];              ///< vy, log2 o, depth, floor
    Quad4 colour[Layout::products ? 1 : batch + 1];
    alignas(16) std::uint16_t plane[Layout::products ? N : 1][Layout::products ? batch + 1 : 1][row];
    alignas(16) std::uint8_t visit[strips][batch + group_visits];
    std::uint32_t visits[strips];        ///< how many
    std::uint32_t word[strips][Layout::words]; ///< a bit an entry
    std::uint8_t reaches[batch];         ///< a bit a strip
    std::uint32_t owner[batch];          ///< the Gaussian

    RYE_DEVICE static float cut_of(const A& accuracy, float floor) {
        using std::log2;
        float least = static_cast<float>(accuracy.alpha_min);
        if constexpr (A::has_floor) least += floor;
        return log2(least);
    }
};

/// Fills a Staged: entry e of `count` is Gaussian owner(e).
template <class A, int C>
struct Stager {
    using Shared = Staged<A, C>;
    using Layout = ChannelLayout<C>;

    const FrameMemory& memory;
    const DeviceScene& scene;
    const A& accuracy;
    float centre_x, centre_y;            ///< of the tile, from the principal point [px]

    RYE_DEVICE Stager(const FrameMemory& m, const DeviceScene& s, const A& a, std::uint32_t tile)
        : memory(m), scene(s), accuracy(a),
          centre_x(static_cast<float>(static_cast<int>(tile % m.columns) * tile_edge +
                                      tile_edge / 2) - s.cx),
          centre_y(static_cast<float>(static_cast<int>(tile / m.columns) * tile_edge +
                                      tile_edge / 2) - s.cy) {}

    /// The entry that reaches no pixel.
    template <class Block>
    RYE_DEVICE void none(Shared& to, int t) const {
        if (t == 0) {
            to.place[Shared::none] = {0, 0, 0, 0};
            to.shape[Shared::none] = {0, -1e30F, 0, 0};
            if constexpr (!Layout::products)
                to.colour[0 + Shared::none] = {scene.background_of(0), scene.background_of(1),
                                               scene.background_of(2), scene.background_of(3)};
        }
        if constexpr (Layout::products)
            if (t < Layout::padded / 2)
                put<Block>(to, Shared::none, t, scene.background_of(2 * t),
                           scene.background_of(2 * t + 1));
    }

    /// Entry t, by thread t: all but its features; with `test`, which strips it reaches, too.
    template <bool test, class Owner>
    RYE_DEVICE void entry(Shared& to, int t, std::uint32_t count, const Owner& owner) const {
        if (t >= Shared::batch) return;
        if (static_cast<std::uint32_t>(t) >= count) {
            to.reaches[t] = 0;
            return;
        }
        const std::uint32_t i = owner(static_cast<std::uint32_t>(t));
        const SplatRecord s = memory.record[i];
        to.owner[t] = i;
        const float dx = centre_x - s.place.x, dy = centre_y - s.place.y;
        const float vx = s.place.w, vy = s.shape.x;
        const Quad4 place{s.place.z * dx, s.place.z, vx * dx + vy * dy, vx};
        to.place[t] = place;
        to.shape[t] = s.shape;
        if constexpr (test) to.reaches[t] = static_cast<std::uint8_t>(reached(place, s.shape));
        if constexpr (!Layout::products)
            to.colour[t] = {scene.feature_of(i, 0), C > 1 ? scene.feature_of(i, 1) : 0.0F,
                            C > 2 ? scene.feature_of(i, 2) : 0.0F,
                            C > 3 ? scene.feature_of(i, 3) : 0.0F};
    }

    /// The features of all entries, by all threads, after `entry`.
    template <class Block>
    RYE_DEVICE void features(Shared& to, int t, std::uint32_t count) const {
        if constexpr (Layout::products) {
            constexpr int quads = Layout::padded / 4;
            const bool whole = scene.channels == C && scene.feature.rows % 4 == 0 &&
                               scene.first_channel % 4 == 0 && C % 4 == 0 &&
                               reinterpret_cast<std::uintptr_t>(scene.feature.data) % 16 == 0;
            for (int k = t; k < static_cast<int>(count) * quads; k += Block::threads) {
                const int e = k / quads, c = k % quads * 4;
                const std::uint32_t i = to.owner[e];
                Quad4 f;
                if (whole && c < C)
                    f = *reinterpret_cast<const Quad4*>(scene.feature.data +
                                                        Index(i) * scene.feature.rows +
                                                        scene.first_channel + c);
                else
                    f = {scene.feature_of(i, c), scene.feature_of(i, c + 1),
                         scene.feature_of(i, c + 2), scene.feature_of(i, c + 3)};
                put<Block>(to, e, c / 2, f.x, f.y);
                put<Block>(to, e, c / 2 + 1, f.z, f.w);
            }
        }
    }

    /// The list of strip w, by its warp.
    template <class W>
    RYE_DEVICE static void list(Shared& to, int w) {
        using U = typename W::U;
        std::uint32_t n = 0;
        for (int k = 0; k < Layout::words; ++k) {
            const U entry = W::lane() + U(static_cast<std::uint32_t>(32 * k));
            const auto reached = (W::read(to.reaches, entry) & U(1U << w)) > U(0);
            const std::uint32_t lanes = W::ballot(reached);
            W::write_where(reached, to.visit[w], U(n) + W::below(lanes), entry);
            W::write_where(W::lane() == U(0), to.word[w], U(static_cast<std::uint32_t>(k)), U(lanes));
            n += W::bits_set(lanes);
        }
        const U rest = U(n) + W::lane();
        W::write_where(W::lane() < U(group_visits), to.visit[w], rest,
                       U(static_cast<std::uint32_t>(Shared::none)));
        W::write_where(W::lane() == U(0), to.visits, U(static_cast<std::uint32_t>(w)), U(n));
    }

    /// Lets entry t reach the strips that an earlier list had it in: word(strip, k) are its bits.
    template <class Word>
    RYE_DEVICE static void again(Shared& to, int t, const Word& word) {
        if (t >= Shared::batch) return;
        std::uint32_t r = 0;
        for (int s = 0; s < strips; ++s) r |= (word(s, t / 32) >> (t % 32) & 1U) << s;
        to.reaches[t] = static_cast<std::uint8_t>(r);
    }

  private:
    template <class Block>
    RYE_DEVICE static void put(Shared& to, int entry, int pair, float a, float b) {
        unrolled<Shared::N>([&](auto p) {
            const std::uint32_t w = Block::pack(a, b);
            reinterpret_cast<std::uint32_t*>(to.plane[p][entry])[pair] = w;
            a -= Block::low(w);
            b -= Block::high(w);
        });
    }

    /// Which strips have a pixel whose exponent reaches the cut: exactly, but for what rounding may
    /// add, which this gives away.
    RYE_DEVICE std::uint32_t reached(const Quad4& place, const Quad4& shape) const {
        const float cut = Shared::cut_of(accuracy, shape.w);
        const float reach = (shape.y - cut) * 1.0001F + 1e-5F;
        std::uint32_t r = 0;
        for (int s = 0; s < strips; ++s) {
            const float left = static_cast<float>(s % 2 * strip_edge) - 7.5F;
            const float top = static_cast<float>(s / 2 * strip_edge) - 7.5F;
            if (least(place, shape.x, left, top) <= reach) r |= 1U << s;
        }
        return r;
    }

    /// The least u^2 + v^2 of a strip's pixels and what lies between them.
    RYE_DEVICE static float least(const Quad4& p, float vy, float left, float top) {
        using std::abs;
        constexpr float side = strip_edge - 1, rounding = 1e-6F;
        const float right = left + side, bottom = top + side;
        const float du = rounding * (abs(p.x) + 8 * abs(p.y));
        const float dv = rounding * (abs(p.z) + 8 * abs(p.w) + 8 * abs(vy));
        // The centre inside: u and v are both 0 at some point of it.
        const float ul = p.x + p.y * left, ur = p.x + p.y * right;
        const float at_left = p.z + p.w * left, at_right = p.z + p.w * right;
        float best = rye::min(beside(ul, at_left + vy * top, at_left + vy * bottom, du, dv),
                              beside(ur, at_right + vy * top, at_right + vy * bottom, du, dv));
        best = rye::min(best, above(p, p.z + vy * top, left, right, du, dv));
        best = rye::min(best, above(p, p.z + vy * bottom, left, right, du, dv));
        if (nearest(ul, ur, du) == 0.0F && p.y != 0.0F) {
            const float x = -p.x / p.y;                    // of the centre, between left and right
            const float v = p.z + p.w * x;
            if (nearest(v + vy * top, v + vy * bottom, 4 * dv) == 0.0F) best = 0.0F;
        }
        return best;
    }
    /// The least |x| of an interval, less what rounding may take away.
    RYE_DEVICE static float nearest(float a, float b, float slack) {
        using std::abs;
        const bool crosses = (a <= slack && b >= -slack) || (b <= slack && a >= -slack);
        return crosses ? 0.0F : rye::min(abs(a), abs(b)) - slack;
    }
    /// The least of a vertical edge, from u there and v at both of its ends.
    RYE_DEVICE static float beside(float u, float top, float bottom, float du, float dv) {
        const float a = nearest(u, u, du), b = nearest(top, bottom, dv);
        return a * a + b * b;
    }
    /// The least of a horizontal edge, v being `v` in the middle column.
    RYE_DEVICE static float above(const Quad4& p, float v, float left, float right, float du,
                                  float dv) {
        const float square = p.y * p.y + p.w * p.w;
        float x = square > 0.0F ? -(p.x * p.y + v * p.w) / square : 0.0F;
        x = rye::min(right, rye::max(left, x));
        const float a = nearest(p.x + p.y * x, p.x + p.y * x, du);
        const float b = nearest(v + p.w * x, v + p.w * x, dv);
        return a * a + b * b;
    }
};

} // namespace rye
