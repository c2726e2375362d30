// SPDX-License-Identifier: Apache-2.0
#include "data/out_format.hpp"

#include <algorithm>

#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

/// Returns all names of a format; the first one is shown.
std::vector<std::string_view> names_of(OutFormat format) {
    switch (format) {
        case OutFormat::png:
            return {".png"};
        case OutFormat::jpeg:
            return {".jpg", ".jpeg"};
        case OutFormat::apng:
            return {".apng"};
        case OutFormat::y4m:
            return {".y4m"};
        case OutFormat::film:
            return {".mp4", ".webm"};
        case OutFormat::y4m_stream:
            return {"- (Y4M on standard output)"};
        case OutFormat::picture_folder:
            return {"no extension (a folder of pictures)"};
        case OutFormat::csv:
            return {".csv"};
    }
    return {};
}

} // namespace

std::string_view name_of(OutFormat format) { return names_of(format).front(); }

std::string list_of(const std::vector<OutFormat>& formats) {
    std::string out;
    for (std::size_t i = 0; i < formats.size(); ++i) {
        if (i > 0) out += i + 1 == formats.size() ? " or " : ", ";
        out += name_of(formats[i]);
    }
    return out;
}

std::string extension_of(const std::filesystem::path& path) {
    std::string e = path.extension().string();
    std::transform(e.begin(), e.end(), e.begin(), [](char c) {
        return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
    });
    return e;
}

OutFormat out_format(const std::filesystem::path& path, const std::vector<OutFormat>& known,
                     const std::string& who) {
    const std::string extension = extension_of(path);
    for (const OutFormat f : known) {
        if (f == OutFormat::y4m_stream && path == "-") return f;
        // A trailing slash leaves no name, and "..." no extension.
        if (f == OutFormat::picture_folder && extension.empty() && path != "-") return f;
        const std::vector<std::string_view> names = names_of(f);
        if (!extension.empty() && std::find(names.begin(), names.end(), extension) != names.end())
            return f;
    }
    throw Error(who + ": got '" + path.string() + "', expected " + list_of(known));
}

} // namespace rye::trainer
