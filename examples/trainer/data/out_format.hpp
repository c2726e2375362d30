// SPDX-License-Identifier: Apache-2.0
/// data/out_format.hpp: what a file name asks a command to write. Its extension decides, in any
/// case of letters; "-" is standard output, and a name without extension a folder of pictures.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace rye::trainer {

enum class OutFormat { png, jpeg, apng, y4m, y4m_stream, picture_folder, csv };

/// True for formats of more than one picture.
constexpr bool moves(OutFormat f) {
    return f == OutFormat::apng || f == OutFormat::y4m || f == OutFormat::y4m_stream ||
           f == OutFormat::picture_folder;
}

/// ".png", "-", or "a folder (no extension)": how a name asks for the format.
std::string_view name_of(OutFormat format);

/// "a, b or c", of such names.
std::string list_of(const std::vector<OutFormat>& formats);

/// The extension in lower case, with its dot; empty without one, as of a name that begins with it.
std::string extension_of(const std::filesystem::path& path);

/// The one of `known` that the name asks for; Error, which begins with `who` and lists them, if it
/// asks for none of these.
OutFormat out_format(const std::filesystem::path& path, const std::vector<OutFormat>& known,
                     const std::string& who);

} // namespace rye::trainer
