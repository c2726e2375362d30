// SPDX-License-Identifier: Apache-2.0
/// rye/splat/lanes/registers.hpp: parts of all tuned walks: loops over registers, sums of lanes,
/// and prefetches.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>
#include <functional>
#include <type_traits>
#include <utility>

#include <rye/backend/lanes.hpp>
#include <rye/core/aligned.hpp>
#include <rye/math/scalar.hpp>
#include <rye/splat/raster.hpp>

namespace rye {

/// Calls f(0) ... f(N - 1) with constant arguments, so that arrays indexed by them stay in
/// registers.
template <int N, class F>
[[gnu::always_inline]] inline void unrolled(F&& f) {
    [&]<int... I>(std::integer_sequence<int, I...>) __attribute__((always_inline)) {
        (f(std::integral_constant<int, I>()), ...);
    }(std::make_integer_sequence<int, N>());
}

/// N batches that go through a formula side by side: each operation is N in a row that do not wait
/// for each other.
template <class V, int N>
struct Bundle {
    std::array<V, std::size_t(N)> x;

    Bundle() = default;
    /// Sets all N alike.
    template <class S>
        requires std::is_arithmetic_v<S>
    explicit Bundle(S s) {
        x.fill(V(static_cast<typename V::value_type>(s)));
    }

    /// Returns f of each batch and of its counterpart in `other`.
    template <class F>
    [[gnu::always_inline]] Bundle each(const Bundle& other, const F& f) const {
        Bundle r;
        unrolled<N>([&](auto i) __attribute__((always_inline)) { r.x[i] = f(x[i], other.x[i]); });
        return r;
    }
    [[gnu::always_inline]] friend Bundle operator+(const Bundle& a, const Bundle& b) {
        return a.each(b, std::plus<V>());
    }
    [[gnu::always_inline]] friend Bundle operator-(const Bundle& a, const Bundle& b) {
        return a.each(b, std::minus<V>());
    }
    [[gnu::always_inline]] friend Bundle operator*(const Bundle& a, const Bundle& b) {
        return a.each(b, std::multiplies<V>());
    }
    [[gnu::always_inline]] friend Bundle operator/(const Bundle& a, const Bundle& b) {
        return a.each(b, std::divides<V>());
    }
    friend Bundle operator-(const Bundle& a) { return Bundle(0.0) - a; }
    Bundle& operator+=(const Bundle& b) { return *this = *this + b; }
};

namespace detail {

template <class V, int N>
struct RealOf<Bundle<V, N>> {
    using type = typename V::value_type;
};

} // namespace detail

/// True if one instruction fills the lanes with a pair of numbers, over and over.
template <class V>
concept LoadsPairs =
    std::is_same_v<typename V::value_type, float> && 2 * detail::LanesLike<V, double>::type::size ==
    V::size;

/// Returns n numbers over and over; n is 1, or 2 where pairs can be loaded.
template <int n, class V>
[[gnu::always_inline]] inline V repeat(const typename V::value_type* numbers) {
    if constexpr (n == 1) {
        return V(*numbers);
    } else {
        double pair;
        std::memcpy(&pair, numbers, sizeof pair);
        return detail::cast_bits<V>(typename detail::LanesLike<V, double>::type(pair));
    }
}

/// True if a batch is one register of sixteen floats.
template <class V>
concept SixteenFloats = std::is_same_v<typename V::value_type, float> && V::size == 16 &&
                        sizeof(typename V::register_type) == 64;

/// True if one instruction fills the lanes with four numbers, over and over.
template <class V>
concept LoadsFours = SixteenFloats<V> &&
    !std::is_void_v<decltype(detail::load_four_times(std::declval<const float*>()))>;

/// Returns four numbers over and over.
template <LoadsFours V>
[[gnu::always_inline]] inline V repeat_four(const float* numbers) {
    return V(detail::load_four_times(numbers));
}

/// Returns four numbers, each four times in a row.
template <LoadsFours V>
[[gnu::always_inline]] inline V spread_four(const float* numbers) {
    using R = typename V::register_type;
    const R x = R(repeat_four<V>(numbers));
    return V(
        R(__builtin_shufflevector(x, x, 0, 0, 0, 0, 5, 5, 5, 5, 10, 10, 10, 10, 15, 15, 15, 15)));
}

/// Returns the numbers at an address, loaded once though several operations read them: g++ would
/// load them again with each, and a processor loads one vector of sixteen a cycle.
template <class V>
[[gnu::always_inline]] inline V load_once(const typename V::value_type* numbers) {
    V x = V::load_aligned(numbers);
    if constexpr (LoadsFours<V>) detail::in_register(x.data);
    return x;
}

/// Returns i, as a number the compiler knows nothing about: loads at it stay loads. A compiler that
/// turns loads of several lanes into one gather makes them slower.
[[gnu::always_inline]] inline Index opaque(Index i) {
    asm("" : "+r"(i));
    return i;
}

/// Returns the sum of a batch's lanes; the library renamed it.
template <class V>
typename V::value_type lane_sum(const V& x) {
    if constexpr (requires { reduce_add(x); })
        return reduce_add(x);
    else
        return hadd(x);
}

namespace detail {

/// Returns a batch whose lanes 4 i + k, summed over i, are the sums of the lanes of x[k].
template <SixteenFloats V>
[[gnu::always_inline]] inline auto folded_four(const V* x) {
    using R = typename V::register_type;
    const auto pair = [](R a, R b) { // a b a b of each four lanes
        return R(__builtin_shufflevector(a, b, 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13,
                                         29)) +
               R(__builtin_shufflevector(a, b, 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30,
                                         15, 31));
    };
    const R p = pair(R(x[0]), R(x[1])), q = pair(R(x[2]), R(x[3]));
    return R(__builtin_shufflevector(p, q, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28,
                                     29)) +
           R(__builtin_shufflevector(p, q, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30,
                                     31));
}

/// Writes the sums of eight batches' lanes to the eight numbers at `to`.
template <class V>
[[gnu::always_inline]] inline void lane_sums(const std::array<V, 8>& x,
                                             typename V::value_type* to) {
    constexpr std::size_t lanes = V::size;
    if constexpr (SixteenFloats<V>) {
        using R = typename V::register_type;
        const R p = folded_four(x.data()), q = folded_four(x.data() + 4);
        const R both = R(__builtin_shufflevector(p, q, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20,
                                                 21, 22, 23)) +
                       R(__builtin_shufflevector(p, q, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27,
                                                 28, 29, 30, 31));
        const auto sums = __builtin_shufflevector(both, both, 0, 1, 2, 3, 8, 9, 10, 11) +
                          __builtin_shufflevector(both, both, 4, 5, 6, 7, 12, 13, 14, 15);
        std::memcpy(to, &sums, sizeof sums);
    } else if constexpr (8 % lanes == 0)
        for (std::size_t i = 0; i < 8; i += lanes) haddp(x.data() + i).store_unaligned(to + i);
    else
        for (std::size_t i = 0; i < 8; ++i) to[i] = lane_sum(x[i]);
}

/// Prefetches the record of an entry. To be called for one entry at a time between other work: a
/// processor drops prefetches that come faster than it starts them. Always inlined, as prefetch.
template <class T>
[[gnu::always_inline]] inline void fetch_record(const Scene<T>& scene, Index entry) {
    const char* const m = reinterpret_cast<const char*>(&scene.member(entry));
    for (std::size_t at = 0; at < sizeof(VisibleGaussian<T>); at += 64) prefetch(m + at);
}

/// Prefetches the features of an entry, whose record was prefetched before. Always inlined, as
/// fetch_record.
template <class T>
[[gnu::always_inline]] inline void fetch_features(const Scene<T>& scene, Index entry) {
    constexpr Index line = 64 / static_cast<Index>(sizeof(T));
    const T* const f = scene.feature_of(entry);
    for (Index c = 0; c < scene.channels(); c += line) prefetch(f + c);
    prefetch(f + scene.channels() - 1);
}

/// Prefetches, with each entry of a tile that is taken, records that will be: of the same tile two
/// groups of 32 later, and the first ones of the next tile, whose entries lie behind this one's.
template <class T>
struct FetchRecords {
    static constexpr Index ahead = 32; ///< entries
    const Scene<T>& scene;
    Index begin, last;    ///< of the tile's entries that are taken
    Index next, next_end; ///< of the next tile

    /// `end` is that of the tile's entries that are taken.
    FetchRecords(const Scene<T>& s, Index tile, Index end)
        : scene(s),
          begin(s.begin(tile)),
          last(end - 1),
          next(s.end(tile)),
          next_end(std::min(s.trace.lists.entries(), next + 2 * ahead)) {}
    [[gnu::always_inline]] void operator()(Index entry) const {
        fetch_record(scene, std::min(entry + 2 * ahead, last));
        const Index of_next = next + (entry - begin);
        if (of_next < next_end) fetch_record(scene, of_next);
    }
};

/// Returns channels in whole vectors.
template <class V>
constexpr Index padded_channels(Index channels) {
    constexpr Index lanes = static_cast<Index>(V::size);
    return (channels + lanes - 1) / lanes * lanes;
}

/// Copies the features of entries [begin, end) to rows of `stride` numbers, whole vectors or not,
/// with zeros behind the channels.
template <class V>
void copy_features(const Scene<typename V::value_type>& scene, Index begin, Index end,
                   Index stride, typename V::value_type* to) {
    using T = typename V::value_type;
    constexpr Index lanes = static_cast<Index>(V::size);
    const Index channels = scene.channels();
    for (Index k = begin; k < end; ++k, to += stride) {
        const T* from = scene.feature_of(k);
        Index c = 0;
        for (; c + lanes <= channels; c += lanes)
            V::load_unaligned(from + c).store_unaligned(to + c);
        for (; c < channels; ++c) to[c] = from[c];
        for (; c < stride; ++c) to[c] = T(0);
    }
}

} // namespace detail

} // namespace rye
