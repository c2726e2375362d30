// SPDX-License-Identifier: Apache-2.0
#include "data/checksums.hpp"

#include <algorithm>
#include <iostream>

#include <rye/core/checksum.hpp>
#include <rye/core/error.hpp>

#include "data/json.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
constexpr const char* checksum_field = "checksum";

template <class Json>
std::string checksum_of(const Json& object) {
    // Parsed again with sorted keys, so that the text depends on the content alone.
    const std::string text = json_or_discarded(object.dump()).dump();
    return checksum_text(crc32(as_bytes(text)));
}

template <class Json>
Checked taken(Json& object) {
    if (!object.is_object() || !object.contains(checksum_field)) return Checked::none;
    const Json stated = object.at(checksum_field);
    object.erase(checksum_field);
    return stated == checksum_of(object) ? Checked::right : Checked::wrong;
}

} // namespace

std::string checked_text(nlohmann::ordered_json object, int indent) {
    object.erase(checksum_field); // of the file it was read from
    object[checksum_field] = checksum_of(object);
    return object.dump(indent) + "\n";
}

Checked take_checksum(nlohmann::json& object) { return taken(object); }
Checked take_checksum(nlohmann::ordered_json& object) { return taken(object); }

void warn_unchecked(const std::string& who) {
    std::cerr << "rye: warning: " << who
              << ": has no checksum, as files of older versions: damage to it does not show\n";
}

nlohmann::ordered_json parse_checked_json(std::string_view text, const std::string& who) {
    auto json = parse_json_text<nlohmann::ordered_json>(text, who);
    const Checked checked = take_checksum(json);
    require(checked != Checked::wrong, who,
            "field 'checksum': is not that of the other fields: the file is damaged");
    if (checked == Checked::none) warn_unchecked(who);
    return json;
}

nlohmann::ordered_json array_checksums(const fs::path& folder) {
    std::vector<std::string> names;
    for (const auto& entry : fs::recursive_directory_iterator(folder))
        if (entry.is_regular_file() && entry.path().extension() == ".npy")
            names.push_back(entry.path().lexically_relative(folder).generic_string());
    std::sort(names.begin(), names.end());
    auto all = nlohmann::ordered_json::object();
    for (const std::string& name : names) all[name] = checksum_text(crc32(read_file(folder / name)));
    return all;
}

std::vector<std::string> changed_files(const fs::path& capture) {
    const fs::path description = capture / "capture.json";
    std::vector<std::string> changed;
    if (!fs::exists(description)) return changed;
    nlohmann::json json;
    try {
        json = read_json(description);
    } catch (const Error&) { // reported by the reader
        return changed;
    }
    const auto note = [&](const fs::path& path, const char* what) {
        changed.push_back(path.string() + ": " + what +
                          ": is not as it was written: edited, or damaged");
    };
    if (take_checksum(json) == Checked::wrong) note(description, "field 'checksum'");
    if (!json.is_object() || !json.contains("checksums") || !json.at("checksums").is_object())
        return changed;
    for (const auto& [name, stated] : json.at("checksums").items()) {
        const fs::path path = capture / name;
        std::error_code none;
        if (fs::path(name).is_absolute() || name.find("..") != std::string::npos ||
            !fs::is_regular_file(path, none))
            continue; // reported by the reader as missing
        if (stated != checksum_text(crc32(read_file(path))))
            note(path, "its checksum in capture.json");
    }
    return changed;
}

void warn_of_changes(const fs::path& capture) {
    for (const std::string& sentence : changed_files(capture))
        std::cerr << "rye: warning: " << sentence << "\n";
}

} // namespace rye::trainer
