// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/strip_output.hpp: a warp's sums for a strip's pixels while it draws them, and
/// their way into images.
#pragma once

#include <rye/splat/cuda/walk.hpp>

namespace rye::detail {

/// A warp's state of its pixels while it draws them.
template <class W, class A, int C>
struct StripSums {
    using F = typename W::F;
    using U = typename W::U;
    static constexpr bool products = ChannelLayout<C>::products;
    F transmittance[8];
    F colour[8][std::size_t(products ? 1 : C)]; ///< colours of the lane's visits
    Array<F, 4> sums[products ? 4 : 1][std::size_t(products ? C / 8 : 1)];
    F depth[A::outputs.depth ? 8 : 1];
    F most[A::outputs.contributor ? 8 : 1];
    U contributor[A::outputs.contributor ? 8 : 1]; ///< number in the tile's list
    bool open;
    std::uint32_t found, done; ///< numbers of visits found, and walked
    std::uint32_t group, last; ///< kept groups: the next, the one before it
};

/// Writes the pixels of a strip to the images.
template <class A, int C>
struct StripOutput {
    using Layout = ChannelLayout<C>;
    const FrameMemory& memory;
    const DeviceScene& scene;
    const DeviceImages& images;

    template <class W>
    RYE_DEVICE void write(StripSums<W, A, C>& s, std::uint32_t tile, int w,
                          [[maybe_unused]] std::uint32_t begin) const {
        repeated<8>(
            [&](auto j) { s.transmittance[j] = W::max(s.transmittance[j], -s.transmittance[j]); });
        const StripPixels<W> pixels(tile, memory.columns, w, scene.width, scene.height);
        write_sums<W>(s, pixels, 1.0F);
        if constexpr (A::outputs.contributor)
            if (scene.first_channel == 0) contributors<W>(s, pixels, begin);
    }

    /// Writes colours before the background, alpha = `one` - transmittance, and depth: with 0 for
    /// `one`, the tangents of them.
    template <class W>
    RYE_DEVICE void write_sums(const StripSums<W, A, C>& s, const StripPixels<W>& pixels,
                               float one) const {
        using F = typename W::F;
        using U = typename W::U;
        const U q = W::lane() % U(4);
        const U row[2] = {q * U(2), q * U(2) + U(1)};
        const auto quad = [](const F& x) {
            const F pair = x + W::template across<1>(x);
            return pair + W::template across<2>(pair);
        };
        const auto put = [&](const F(&x)[8], float* to, std::uint32_t stride, std::uint32_t at) {
            const auto own = own_rows<W>(x);
            repeated<2>([&](auto k) {
                W::write_where(pixels.inside(row[k]), to, pixels.pixel(row[k]) * U(stride) + U(at),
                               own[k]);
            });
        };
        const auto stride = static_cast<std::uint32_t>(images.feature.rows);
        const auto from = static_cast<std::uint32_t>(scene.first_channel);
        if constexpr (Layout::products) {
            const bool pairs = scene.channels == C && stride % 2 == 0 && from % 2 == 0 &&
                               reinterpret_cast<std::uintptr_t>(images.feature.data) % 8 == 0;
            repeated<4>([&](auto m) {
                repeated<C / 8>([&](auto n) {
                    const U c = q * U(2) + U(8 * n);
                    const auto of = [&](const U& channel) {
                        return W::read_where(
                            channel < U(static_cast<std::uint32_t>(scene.channels)),
                            scene.background + from, channel, 0.0F);
                    };
                    const F left = of(c), right = of(c + U(1));
                    repeated<2>([&](auto k) {
                        const F end = s.transmittance[2 * m + k];
                        const F a = W::fma(end, left, s.sums[m][n][2 * k]);
                        const F b = W::fma(end, right, s.sums[m][n][2 * k + 1]);
                        const auto in = pixels.inside(U(2 * m + k));
                        const U to = pixels.pixel(U(2 * m + k)) * U(stride) + U(from) + c;
                        const U channels(static_cast<std::uint32_t>(scene.channels));
                        if (pairs) {
                            W::write2_where(in, images.feature.data, to / U(2), a, b);
                        } else {
                            W::write_where(in && c < channels, images.feature.data, to, a);
                            W::write_where(in && c + U(1) < channels, images.feature.data,
                                           to + U(1), b);
                        }
                    });
                });
            });
        } else {
            repeated<C>([&](auto c) {
                F x[8];
                repeated<8>([&](auto j) {
                    x[j] =
                        W::fma(s.transmittance[j], F(scene.background_of(c)), quad(s.colour[j][c]));
                });
                if (c < scene.channels) put(x, images.feature.data, stride, from + c);
            });
        }
        if (scene.first_channel != 0) return;
        F x[8];
        repeated<8>([&](auto j) { x[j] = F(one) - s.transmittance[j]; });
        put(x, images.alpha.data, 1, 0);
        if constexpr (A::outputs.depth) {
            repeated<8>([&](auto j) { x[j] = quad(s.depth[j]); });
            if (images.depth.data != nullptr) put(x, images.depth.data, 1, 0);
        }
    }

  private:
    /// Writes the contributor of the largest weight among a pixel's four lanes; the nearest if
    /// weights are equal.
    template <class W>
    RYE_DEVICE void contributors(StripSums<W, A, C>& s, const StripPixels<W>& pixels,
                                 std::uint32_t begin) const {
        using F = typename W::F;
        using U = typename W::U;
        const auto better = [](F& most, U& who, const F& other, const U& other_who) {
            const auto take = other > most || (other == most && other_who < who);
            most = select(take, other, most);
            who = select(take, other_who, who);
        };
        repeated<8>([&](auto j) {
            better(s.most[j], s.contributor[j], W::template across<1>(s.most[j]),
                   W::template across<1>(s.contributor[j]));
            better(s.most[j], s.contributor[j], W::template across<2>(s.most[j]),
                   W::template across<2>(s.contributor[j]));
        });
        const auto own = own_rows<W>(s.contributor);
        if (images.contributor.data == nullptr) return;
        repeated<2>([&](auto k) {
            const U row = W::lane() % U(4) * U(2) + U(k);
            const auto has = own[k] < U(no_contributor);
            const U at = select(has, own[k] + U(begin), U(0));
            const U who = select(has, W::read(memory.sorted, at), U(no_contributor));
            W::write_where(pixels.inside(row), images.contributor.data, pixels.pixel(row), who);
        });
    }
};

} // namespace rye::detail
