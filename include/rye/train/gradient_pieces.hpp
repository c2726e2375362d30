// SPDX-License-Identifier: Apache-2.0
/// rye/train/gradient_pieces.hpp: gradients of the pieces of a step. Pieces run side by side, each
/// on one thread, and are added in order, so that any number of threads gives the same bits.
#pragma once

#include <cstddef>
#include <vector>

#include <rye/backend/backend.hpp>
#include <rye/core/columns.hpp>

namespace rye::detail {

/// Gradients of a step's pieces with respect to parameters P.
template <class P, class T>
class GradientPieces {
  public:
    /// Makes `count` pieces of the shape of `sum`, of which `arrays(P&)` returns the arrays that
    /// have gradients. Keeps a reference to `sum`, whose other arrays stay as they are.
    template <class Arrays>
    GradientPieces(P& sum, std::size_t count, const Arrays& arrays) : pieces_(count) {
        for (Piece& p : pieces_) {
            p.gradient = sum;
            p.arrays = arrays(p.gradient);
        }
        for (std::size_t k = 0; Columns<T>* const to : arrays(sum)) {
            sums_.push_back({to->size(), [this, to, k](Index b, Index e) {
                                 auto part = to->reshaped().segment(b, e - b);
                                 part.setZero();
                                 for (const Piece& p : pieces_)
                                     part += p.arrays[k]->reshaped().segment(b, e - b);
                             }});
            ++k;
        }
    }
    GradientPieces(const GradientPieces&) = delete;
    GradientPieces& operator=(const GradientPieces&) = delete;

    /// Sets the arrays of piece i to zero and returns it.
    P& cleared(std::size_t i) {
        for (Columns<T>* const a : pieces_[i].arrays) a->setZero();
        return pieces_[i].gradient;
    }
    /// Sets the arrays of the sum.
    template <class Threads>
    void add_up(const Threads& threads) const {
        for_chunks(threads, sums_, 8192);
    }

  private:
    struct Piece {
        P gradient;
        std::vector<Columns<T>*> arrays; ///< of the gradient
    };
    std::vector<Piece> pieces_;
    std::vector<ArrayWork> sums_;
};

} // namespace rye::detail
