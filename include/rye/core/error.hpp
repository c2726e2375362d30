// SPDX-License-Identifier: Apache-2.0
/// rye/core/error.hpp: errors in input. A message is "who: what was given, its value, the bound".
#pragma once

#include <stdexcept>
#include <string>

namespace rye {

/// Thrown for invalid input (files, settings, arrays). Violated preconditions are RYE_ASSERT's.
struct Error : std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// Throws Error("who: message") unless the condition holds.
inline void require(bool condition, const std::string& who, const std::string& message) {
    if (!condition) throw Error(who + ": " + message);
}

} // namespace rye
