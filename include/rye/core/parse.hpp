// SPDX-License-Identifier: Apache-2.0
/// rye/core/parse.hpp: text to double, rounded to the nearest, independent of the locale.
#pragma once

#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>

#include <locale.h>
#if !defined(_WIN32)
#if defined(__APPLE__)
#include <xlocale.h>
#endif
#endif

namespace rye {

namespace detail {

/// Reads a number in the notation of C, whatever the locale is.
inline double plain_strtod(std::string& text, char** end) {
#if defined(_WIN32)
    const char point = localeconv()->decimal_point[0];
    for (char& c : text) // another locale's point is none here
        if (c == point || c == '.') c = c == '.' ? point : '!';
    return std::strtod(text.c_str(), end);
#else
    static const locale_t plain = newlocale(LC_ALL_MASK, "C", locale_t());
    return strtod_l(text.c_str(), end, plain);
#endif
}

/// Parses by the C library, but rejects what std::from_chars rejects: spaces, a plus sign,
/// hexadecimals.
inline std::optional<double> parse_by_strtod(std::string_view text) {
    std::string copy(text);              // ends with a zero
    const char first = copy[copy.starts_with('-') ? 1 : 0];
    constexpr std::string_view begins = ".0123456789iInN";
    if (begins.find(first) == begins.npos || copy.find_first_of("xX") != copy.npos) return {};
    const int before = std::exchange(errno, 0);
    char* end = nullptr;
    const double x = plain_strtod(copy, &end);
    const bool beyond = std::exchange(errno, before) == ERANGE && (x == 0 || std::isinf(x));
    if (beyond || end != copy.c_str() + copy.size()) return {};
    return x;
}

/// Parses a double; a template, so that a missing overload of from_chars is no error.
template <class T>
std::optional<T> parse(std::string_view text) {
    if constexpr (requires(const char* p, T& x) { std::from_chars(p, p, x); }) {
        T x{};
        const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), x);
        if (fault != std::errc() || end != text.data() + text.size()) return {};
        return x;
    } else {                             // libc++ before 20, and g++ 12 for Windows
        return parse_by_strtod(text);
    }
}

} // namespace detail

/// Returns the number that the whole text states; accepts "inf" and "nan". Returns nothing if it is
/// not a number, or if a finite number overflows, or a number other than 0 rounds to 0.
inline std::optional<double> parse_double(std::string_view text) {
    return detail::parse<double>(text);
}

} // namespace rye
