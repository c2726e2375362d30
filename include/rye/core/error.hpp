// SPDX-License-Identifier: Apache-2.0
/// rye/core/error.hpp: bad input from outside. Every message reads "who: got ..., expected ...".
#pragma once

#include <stdexcept>
#include <string>

namespace rye {

/// Thrown for bad input (files, settings, arrays). A broken contract of the caller is RYE_ASSERT.
struct Error : std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// Throws Error("who: sentence") unless the condition holds.
inline void require(bool condition, const std::string& who, const std::string& sentence) {
    if (!condition) throw Error(who + ": " + sentence);
}

} // namespace rye
