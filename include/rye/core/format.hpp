// SPDX-License-Identifier: Apache-2.0
/// rye/core/format.hpp: numbers to text, independent of the locale: the shortest text that is read
/// back as the same number. core/parse.hpp is the way back.
#pragma once

#include <charconv>
#include <cmath>
#include <concepts>
#include <cstdio>
#include <limits>
#include <string>
#include <string_view>

#include <rye/core/parse.hpp>

namespace rye {

namespace detail {

/// Formats by snprintf, whose decimal point is the locale's, of one or more bytes: no other byte of
/// a number is unknown.
template <std::floating_point T>
std::string format_by_snprintf(T x) {
    char digits[64];
    for (int n = std::numeric_limits<T>::digits10;; ++n) {
        std::snprintf(digits, sizeof digits, "%.*g", n, static_cast<double>(x));
        constexpr std::string_view known = "0123456789+-einfa";
        std::string text;
        for (const char* c = digits; *c != '\0'; ++c)
            if (known.find(*c) != known.npos) text += *c;
            else if (!text.ends_with('.')) text += '.';
        if (n >= std::numeric_limits<T>::max_digits10) return text;
        const std::optional<double> back = parse_double(text);
        if (back && static_cast<T>(*back) == x) return text;
    }
}

/// Formats a float or a double; a template, so that a missing overload of to_chars is no error.
template <class T>
std::string format(T x) {
    if constexpr (requires(char* p) { std::to_chars(p, p, x); }) {
        char digits[64];
        return {digits, std::to_chars(digits, digits + sizeof digits, x).ptr};
    } else {                             // libc++ before 14
        return format_by_snprintf(x);
    }
}

} // namespace detail

/// Returns a text such as "0.1", "-1e+20", "nan", "inf". Reading it back gives the same number.
template <std::floating_point T>
std::string number_text(T x) {
    if (std::isnan(x)) return "nan";     // to_chars may say more, such as "-nan(ind)"
    return detail::format(x);
}
/// Returns a text such as "-12", without groups of digits.
template <std::integral T>
std::string number_text(T x) {
    return std::to_string(x);
}

} // namespace rye
