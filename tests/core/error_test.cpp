// SPDX-License-Identifier: Apache-2.0
// Messages of errors: what they say, and that they are not made while the condition holds.
#include <rye/core/error.hpp>

#include <cstdint>
#include <string>

#include <doctest/doctest.h>

using namespace rye;

namespace {

/// A text that counts how often it is made.
struct Counted {
    int* made;
    operator std::string() const {
        ++*made;
        return "counted";
    }
};

template <class... Pieces>
std::string message(const Pieces&... pieces) {
    try {
        require(false, pieces...);
    } catch (const Error& e) {
        return e.what();
    }
    return "no error";
}

} // namespace

TEST_CASE("a message joins texts, numbers and what callables return") {
    const std::string who = "file.ply";
    CHECK(message(who, "damaged") == "file.ply: damaged");
    CHECK(message("Ramp", "near = ", 0.1, ", far = ", 2.0F, ", ", std::int64_t(-3), " of ",
                  std::uint8_t(65)) == "Ramp: near = 0.1, far = 2, -3 of 65");
    CHECK(message(std::string_view("a"), who, '.', [] { return 7; },
                  [&] { return who + "!"; }) == "a: file.ply.7file.ply!");
}

TEST_CASE("no piece of a message is converted while the condition holds") {
    int made = 0;
    const Counted piece{&made};
    require(true, piece, piece);
    require(true, "who", "got ", piece, ", ", [&] { return std::string(piece); });
    CHECK(made == 0);
    CHECK(message(piece, piece) == "counted: counted");
    CHECK(made == 2);
}
