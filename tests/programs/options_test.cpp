// SPDX-License-Identifier: Apache-2.0
// Every option of every command that takes numbers, as numbers or as a text of them, with what is
// no finite number: exit code 2, and a sentence that names the option and the value.
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <doctest/doctest.h>

#include "../support/hostile.hpp"
#include "command_line.hpp"
#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "commands/program.hpp"
#include "data/memory_limit.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

struct NumericOption {
    std::vector<std::string> command; ///< words before the option
    std::string name;
    int values;
};

/// Options whose text is read as numbers by the command itself.
bool numbers_in_words(const std::string& name) {
    for (const char* known : {"--max-error", "--bound", "--fps", "--size", "--seed", "--seeds",
                              "--range", "--memory"})
        if (name == known) return true;
    return false;
}

void collect(const CLI::App& command, const std::vector<std::string>& words,
             std::vector<NumericOption>& all) {
    for (const CLI::Option* o : options_of(command)) {
        const std::string type = o->get_type_name(), name = "--" + o->get_lnames().front();
        const bool number =
            type.starts_with("FLOAT") || type.starts_with("INT") || type.starts_with("UINT");
        if (number || numbers_in_words(name))
            all.push_back({words, name, number ? std::max(1, o->get_items_expected_min()) : 1});
    }
    for (const CLI::App* c : commands_of(command)) {
        std::vector<std::string> longer = words;
        longer.push_back(c->get_name());
        collect(*c, longer, all);
    }
}

std::vector<NumericOption> numeric_options() {
    CLI::App app;
    add_commands(app);
    std::vector<NumericOption> all;
    collect(app, {}, all);
    return all;
}

} // namespace

TEST_CASE("options: none takes what is no finite number") {
    const std::vector<NumericOption> all = numeric_options();
    REQUIRE(all.size() > 40);
    std::size_t reals = 0;
    for (const NumericOption& o : all)
        for (const std::string bad : {"nan", "-nan", "NAN", "inf", "-inf", "infinity", "1e999"}) {
            std::vector<std::string> words = o.command;
            std::string value = bad;
            for (int i = 1; i < o.values; ++i) value += "," + bad;
            words.push_back(o.name + "=" + value);
            const Answer a = answer(words);
            INFO(o.command.front(), " ", o.name, "=", value, ": ", a.text);
            CHECK(a.code == 2);
            CHECK(a.text.find(o.name + ": got ") != std::string::npos);
            CHECK(a.text.find("expected ") != std::string::npos);
            ++reals;
        }
    CHECK(reals > 200);
}

TEST_CASE("options: the four whose NaN drew a picture") {
    for (const char* option : {"--fov=nan", "--alpha-floor=nan", "--background=nan,0,0",
                               "--max-error=nan", "--near=nan"}) {
        const std::string name = std::string(option).substr(0, std::string(option).find('='));
        const Answer a = answer({"render", option});
        INFO(a.text);
        CHECK(a.code == 2);
        CHECK(a.text.starts_with("rye render: " + name + ": got 'nan', expected a"));
    }
}

TEST_CASE("options: ranges in one wording, whatever the version of CLI11") {
    const std::pair<const char*, const char*> wrong[] = {
        {"--fov=180", "--fov: got 180, expected 0.01 to 179"},
        {"--alpha-floor=-1", "--alpha-floor: got -1, expected 0 to 0.99"},
        {"--near=0", "--near: got 0, expected 1e-09 to 1e+09"},
        {"--background=0,2,0", "--background: got 2, expected 0 to 1"},
        {"--view=-1", "--view: got -1, expected 0 to 999999"},
        {"--threads=5000", "--threads: got 5000, expected 0 to 1024"},
        {"--threads=x", "--threads: got 'x', expected a whole number"},
        {"--fov=x", "--fov: got 'x', expected a number"}};
    for (const auto& [option, sentence] : wrong) {
        const Answer a = answer({"render", option});
        CHECK(a.text == std::string("rye render: ") + sentence + "\n");
        CHECK(a.code == 2);
    }
}

TEST_CASE("options: a limit on memory") {
    CHECK(parsed_memory("512M", "--memory") == 512ULL << 20U);
    CHECK(parsed_memory("8G", "--memory") == 8ULL << 30U);
    CHECK(parsed_memory("2048K", "--memory") == 2ULL << 20U);
    CHECK(parsed_memory("3000000000", "--memory") == 3'000'000'000);
    for (const char* wrong : {"", "0", "1000", "-1G", "1.5G", "2T", "G", "nan", "99999999999999999999",
                              "1G "})
        CHECK_FAULT(parsed_memory(wrong, "--memory"),
                    std::string("--memory: got '") + wrong + "', expected bytes, at least 1M");
    CHECK(parsed_memory("99999999999G", "--memory") == ~std::uint64_t(0));
}

TEST_CASE("options: an error as a number or a fraction") {
    CHECK(parsed_error("0.004", "--bound") == 0.004);
    CHECK(parsed_error("1/255", "--bound") == 1.0 / 255);
    for (const char* wrong : {"", "0", "1", "-1", "1/0", "0/0", "nan", "inf", "1/inf", "1/2/3", "1/",
                              "/2", "0,5", " 0.5"})
        CHECK_FAULT(parsed_error(wrong, "--bound"),
                    std::string("--bound: got '") + wrong + "', expected a number between 0 and 1");
}
