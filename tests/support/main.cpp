// SPDX-License-Identifier: Apache-2.0
// The main() of every test program: doctest's options, and --flush-to-zero.
#define DOCTEST_CONFIG_IMPLEMENT
#include <doctest/doctest.h>

#include "flush_to_zero.hpp"

int main(int argc, char** argv) {
    rye::flush_to_zero_if_asked(argc, argv);
    return doctest::Context(argc, argv).run();
}
