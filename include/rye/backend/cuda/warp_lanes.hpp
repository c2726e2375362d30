// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/warp_lanes.hpp: the lanes of a warp of the host: an array of 32 numbers, with
/// the operators of a number. It stands for a register of a device's warp.
#pragma once

#include <type_traits>

#include <rye/core/concepts.hpp>

namespace rye {

/// A number in each lane of a warp.
template <class T>
struct Lanes {
    static constexpr int count = 32;
    T x[count];

    Lanes() = default;
    Lanes(T same) {
        for (T& l : x) l = same;
    }
    template <class U>
        requires(!std::is_same_v<U, T>)
    explicit Lanes(const Lanes<U>& o) {
        for (int l = 0; l < count; ++l) x[l] = static_cast<T>(o.x[l]);
    }

    /// Returns f of each lane. Never inlined: kernels are long, and the host's compiler would take
    /// minutes.
    template <class F>
    [[gnu::noinline]] static Lanes each(const F& f) {
        Lanes r;
        for (int l = 0; l < count; ++l) r.x[l] = f(l);
        return r;
    }

    friend Lanes operator+(const Lanes& a, const Lanes& b) {
        return each([&](int l) { return T(a.x[l] + b.x[l]); });
    }
    friend Lanes operator-(const Lanes& a, const Lanes& b) {
        return each([&](int l) { return T(a.x[l] - b.x[l]); });
    }
    friend Lanes operator*(const Lanes& a, const Lanes& b) {
        return each([&](int l) { return T(a.x[l] * b.x[l]); });
    }
    friend Lanes operator/(const Lanes& a, const Lanes& b) {
        return each([&](int l) { return T(a.x[l] / b.x[l]); });
    }
    friend Lanes operator%(const Lanes& a, const Lanes& b) {
        return each([&](int l) { return T(a.x[l] % b.x[l]); });
    }
    friend Lanes operator|(const Lanes& a, const Lanes& b) {
        return each([&](int l) { return T(a.x[l] | b.x[l]); });
    }
    friend Lanes operator^(const Lanes& a, const Lanes& b) {
        return each([&](int l) { return T(a.x[l] ^ b.x[l]); });
    }
    friend Lanes operator>>(const Lanes& a, const Lanes& b) {
        return each([&](int l) { return T(a.x[l] >> b.x[l]); });
    }
    friend Lanes operator&(const Lanes& a, const Lanes& b) {
        return each([&](int l) { return T(a.x[l] & b.x[l]); });
    }
    friend Lanes operator-(const Lanes& a) {
        return each([&](int l) { return T(-a.x[l]); });
    }
    Lanes& operator+=(const Lanes& b) { return *this = *this + b; }

    friend Lanes<bool> operator<(const Lanes& a, const Lanes& b) {
        return Lanes<bool>::each([&](int l) { return a.x[l] < b.x[l]; });
    }
    friend Lanes<bool> operator>(const Lanes& a, const Lanes& b) {
        return Lanes<bool>::each([&](int l) { return a.x[l] > b.x[l]; });
    }
    friend Lanes<bool> operator<=(const Lanes& a, const Lanes& b) {
        return Lanes<bool>::each([&](int l) { return a.x[l] <= b.x[l]; });
    }
    friend Lanes<bool> operator>=(const Lanes& a, const Lanes& b) {
        return Lanes<bool>::each([&](int l) { return a.x[l] >= b.x[l]; });
    }
    friend Lanes<bool> operator==(const Lanes& a, const Lanes& b) {
        return Lanes<bool>::each([&](int l) { return a.x[l] == b.x[l]; });
    }
    friend Lanes<bool> operator&&(const Lanes& a, const Lanes& b) requires std::is_same_v<T, bool> {
        return each([&](int l) { return a.x[l] && b.x[l]; });
    }
    friend Lanes<bool> operator||(const Lanes& a, const Lanes& b) requires std::is_same_v<T, bool> {
        return each([&](int l) { return a.x[l] || b.x[l]; });
    }
    friend Lanes<bool> operator!(const Lanes& a) requires std::is_same_v<T, bool> {
        return each([&](int l) { return !a.x[l]; });
    }
};

/// Returns a where c holds, else b, lane by lane.
template <class T>
Lanes<T> select(const Lanes<bool>& c, const Lanes<T>& a, const Lanes<T>& b) {
    return Lanes<T>::each([&](int l) { return c.x[l] ? a.x[l] : b.x[l]; });
}

namespace detail {

template <class T>
struct RealOf<Lanes<T>> {
    using type = T;
};

} // namespace detail

} // namespace rye
