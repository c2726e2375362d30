// SPDX-License-Identifier: Apache-2.0
#include "data/json.hpp"

#include <vector>

#include <rye/core/memory.hpp>

#include "data/memory_limit.hpp"

namespace rye::trainer {
namespace {

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

} // namespace

template <class Json>
Json parse_json_text(std::string_view text, const std::string& who, JsonComments comments) {
    const bool skipped = comments == JsonComments::skipped;
    JsonMemory memory(who);
    nlohmann::json::sax_parse(text, &memory, nlohmann::json::input_format_t::json, true, skipped);
    const auto shallow = [&](int depth, typename Json::parse_event_t, Json&) {
        if (depth > max_json_depth)
            throw Error(who + ": not JSON that is read here: nested deeper than " +
                        std::to_string(max_json_depth) + " levels");
        return true;
    };
    try {
        return Json::parse(text, shallow, true, skipped);
    } catch (const nlohmann::json::exception& e) {
        throw Error(who + ": not JSON: " + e.what());
    }
}
template nlohmann::json parse_json_text(std::string_view, const std::string&, JsonComments);
template nlohmann::ordered_json parse_json_text(std::string_view, const std::string&, JsonComments);

template <class Json>
Json read_json(const std::filesystem::path& path, JsonComments comments) {
    return parse_json_text<Json>(as_text(read_file(path, max_json_bytes)), path.string(), comments);
}
template nlohmann::json read_json(const std::filesystem::path&, JsonComments);
template nlohmann::ordered_json read_json(const std::filesystem::path&, JsonComments);

nlohmann::json json_or_discarded(std::string_view text) {
    return nlohmann::json::parse(text, nullptr, false);
}

} // namespace rye::trainer
