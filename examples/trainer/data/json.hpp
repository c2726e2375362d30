// SPDX-License-Identifier: Apache-2.0
/// data/json.hpp: parsing of untrusted JSON with nlohmann's parser, with a limit on nesting.
/// The library copies, compares and prints values recursively: a text of 100,000 brackets would
/// overflow the stack in any of these.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

#include <rye/capture/bytes.hpp>
#include <rye/core/error.hpp>

namespace rye::trainer {

inline constexpr int max_json_depth = 64;
inline constexpr std::uint64_t max_json_bytes = 1ULL << 26U;

enum class JsonComments { refused, skipped };

/// Parses a text; errors begin with `who`. Throws Error if it is not JSON, or is nested deeper than
/// max_json_depth.
template <class Json = nlohmann::json>
Json parse_json_text(std::string_view text, const std::string& who,
                     JsonComments comments = JsonComments::refused) {
    const auto shallow = [&](int depth, typename Json::parse_event_t, Json&) {
        if (depth > max_json_depth)
            throw Error(who + ": not JSON that is read here: nested deeper than " +
                        std::to_string(max_json_depth) + " levels");
        return true;
    };
    try {
        return Json::parse(text, shallow, true, comments == JsonComments::skipped);
    } catch (const nlohmann::json::exception& e) {
        throw Error(who + ": not JSON: " + e.what());
    }
}

/// Parses a whole file.
template <class Json = nlohmann::json>
Json read_json(const std::filesystem::path& path,
               JsonComments comments = JsonComments::refused) {
    return parse_json_text<Json>(as_text(read_file(path, max_json_bytes)), path.string(), comments);
}

} // namespace rye::trainer
