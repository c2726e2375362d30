// SPDX-License-Identifier: Apache-2.0
/// data/memory_limit.hpp: how much memory one file may ask for, or the lists of one picture:
/// --memory of the command. A small file can state large sizes, or unpack to a thousand times its
/// own.
#pragma once

#include <cstdint>
#include <string>

namespace rye::trainer {

/// Bytes; rye's default_memory unless it is set.
std::uint64_t memory_limit();
void set_memory_limit(std::uint64_t bytes);

/// Of a JSON text, which describes other files: an eighth of it.
std::uint64_t json_memory_limit();

/// "3000000000", "512M" or "8G", of 1024 units each; throws Error, which begins with `who`, for
/// anything else and below 1 MiB.
std::uint64_t parsed_memory(const std::string& text, const std::string& who);

} // namespace rye::trainer
