// SPDX-License-Identifier: Apache-2.0
/// tests/support/file_bytes.hpp: a whole file as bytes.
#pragma once

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

/// Returns the bytes of the file; none if it cannot be read.
inline std::string bytes_of(const std::filesystem::path& file) {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}
