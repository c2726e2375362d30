// SPDX-License-Identifier: Apache-2.0
/// rye/loss/term.hpp: what a loss of one array returns: its value and gradient together, and over
/// how many numbers the mean was taken. A mean over nothing is 0 with count 0 and an empty or zero
/// gradient, so that a caller can add it up and still see that it was absent.
#pragma once

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>

namespace rye {

template <Scalar T>
struct LossTerm {
    T value = T(0);
    Index count = 0;      ///< numbers in the mean
    Columns<T> gradient;  ///< of the shape of the array
};

} // namespace rye
