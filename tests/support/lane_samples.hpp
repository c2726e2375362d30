// SPDX-License-Identifier: Apache-2.0
/// tests/support/lane_samples.hpp: random directions and rotations, and lanes made of them.
#pragma once

#include <rye/core/random.hpp>
#include <rye/math/rotation.hpp>

namespace rye {

/// A standard normal vector.
template <class T, int N>
Vec<T, N> normal_vec(std::uint64_t index, std::uint64_t seed = 1) {
    Vec<T, N> v;
    for (int i = 0; i < N; ++i)
        v[i] = static_cast<T>(Random{seed}.normal(index * 16 + static_cast<std::uint64_t>(i)));
    return v;
}

template <class T, int N>
Vec<T, N> unit_vec(std::uint64_t index, std::uint64_t seed = 1) {
    return normalized(normal_vec<T, N>(index, seed));
}

/// One batch entry per lane, filled by f(lane).
template <class Batch, int N, class F>
Vec<Batch, N> lanes_of(F&& f) {
    using T = typename Batch::value_type;
    Vec<Batch, N> r;
    for (int i = 0; i < N; ++i) {
        std::array<T, Batch::size> x;
        for (std::size_t l = 0; l < x.size(); ++l) x[l] = Vec<T, N>(f(l))[i];
        r[i] = Batch::load_unaligned(x.data());
    }
    return r;
}

/// The greatest difference of a lane from f(lane).
template <class Batch, int N, class F>
double lane_gap(const Vec<Batch, N>& v, F&& f) {
    using T = typename Batch::value_type;
    double gap = 0;
    for (std::size_t l = 0; l < Batch::size; ++l) {
        const Vec<T, N> expected = f(l);
        for (int i = 0; i < N; ++i) {
            const double d = std::abs(static_cast<double>(v[i].get(l)) - double(expected[i]));
            gap = d <= gap ? gap : d;  // NaN is the greatest
        }
    }
    return gap;
}

} // namespace rye
