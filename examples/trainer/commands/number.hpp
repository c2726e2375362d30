// SPDX-License-Identifier: Apache-2.0
/// commands/number.hpp: numbers in printed tables.
#pragma once

#include <cstdio>
#include <string>

namespace rye::trainer {

/// Returns a number with so many decimals.
inline std::string number(double x, int decimals) {
    char text[64];
    std::snprintf(text, sizeof text, "%.*f", decimals, x);
    return text;
}

} // namespace rye::trainer
