// SPDX-License-Identifier: Apache-2.0
/// data/json.hpp: parsing of untrusted JSON with nlohmann's parser, with limits on nesting and on
/// memory. The library copies, compares and prints values recursively: a text of 100,000 brackets
/// would overflow the stack in any of these. A value of two bytes takes fifty.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

#include <rye/io/bytes.hpp>
#include <rye/core/error.hpp>

namespace rye::trainer {

inline constexpr int max_json_depth = 64;
inline constexpr std::uint64_t max_json_bytes = 1ULL << 26U;

enum class JsonComments { refused, skipped };

/// Parses a text; errors begin with `who`. Throws an Error if it is not JSON, is nested deeper than
/// max_json_depth, or would take more memory than json_memory_limit(). For nlohmann::json and
/// ordered_json: json.cpp alone compiles their parsers.
template <class Json = nlohmann::json>
Json parse_json_text(std::string_view text, const std::string& who,
                     JsonComments comments = JsonComments::refused);

/// Parses a whole file.
template <class Json = nlohmann::json>
Json read_json(const std::filesystem::path& path, JsonComments comments = JsonComments::refused);

/// Returns the value of a text that the program may have written; it is_discarded() if this is not
/// JSON.
nlohmann::json json_or_discarded(std::string_view text);

} // namespace rye::trainer
