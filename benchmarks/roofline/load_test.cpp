// SPDX-License-Identifier: Apache-2.0
// The processor's name and the load, as Linux writes them.
#include <doctest/doctest.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>

#include <unistd.h>

#include "load.hpp"

using namespace rye::bench;

namespace {

/// A file of a text, for the length of a test.
struct TextFile {
    std::string path = (std::filesystem::temp_directory_path() /
                        ("rye_load_" + std::to_string(getpid()))).string();

    explicit TextFile(const std::string& text) { std::ofstream(path) << text; }
    ~TextFile() { std::remove(path.c_str()); }
    TextFile(const TextFile&) = delete;
    TextFile& operator=(const TextFile&) = delete;
};

} // namespace

TEST_CASE("load: the processor's name") {
    const TextFile file("processor\t: 0\nmodel\t\t: 97\nmodel name\t: A Processor (R) 9000\n"
                        "processor\t: 1\nmodel name\t: Another\n");
    CHECK(processor_name(file.path) == "A Processor (R) 9000");
    CHECK(processor_name("/nowhere") == "unknown");
}

TEST_CASE("load: the average of a minute, and what runs now") {
    const TextFile file("7.72 5.09 2.55 9/134 20711\n");
    const Load l = Load::now(file.path);
    CHECK(l.average == 7.72);
    CHECK(l.running == 9);
    CHECK(Load::now("/nowhere").running == -1);
    const TextFile broken("no numbers\n");
    CHECK(Load::now(broken.path).average == -1);
}

TEST_CASE("load: seen beside a measurement") {
    LoadSeen seen;
    seen.look();
    seen.look();
    const Load mean = seen.mean();
    if (std::filesystem::exists("/proc/loadavg")) {
        CHECK(mean.average >= 0);
        CHECK(mean.running >= 1);
    }
}
