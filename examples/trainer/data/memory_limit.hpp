// SPDX-License-Identifier: Apache-2.0
/// data/memory_limit.hpp: limit on the memory for one file, or for the lists of one picture:
/// --memory of the command. A small file can state large sizes, or unpack to a thousand times its
/// own.
#pragma once

#include <cstdint>
#include <string>

namespace rye::trainer {

/// Returns the limit [bytes]: rye's default_memory unless it is set.
std::uint64_t memory_limit();
void set_memory_limit(std::uint64_t bytes);

/// Returns the limit for a JSON text, which describes other files: an eighth of memory_limit().
std::uint64_t json_memory_limit();

/// Parses "3000000000", "512M" or "8G", in units of 1024; throws an Error that begins with `who`
/// for anything else and below 1 MiB.
std::uint64_t parsed_memory(const std::string& text, const std::string& who);

} // namespace rye::trainer
