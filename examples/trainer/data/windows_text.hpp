// SPDX-License-Identifier: Apache-2.0
/// data/windows_text.hpp: texts of Windows, of 16-bit units, as UTF-8. For *_windows.cpp only, after
/// <windows.h>.
#pragma once

#include <string>
#include <string_view>

namespace rye::trainer {

inline std::string utf8_of(std::wstring_view text) {
    const int size = static_cast<int>(text.size());
    const int bytes =
        ::WideCharToMultiByte(CP_UTF8, 0, text.data(), size, nullptr, 0, nullptr, nullptr);
    std::string out(static_cast<std::size_t>(bytes), '\0');
    ::WideCharToMultiByte(CP_UTF8, 0, text.data(), size, out.data(), bytes, nullptr, nullptr);
    return out;
}

inline std::wstring wide_of(std::string_view text) {
    const int size = static_cast<int>(text.size());
    const int units = ::MultiByteToWideChar(CP_UTF8, 0, text.data(), size, nullptr, 0);
    std::wstring out(static_cast<std::size_t>(units), L'\0');
    ::MultiByteToWideChar(CP_UTF8, 0, text.data(), size, out.data(), units);
    return out;
}

/// Returns the system's sentence for an error, without its line end.
inline std::string system_text(DWORD error) {
    wchar_t text[512];
    const DWORD size =
        ::FormatMessageW(FORMAT_MESSAGE_FROM_SYSTEM | FORMAT_MESSAGE_IGNORE_INSERTS, nullptr, error,
                         0, text, sizeof text / sizeof *text, nullptr);
    std::string out = utf8_of(std::wstring_view(text, size));
    while (!out.empty() && (out.back() == '\n' || out.back() == '\r' || out.back() == '.'))
        out.pop_back();
    return out.empty() ? "error " + std::to_string(error) : out;
}

} // namespace rye::trainer
