// SPDX-License-Identifier: Apache-2.0
/// data/checksums.hpp: checksums of the JSON files that rye writes and reads again, and of the
/// arrays of a capture. A file states its own in the field "checksum": CRC-32 of the rest, as it is
/// written without spaces and by key, so that a file that is only laid out anew keeps it.
/// A file of a run is not for editing: a wrong checksum is an Error. capture.json and the arrays
/// beside it are, and other programs write them: there it is a warning.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <rye/capture/bytes.hpp>

namespace rye::trainer {

/// The text of an object with its checksum as the last field.
std::string checked_text(nlohmann::ordered_json object, int indent);

/// What an object says of itself.
enum class Checked { none, right, wrong };

/// Takes the checksum out of an object and returns whether it was right.
Checked take_checksum(nlohmann::json& object);
Checked take_checksum(nlohmann::ordered_json& object);

/// Parses the object of a file of a run, whose name is `who`, without its checksum. Throws Error
/// for a wrong one; warns of a file without one, as older programs wrote.
nlohmann::ordered_json parse_checked_json(std::string_view text, const std::string& who);

/// Warns on standard error that a file has no checksum.
void warn_unchecked(const std::string& who);

/// Checksum of each .npy file below a folder, by its path from there; .npz and pictures have their
/// own.
nlohmann::ordered_json array_checksums(const std::filesystem::path& folder);

/// A sentence for each file of a capture that is not as capture.json states it was written.
std::vector<std::string> changed_files(const std::filesystem::path& capture);
/// Warns on standard error of each. Hands may have edited it, so it is no error.
void warn_of_changes(const std::filesystem::path& capture);

} // namespace rye::trainer
