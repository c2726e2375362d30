// SPDX-License-Identifier: Apache-2.0
/// tests/support/hostile.hpp: shared by the tests of readers and writers.
#pragma once

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <string>
#include <system_error>

#include <doctest/doctest.h>

#include <rye/core/error.hpp>

/// Checks that the expression throws an Error with a message that contains `words`.
#define CHECK_FAULT(expression, words)                 \
    do {                                               \
        std::string told_ = "nothing was thrown";      \
        try {                                          \
            static_cast<void>(expression);             \
        } catch (const rye::Error& fault_) {           \
            told_ = fault_.what();                     \
        }                                              \
        INFO("said: ", told_);                         \
        CHECK(told_.find(words) != std::string::npos); \
    } while (false)

/// A temporary folder, removed with its contents.
struct TemporaryFolder {
    TemporaryFolder() {
        // In memory where possible: a test that writes a hundred durable files should not wait for
        // a disk.
        std::error_code ignored;
        const std::filesystem::path memory = "/dev/shm";
        const bool has =
            std::filesystem::is_directory(memory, ignored) && ::access(memory.c_str(), W_OK) == 0;
        const auto base = has ? memory : std::filesystem::temp_directory_path();
        std::string name = (base / "rye-test-XXXXXX").string();
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
