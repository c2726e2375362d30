// SPDX-License-Identifier: Apache-2.0
#include "data/memory_limit.hpp"

#include <atomic>
#include <charconv>

#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>

namespace rye::trainer {
namespace {

std::atomic<std::uint64_t>& limit() {
    static std::atomic<std::uint64_t> bytes = default_memory;
    return bytes;
}

} // namespace

std::uint64_t memory_limit() { return limit(); }
void set_memory_limit(std::uint64_t bytes) { limit() = bytes; }

std::uint64_t json_memory_limit() { return memory_limit() / 8; }

std::uint64_t parsed_memory(const std::string& text, const std::string& who) {
    std::uint64_t number = 0;
    const char* const end = text.data() + text.size();
    const auto [at, fault] = std::from_chars(text.data(), end, number);
    std::uint64_t unit = 1;
    bool read = fault == std::errc();
    if (read && at != end) {
        const std::string suffix(at, end);
        unit = suffix == "K" ? 1U << 10U : suffix == "M" ? 1U << 20U : suffix == "G" ? 1U << 30U : 0;
        read = unit != 0;
    }
    const std::uint64_t bytes = saturated_product(number, unit);
    require(read && bytes >= 1U << 20U, who, "got '", text,
            "', expected bytes, at least 1M, such as 512M or 8G");
    return bytes;
}

} // namespace rye::trainer
