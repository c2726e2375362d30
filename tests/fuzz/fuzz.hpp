// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/fuzz.hpp: shared by the fuzz targets. A reader given any bytes returns, or throws an
/// Error that names the input; every other exception, a sanitizer's report, a time-out or a large
/// allocation ends the run as a crash.
#pragma once

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include <rye/io/bytes.hpp>
#include <rye/core/error.hpp>

namespace rye::fuzz {

inline const std::string name = "some-input";

inline ByteSpan bytes_of(const std::uint8_t* data, std::size_t size) {
    return std::as_bytes(std::span(data, size));
}

/// Ends the program as a crash if a condition of a target does not hold.
inline void demand(bool holds, const char* sentence) {
    if (holds) return;
    std::fprintf(stderr, "not so: %s\n", sentence);
    std::abort();
}

/// Calls read(), which may throw an Error that contains `who`.
template <class F>
void attempt(F&& read, std::string_view who = name) {
    try {
        read();
    } catch (const Error& e) {
        if (std::string_view(e.what()).find(who) == std::string_view::npos)
            std::fprintf(stderr, "the message: %s\n", e.what());
        demand(std::string_view(e.what()).find(who) != std::string_view::npos,
               "an Error names its file");
    }
}

/// A copy of the input in which no checksum is found: the first "checksum" has another name. What a
/// checksum would refuse is read too.
inline Bytes unchecked(const std::uint8_t* data, std::size_t size) {
    Bytes bytes(bytes_of(data, size).begin(), bytes_of(data, size).end());
    const std::size_t at = as_text(ByteSpan(bytes)).find("checksum");
    if (at != std::string_view::npos) bytes[at + 7] = std::byte{'n'};
    return bytes;
}

/// A folder for targets that read files, removed at the end.
struct Folder {
    Folder() {
        std::string made = (std::filesystem::temp_directory_path() / "rye-fuzz-XXXXXX").string();
        demand(::mkdtemp(made.data()) != nullptr, "a temporary folder can be made");
        path = made;
    }
    ~Folder() {
        std::error_code ignored;
        std::filesystem::remove_all(path, ignored);
    }
    std::filesystem::path path;
};

} // namespace rye::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);
