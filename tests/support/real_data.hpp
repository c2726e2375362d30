// SPDX-License-Identifier: Apache-2.0
/// tests/support/real_data.hpp: inputs that rye does not hold. A test without its input says so in
/// a line of its output that cmake/check.sh repeats at its end.
#pragma once

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>

namespace rye::test {

/// `name` in the folder that the environment variable RYE_DATA names; nothing where it is not there.
inline std::optional<std::filesystem::path> real_data(const char* name) {
    const char* const folder = std::getenv("RYE_DATA");
    if (folder == nullptr) {
        std::printf("not run: a test of %s, for RYE_DATA names no folder\n", name);
        return std::nullopt;
    }
    const std::filesystem::path path = std::filesystem::path(folder) / name;
    if (std::filesystem::exists(path)) return path;
    std::printf("not run: a test of %s, for %s has none\n", name, folder);
    return std::nullopt;
}

} // namespace rye::test
