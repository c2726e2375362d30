// SPDX-License-Identifier: Apache-2.0
/// rye/core/error.hpp: errors in input. A message is "who: what was given, its value, the bound".
#pragma once

#include <concepts>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>

#include <rye/core/format.hpp>

namespace rye {

/// Thrown for invalid input (files, settings, arrays). Violated preconditions are RYE_ASSERT's.
struct Error : std::runtime_error {
    using std::runtime_error::runtime_error;
};

namespace detail {

/// Appends a piece of a message: a number as number_text writes it, a callable's result, or text.
template <class Piece>
void append_piece(std::string& message, const Piece& piece) {
    if constexpr (std::same_as<Piece, char>)
        message += piece;
    else if constexpr (std::is_arithmetic_v<Piece>)
        message += number_text(piece);
    else if constexpr (std::is_invocable_v<const Piece&>)
        append_piece(message, piece());
    else if constexpr (std::is_convertible_v<const Piece&, std::string_view>)
        message += std::string_view(piece);
    else
        message += std::string(piece);
}

} // namespace detail

/// Throws Error("who: pieces...") unless the condition holds. Pieces are texts, numbers and
/// callables that return one of these; they are joined, and callables called, only for the message.
template <class Who, class... Pieces>
void require(bool condition, const Who& who, const Pieces&... pieces) {
    if (condition) return;
    std::string message;
    detail::append_piece(message, who);
    message += ": ";
    (detail::append_piece(message, pieces), ...);
    throw Error(message);
}

} // namespace rye
