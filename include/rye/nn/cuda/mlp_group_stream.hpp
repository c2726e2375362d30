// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_group_stream.hpp: a network's operands in shared memory: all of them, or, where
/// they do not fit, on their way through it, in pieces of up to 128 numbers along K by 128 columns,
/// in the order in which layers need them, again for every tile of points. All groups of a block
/// take every piece; a warp fetches some pieces ahead of those that it takes.
#pragma once

#include <rye/backend/cuda/ring_memory.hpp>
#include <rye/nn/cuda/mlp_group_operands.hpp>

namespace rye::detail {

/// Where pieces begin.
struct MlpGroupPieces {
    static constexpr int most = 6 * DeviceMlpNetwork::most_layers;
    static constexpr int bytes = 2 * 128 * 128; ///< of a piece, at most
    static constexpr int unit = 128;            ///< bytes
    std::uint16_t begin[most + 1] = {};         ///< [units]
    int count = 0;

    /// An operand of k x n numbers, n at most 128.
    void add(int k, int n) {
        for (int at = 0; at < k; at += 128) {
            const int units = 2 * rye::min(128, k - at) * n / unit;
            begin[count + 1] = static_cast<std::uint16_t>(begin[count] + units);
            ++count;
        }
    }
};

/// The pieces as a warp takes them: those of all rounds, one after the other.
template <class W, int slots>
class MlpGroupStream {
  public:
    using Ring = RingMemory<slots, MlpGroupPieces::bytes>;

    RYE_DEVICE MlpGroupStream(Ring& ring, const MlpGroupPieces& pieces, const void* operands,
                              int rounds, int w)
        : ring_(ring),
          pieces_(pieces),
          operands_(static_cast<const unsigned char*>(operands)),
          left_(w == 0 ? rounds * pieces.count : 0) {
        // A slot less than there are: its last piece may still be read by another group.
        repeated<Ring::slots - 2>([&](auto) { fetch(); });
    }
    RYE_DEVICE const unsigned char* take() {
        fetch();
        return W::take(ring_, place_, [&](int k, const auto& copy) { piece(k, copy); });
    }
    RYE_DEVICE void give() {
        W::give(ring_, place_);
        place_.next();
    }
    /// Lets a round's pieces pass.
    RYE_DEVICE void skip() {
        for (int k = 0; k < pieces_.count; ++k) take(), give();
    }

  private:
    template <class Copy>
    RYE_DEVICE void piece(int k, const Copy& copy) const {
        const int at = k % pieces_.count, begin = pieces_.begin[at];
        copy(0, operands_ + Index(begin) * MlpGroupPieces::unit,
             (pieces_.begin[at + 1] - begin) * MlpGroupPieces::unit);
    }
    RYE_DEVICE void fetch() {
        if (next_.piece >= left_) return;
        W::fill(ring_, next_, [&](int k, const auto& copy) { piece(k, copy); });
        next_.next();
    }

    Ring& ring_;
    const MlpGroupPieces& pieces_;
    const unsigned char* operands_;
    int left_; ///< pieces that this warp fetches
    RingPlace<Ring> place_, next_;
};

/// sum (+)= rows times the next operand of n columns.
template <class W, int n, bool onto, int steps, int slots>
RYE_DEVICE void multiply_streamed(Array<typename W::F, std::size_t(n / 2)>& sum,
                                  const GroupRows<W, steps>& rows,
                                  MlpGroupStream<W, slots>& stream) {
    constexpr int pieces = (steps + 7) / 8;
    expanded<pieces>([&](auto p) {
        constexpr int first = 8 * decltype(p)::value, some = rye::min(8, steps - first);
        const unsigned char* const operand = stream.take();
        batch<W>(sum, [&] {
            multiply_group<W, n, onto || (first > 0), steps, first, some>(sum, rows, operand);
        });
        stream.give();
    });
}

/// A ring for all operands at once, or for pieces of them.
template <class Tiles, bool streamed>
using MlpGroupRing =
    std::conditional_t<streamed, RingMemory<Tiles::inputs == 128 ? 5 : 6, MlpGroupPieces::bytes>,
                       RingMemory<1, Tiles::bytes>>;
/// A block's shared memory.
template <class Tiles, bool streamed>
struct MlpGroupShared {
    float bias[std::size_t(Tiles::most_layers)][std::size_t(Tiles::width)];
    MlpGroupRing<Tiles, streamed> operands;
    /// Inputs of points as threads have them in registers, if operands pass through.
    std::uint32_t input[streamed ? Tiles::inputs / 4 : 1][streamed ? 128 * Tiles::groups : 1];
};

/// Returns the rounds of a block: tiles from `first` on, `apart` from one to the next.
RYE_HD inline int rounds_of(std::uint32_t count, int first, int apart) {
    return rye::max(0, (static_cast<int>((count + 63) / 64) - first + apart - 1) / apart);
}

/// Calls f(source of operands, round) for the rounds of a warp of a block whose first group has
/// work in each: a pointer to all operands, or a stream of pieces.
template <class W, class Tiles, bool streamed, class F>
RYE_DEVICE void each_round(MlpGroupRing<Tiles, streamed>& ring, const MlpGroupPieces& pieces,
                           const void* operands, int bytes, int rounds, int w, const F& f) {
    if constexpr (streamed) {
        MlpGroupStream<W, MlpGroupRing<Tiles, true>::slots> stream(ring, pieces, operands, rounds,
                                                                   w);
        for (int r = 0; r < rounds; ++r) f(stream, r);
    } else {
        const auto piece = [&](int, const auto& copy) { copy(0, operands, bytes); };
        const RingPlace<MlpGroupRing<Tiles, streamed>> all;
        if (w == 0) W::fill(ring, all, piece);
        const unsigned char* const at = W::take(ring, all, piece);
        for (int r = 0; r < rounds; ++r) {
            const unsigned char* own = at;
            f(own, r);
        }
    }
}

} // namespace rye::detail
