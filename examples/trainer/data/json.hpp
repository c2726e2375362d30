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

#include <rye/capture/bytes.hpp>
#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>

#include "data/memory_limit.hpp"

namespace rye::trainer {

inline constexpr int max_json_depth = 64;
inline constexpr std::uint64_t max_json_bytes = 1ULL << 26U;

enum class JsonComments { refused, skipped };

/// Counter of the memory of a text's values; throws an Error beyond the limit.
class JsonMemory {
  public:
    explicit JsonMemory(const std::string& who) : who_(who) {}

    bool null() { return add(value); }
    bool boolean(bool) { return add(value); }
    bool number_integer(std::int64_t) { return add(value); }
    bool number_unsigned(std::uint64_t) { return add(value); }
    bool number_float(double, const std::string&) { return add(value); }
    bool string(const std::string& s) { return add(value + text + s.size()); }
    bool binary(const std::vector<std::uint8_t>& b) { return add(value + b.size()); }
    bool start_object(std::size_t) { return add(value + text); }
    bool key(const std::string& s) { return add(node + s.size()); }
    bool end_object() { return true; }
    bool start_array(std::size_t) { return add(value + text); }
    bool end_array() { return true; }
    bool parse_error(std::size_t, const std::string&, const nlohmann::detail::exception&) {
        return false; // reported by the parser that makes values
    }

  private:
    /// Memory of a value in a list that has grown to twice its length, of a string or list without
    /// its contents, of a member of an object without its value [bytes].
    static constexpr std::uint64_t value = 3 * sizeof(nlohmann::json), text = 64, node = 96;

    bool add(std::uint64_t bytes) {
        bytes_ += bytes;
        require_memory(bytes_, json_memory_limit(), who_, "its values to here");
        return true;
    }

    const std::string& who_;
    std::uint64_t bytes_ = 0;
};

/// Parses a text; errors begin with `who`. Throws an Error if it is not JSON, is nested deeper than
/// max_json_depth, or would take more memory than json_memory_limit().
template <class Json = nlohmann::json>
Json parse_json_text(std::string_view text, const std::string& who,
                     JsonComments comments = JsonComments::refused) {
    JsonMemory memory(who);
    Json::sax_parse(text, &memory, Json::input_format_t::json, true,
                    comments == JsonComments::skipped);
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
