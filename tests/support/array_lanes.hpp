// SPDX-License-Identifier: Apache-2.0
/// tests/support/array_lanes.hpp: vectors made of plain arrays, with the interface that the kernels
/// use and a backend of them, so that every width of lanes runs on every machine. They are as
/// strict as the strictest instructions: an aligned load or store of another address throws, and a
/// mask is a register of whole numbers, as large as one of floats but not to be taken for one.
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <type_traits>

#include <rye/backend/lanes.hpp>

namespace rye::test {

/// N numbers in memory; what a register of an instruction set is to its vectors. It converts to a
/// number, the first, so that whatever takes a register for a number compiles and is wrong.
template <class T, std::size_t N>
struct ArrayRegister {
    T x[N];

    operator T() const { return x[0]; }
};

[[noreturn, gnu::noinline]] inline void throw_misaligned() {
    throw std::logic_error("aligned load or store of an address that is not aligned");
}
template <std::size_t Bytes, class T>
void require_aligned(T* p) {
    if (reinterpret_cast<std::uintptr_t>(p) % Bytes != 0) throw_misaligned();
}

/// Which of N lanes of numbers T; lanes are all ones or zeros.
template <class T, std::size_t N>
struct ArrayMask {
    using Word = std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint64_t>;
    static constexpr std::size_t size = N;
    ArrayRegister<Word, N> data;

    ArrayMask() = default;
    ArrayMask(bool all) {
        for (Word& w : data.x) w = all ? ~Word(0) : Word(0);
    }
    bool get(std::size_t lane) const { return data.x[lane] != 0; }
    void set(std::size_t lane, bool to) { data.x[lane] = to ? ~Word(0) : Word(0); }
    void store_aligned(bool* to) const {
        require_aligned<N>(to);
        for (std::size_t i = 0; i < N; ++i) to[i] = get(i);
    }

    template <class F>
    [[gnu::noinline]] static ArrayMask each(const F& f) {
        ArrayMask r;
        for (std::size_t i = 0; i < N; ++i) r.set(i, f(i));
        return r;
    }
    friend ArrayMask operator&&(const ArrayMask& a, const ArrayMask& b) {
        return each([&](std::size_t i) { return a.get(i) && b.get(i); });
    }
    friend ArrayMask operator||(const ArrayMask& a, const ArrayMask& b) {
        return each([&](std::size_t i) { return a.get(i) || b.get(i); });
    }
    friend ArrayMask operator!(const ArrayMask& a) {
        return each([&](std::size_t i) { return !a.get(i); });
    }
    friend bool any(const ArrayMask& a) {
        for (std::size_t i = 0; i < N; ++i)
            if (a.get(i)) return true;
        return false;
    }
    friend bool all(const ArrayMask& a) { return !any(!a); }
};

/// N numbers of type T.
template <class T, std::size_t N>
struct alignas(N * sizeof(T)) ArrayLanes {
    using value_type = T;
    using batch_bool_type = ArrayMask<T, N>;
    using Mask = batch_bool_type;
    static constexpr std::size_t size = N, bytes = N * sizeof(T);
    ArrayRegister<T, N> data;

    ArrayLanes() = default;
    ArrayLanes(T all) {
        for (T& x : data.x) x = all;
    }
    T get(std::size_t lane) const { return data.x[lane]; }

    static ArrayLanes load_unaligned(const T* from) {
        ArrayLanes r;
        std::memcpy(r.data.x, from, bytes);
        return r;
    }
    static ArrayLanes load_aligned(const T* from) {
        require_aligned<bytes>(from);
        return load_unaligned(from);
    }
    void store_unaligned(T* to) const { std::memcpy(to, data.x, bytes); }
    void store_aligned(T* to) const {
        require_aligned<bytes>(to);
        store_unaligned(to);
    }

    template <class F>
    [[gnu::noinline]] static ArrayLanes each(const F& f) {
        ArrayLanes r;
        for (std::size_t i = 0; i < N; ++i) r.data.x[i] = f(i);
        return r;
    }
    friend ArrayLanes operator+(const ArrayLanes& a, const ArrayLanes& b) {
        return each([&](std::size_t i) { return wrap(a.bits(i) + b.bits(i)); });
    }
    friend ArrayLanes operator-(const ArrayLanes& a, const ArrayLanes& b) {
        return each([&](std::size_t i) { return wrap(a.bits(i) - b.bits(i)); });
    }
    friend ArrayLanes operator*(const ArrayLanes& a, const ArrayLanes& b) {
        return each([&](std::size_t i) { return a.data.x[i] * b.data.x[i]; });
    }
    friend ArrayLanes operator/(const ArrayLanes& a, const ArrayLanes& b) {
        return each([&](std::size_t i) { return a.data.x[i] / b.data.x[i]; });
    }
    friend ArrayLanes operator<<(const ArrayLanes& a, int places) {
        return each([&](std::size_t i) { return wrap(a.bits(i) << places); });
    }
    friend ArrayLanes operator-(const ArrayLanes& a) {
        return each([&](std::size_t i) { return -a.data.x[i]; });
    }
    friend ArrayLanes operator|(const ArrayLanes& a, const ArrayLanes& b) {
        using Word = typename Mask::Word;
        return each([&](std::size_t i) {
            return std::bit_cast<T>(static_cast<Word>(std::bit_cast<Word>(a.data.x[i]) |
                                                      std::bit_cast<Word>(b.data.x[i])));
        });
    }
    friend ArrayLanes operator&(const ArrayLanes& a, const ArrayLanes& b) {
        using Word = typename Mask::Word;
        return each([&](std::size_t i) {
            return std::bit_cast<T>(static_cast<Word>(std::bit_cast<Word>(a.data.x[i]) &
                                                      std::bit_cast<Word>(b.data.x[i])));
        });
    }
    ArrayLanes& operator+=(const ArrayLanes& b) { return *this = *this + b; }
    ArrayLanes& operator-=(const ArrayLanes& b) { return *this = *this - b; }
    ArrayLanes& operator*=(const ArrayLanes& b) { return *this = *this * b; }
    ArrayLanes& operator/=(const ArrayLanes& b) { return *this = *this / b; }

    friend Mask operator<(const ArrayLanes& a, const ArrayLanes& b) {
        return Mask::each([&](std::size_t i) { return a.data.x[i] < b.data.x[i]; });
    }
    friend Mask operator<=(const ArrayLanes& a, const ArrayLanes& b) {
        return Mask::each([&](std::size_t i) { return a.data.x[i] <= b.data.x[i]; });
    }
    friend Mask operator==(const ArrayLanes& a, const ArrayLanes& b) {
        return Mask::each([&](std::size_t i) { return a.data.x[i] == b.data.x[i]; });
    }
    friend Mask operator!=(const ArrayLanes& a, const ArrayLanes& b) { return !(a == b); }
    friend Mask operator>(const ArrayLanes& a, const ArrayLanes& b) { return b < a; }
    friend Mask operator>=(const ArrayLanes& a, const ArrayLanes& b) { return b <= a; }

    friend ArrayLanes select(const Mask& mask, const ArrayLanes& a, const ArrayLanes& b) {
        return each([&](std::size_t i) { return mask.get(i) ? a.data.x[i] : b.data.x[i]; });
    }
    /// The second where one is not a number, as on x86.
    friend ArrayLanes min(const ArrayLanes& a, const ArrayLanes& b) { return select(a < b, a, b); }
    friend ArrayLanes max(const ArrayLanes& a, const ArrayLanes& b) { return select(a > b, a, b); }
    friend ArrayLanes fma(const ArrayLanes& a, const ArrayLanes& b, const ArrayLanes& c) {
        return a * b + c;
    }
    friend T reduce_add(const ArrayLanes& a) {
        T sum(0);
        for (const T x : a.data.x) sum += x;
        return sum;
    }
    /// The sums of N vectors' lanes.
    friend ArrayLanes haddp(const ArrayLanes* rows) {
        return each([&](std::size_t i) { return reduce_add(rows[i]); });
    }
    friend ArrayLanes abs(const ArrayLanes& a) {
        return through(a, [](T x) { return std::abs(x); });
    }
    friend ArrayLanes sqrt(const ArrayLanes& a) {
        return through(a, [](T x) { return std::sqrt(x); });
    }
    friend ArrayLanes floor(const ArrayLanes& a) {
        return through(a, [](T x) { return std::floor(x); });
    }
    friend ArrayLanes ceil(const ArrayLanes& a) {
        return through(a, [](T x) { return std::ceil(x); });
    }
    friend ArrayLanes exp(const ArrayLanes& a) {
        return through(a, [](T x) { return std::exp(x); });
    }
    friend ArrayLanes exp2(const ArrayLanes& a) {
        return through(a, [](T x) { return std::exp2(x); });
    }
    friend ArrayLanes log(const ArrayLanes& a) {
        return through(a, [](T x) { return std::log(x); });
    }
    friend ArrayLanes log2(const ArrayLanes& a) {
        return through(a, [](T x) { return std::log2(x); });
    }
    friend ArrayLanes log1p(const ArrayLanes& a) {
        return through(a, [](T x) { return std::log1p(x); });
    }
    friend ArrayLanes sin(const ArrayLanes& a) {
        return through(a, [](T x) { return std::sin(x); });
    }
    friend ArrayLanes cos(const ArrayLanes& a) {
        return through(a, [](T x) { return std::cos(x); });
    }
    friend ArrayLanes atan2(const ArrayLanes& a, const ArrayLanes& b) {
        return each([&](std::size_t i) { return std::atan2(a.data.x[i], b.data.x[i]); });
    }
    friend ArrayLanes tanh(const ArrayLanes& a) {
        return through(a, [](T x) { return std::tanh(x); });
    }
    /// The vector of whole numbers as wide as T; only its type is used.
    friend auto to_int(const ArrayLanes&) { return ArrayLanes<Whole, N>(); }

  private:
    using Whole = std::conditional_t<sizeof(T) == 4, std::int32_t, std::int64_t>;
    /// Sums of whole numbers wrap around.
    auto bits(std::size_t i) const {
        if constexpr (std::is_integral_v<T>)
            return static_cast<std::make_unsigned_t<T>>(data.x[i]);
        else
            return data.x[i];
    }
    template <class U>
    static T wrap(U x) {
        return static_cast<T>(x);
    }
    template <class F>
    static ArrayLanes through(const ArrayLanes& a, const F& f) {
        return each([&](std::size_t i) { return f(a.data.x[i]); });
    }
};

/// The same bits as To: a vector, or the numbers that it is to be made of.
template <class To, class T, std::size_t N>
auto bitwise_cast(const ArrayLanes<T, N>& a) {
    if constexpr (std::is_arithmetic_v<To>) {
        return std::bit_cast<ArrayLanes<To, N * sizeof(T) / sizeof(To)>>(a);
    } else {
        return std::bit_cast<To>(a);
    }
}

/// A backend of vectors as large as `Floats` floats.
template <std::size_t Floats, Threads P = Serial>
struct ArrayBackend {
    [[no_unique_address]] P threads{};
    template <Real T>
    using batch = ArrayLanes<T, Floats * sizeof(float) / sizeof(T)>;
};

} // namespace rye::test

namespace rye {

template <class T, std::size_t N>
struct detail::RealOf<test::ArrayLanes<T, N>> {
    using type = T;
};
template <class T, std::size_t N, class U>
struct detail::LanesLike<test::ArrayLanes<T, N>, U> {
    using type = test::ArrayLanes<U, N * sizeof(T) / sizeof(U)>;
};

} // namespace rye
