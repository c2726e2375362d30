// SPDX-License-Identifier: Apache-2.0
/// rye/backend/each.hpp: functions of an index over [0, count) on the host: a struct with a name
/// and an operator() that is RYE_HD, so that backend/cuda/each.hpp runs the same one on a device.
/// Arrays that it reads or writes are ColumnArray.
#pragma once

#include <rye/backend/backend.hpp>
#include <rye/core/array.hpp>

namespace rye {

/// Calls f(i) for i in [0, count), in any order and at once.
template <Backend B, class F>
void for_each(const B& backend, Index count, const F& f) {
    for_chunks(backend.threads, count, 256, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i) f(i);
    });
}

namespace detail {

/// F::sums sums of F::Number, which f(i, sums) adds to; one that stays 0 where F has none.
template <class F>
struct SumsOf : Array<typename F::Number, F::sums == 0 ? 1 : std::size_t(F::sums)> {
    SumsOf() {
        for (auto& sum : *this) sum = typename F::Number(0);
    }
    SumsOf& operator+=(const SumsOf& b) {
        for (std::size_t k = 0; k < b.size(); ++k) (*this)[k] += b[k];
        return *this;
    }
};

/// Calls f(i, sums) for i in [0, count); returns the sums, added in an order that the number of
/// threads does not change.
template <Backend B, class F>
SumsOf<F> sum_each(const B& backend, Index count, const F& f) {
    return sum_chunks(backend.threads, count, 256, SumsOf<F>{}, [&](Index b, Index e) {
        SumsOf<F> sums;
        for (Index i = b; i < e; ++i) f(i, sums);
        return sums;
    });
}

} // namespace detail

} // namespace rye
