// SPDX-License-Identifier: Apache-2.0
/// data/checksums.hpp: checksums of the JSON files that rye writes and reads again, and of the
/// arrays of a capture. A file states its own in the field "checksum": CRC-32 of the rest, written
/// without spaces and sorted by key, so that reformatting a file keeps it. Files of a run are not
/// to be edited: a wrong checksum is an Error. capture.json and the arrays beside it may be edited,
/// and other programs write them: there it is a warning.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <rye/io/bytes.hpp>

namespace rye::trainer {

/// Returns the text of an object with its checksum as the last field.
std::string checked_text(nlohmann::ordered_json object, int indent);

/// State of an object's own checksum.
enum class Checked { none, right, wrong };

/// Removes the checksum from an object and returns its state.
Checked take_checksum(nlohmann::json& object);
Checked take_checksum(nlohmann::ordered_json& object);

/// Parses the object of a file of a run, whose name is `who`, without its checksum. Throws an Error
/// for a wrong one; warns of a file without one, as older programs wrote.
nlohmann::ordered_json parse_checked_json(std::string_view text, const std::string& who);

/// Warns on standard error that a file has no checksum.
void warn_unchecked(const std::string& who);

/// Returns the checksum of each .npy file below a folder, by its relative path; .npz and pictures
/// have their own.
nlohmann::ordered_json array_checksums(const std::filesystem::path& folder);

/// Returns a sentence for each file of a capture that differs from the one that capture.json
/// states.
std::vector<std::string> changed_files(const std::filesystem::path& capture);
/// Warns on standard error of each changed file: it may have been edited, so it is no error.
void warn_of_changes(const std::filesystem::path& capture);

} // namespace rye::trainer
