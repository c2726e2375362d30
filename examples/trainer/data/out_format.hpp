// SPDX-License-Identifier: Apache-2.0
/// data/out_format.hpp: formats of output files by name. The extension decides, in upper or lower
/// case; "-" is standard output, and a name without extension a folder of pictures.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace rye::trainer {

enum class OutFormat { png, jpeg, apng, y4m, y4m_stream, film, picture_folder, csv };

/// Returns true for formats of more than one picture.
constexpr bool moves(OutFormat f) {
    return f == OutFormat::apng || f == OutFormat::y4m || f == OutFormat::y4m_stream ||
           f == OutFormat::film || f == OutFormat::picture_folder;
}

/// Returns the way to ask for a format: ".png", "-", or "a folder (no extension)".
std::string_view name_of(OutFormat format);

/// Returns "a, b or c", of such names.
std::string list_of(const std::vector<OutFormat>& formats);

/// Returns the extension in lower case, with its dot; empty if there is none, as in a name that
/// begins with the dot.
std::string extension_of(const std::filesystem::path& path);

/// Returns the one of `known` that the name asks for; if there is none, throws an Error that begins
/// with `who` and lists them.
OutFormat out_format(const std::filesystem::path& path, const std::vector<OutFormat>& known,
                     const std::string& who);

} // namespace rye::trainer
