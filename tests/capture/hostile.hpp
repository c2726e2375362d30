// SPDX-License-Identifier: Apache-2.0
/// tests/capture/hostile.hpp: what the tests of readers and writers share.
#pragma once

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <string>

#include <doctest/doctest.h>

#include <rye/core/error.hpp>

/// The expression throws an Error whose sentence holds `words`.
#define CHECK_FAULT(expression, words)                                       \
    do {                                                                     \
        std::string told_ = "nothing was thrown";                            \
        try {                                                                \
            static_cast<void>(expression);                                   \
        } catch (const rye::Error& fault_) {                                 \
            told_ = fault_.what();                                           \
        }                                                                    \
        INFO("said: ", told_);                                               \
        CHECK(told_.find(words) != std::string::npos);                       \
    } while (false)

/// A folder of its own for a test, removed with all in it.
struct TemporaryFolder {
    TemporaryFolder() {
        std::string name = (std::filesystem::temp_directory_path() / "rye-test-XXXXXX").string();
        REQUIRE(::mkdtemp(name.data()) != nullptr);
        path = name;
    }
    TemporaryFolder(const TemporaryFolder&) = delete;
    TemporaryFolder& operator=(const TemporaryFolder&) = delete;
    ~TemporaryFolder() {
        std::error_code ignored;
        std::filesystem::remove_all(path, ignored);
    }
    std::filesystem::path path;
};

inline std::size_t files_in(const std::filesystem::path& folder) {
    std::size_t n = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
        static_cast<void>(entry);
        ++n;
    }
    return n;
}
