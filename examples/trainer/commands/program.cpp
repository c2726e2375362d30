// SPDX-License-Identifier: Apache-2.0
#include "commands/program.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <new>

#include <CLI/CLI.hpp>

#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

/// Returns the number of insertions, deletions, changes and swaps of neighbours between two words.
std::size_t edits(const std::string& a, const std::string& b) {
    std::vector<std::vector<std::size_t>> d(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
    for (std::size_t i = 0; i <= a.size(); ++i)
        for (std::size_t j = 0; j <= b.size(); ++j) {
            if (i == 0 || j == 0) {
                d[i][j] = i + j;
                continue;
            }
            const std::size_t changed = a[i - 1] == b[j - 1] ? 0 : 1;
            d[i][j] = std::min({d[i - 1][j] + 1, d[i][j - 1] + 1, d[i - 1][j - 1] + changed});
            if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
                d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
        }
    return d[a.size()][b.size()];
}

std::string listed(const std::vector<std::string>& words, const std::string& last) {
    std::string out;
    for (std::size_t i = 0; i < words.size(); ++i)
        out += (i == 0 ? "" : i + 1 == words.size() ? last : ", ") + words[i];
    return out;
}

std::string meant(const std::string& word, const std::vector<std::string>& candidates) {
    const std::string near = near_miss(word, candidates);
    return near.empty() ? "" : ", did you mean '" + near + "'?";
}

/// Returns the command that the first argument names, or null.
const CLI::App* command_of(const CLI::App& app, int argc, char** argv) {
    for (const CLI::App* c : commands_of(app))
        if (argc > 1 && c->get_name() == argv[1]) return c;
    return nullptr;
}

/// Returns the error for a command line that names no command; empty if it does, or begins with an
/// option.
std::string no_command(const CLI::App& app, int argc, char** argv) {
    const std::string all = "; `rye --help` lists them";
    if (argc < 2) return "no command is given" + all;
    const std::string word = argv[1];
    if (command_of(app, argc, argv) != nullptr || word.starts_with('-')) return "";
    const std::string near = meant(word, names_of(app));
    return "'" + word + "' is no command" + (near.empty() ? all : near);
}

const CLI::Option* option_named(const CLI::App& command, const std::string& name) {
    for (const CLI::Option* o : command.get_options())
        if (o->check_name(name)) return o;
    return nullptr;
}

/// Returns the error for the first argument that the command does not know; empty if it knows all.
std::string unexpected(const CLI::App& app, const CLI::App& command) {
    std::vector<std::string> rest = command.remaining();
    if (rest.empty()) rest = app.remaining();
    const auto option = std::find_if(rest.begin(), rest.end(),
                                     [](const std::string& w) { return w.starts_with('-'); });
    if (rest.empty()) return "";
    if (option == rest.end())
        return "'" + rest.front() +
               "' is one word more than the command takes; its options are named";
    const std::string word = option->substr(0, option->find('='));
    std::vector<std::string> names{"--help"};
    for (const CLI::Option* o : options_of(command))
        names.push_back("--" + o->get_lnames().front());
    const std::string near = meant(word, names);
    const std::string program = &command == &app ? "rye" : "rye " + command.get_name();
    return word + " is no option" + (near.empty() ? "; `" + program + " --help` lists them" : near);
}

/// Returns CLI11's sentences in the words of rye: the option, its value, the expected one.
std::string reworded(const CLI::App& command, const CLI::ParseError& e) {
    const std::string text = e.what();
    const std::string convert = "Could not convert: ", in_set = " not in {";
    if (text.starts_with(convert)) {
        const std::size_t equals = text.find(" = ");
        if (equals == std::string::npos) return text;
        const std::string name = text.substr(convert.size(), equals - convert.size());
        const CLI::Option* o = option_named(command, name);
        const std::string type = o == nullptr ? "" : o->get_type_name();
        if (o != nullptr && value_of(*o).kind == OptionValue::Kind::none)
            return name + ": got '" + text.substr(equals + 3) + "', expected no value";
        return name + ": got '" + text.substr(equals + 3) + "', expected " +
               (type.starts_with("FLOAT") ? "a number" : "a whole number");
    }
    if (const std::size_t at = text.find(in_set); at != std::string::npos) {
        const std::size_t colon = text.find(": ");
        const CLI::Option* o =
            colon == std::string::npos ? nullptr : option_named(command, text.substr(0, colon));
        if (o == nullptr) return text;
        const std::string word = text.substr(colon + 2, at - colon - 2);
        const std::vector<std::string> choices = value_of(*o).choices;
        return text.substr(0, colon) + ": got '" + word + "', expected " + listed(choices, " or ") +
               meant(word, choices);
    }
    if (e.get_name() == "RequiredError" && text.ends_with(" is required")) {
        const std::string name = text.substr(0, text.find(' '));
        const CLI::Option* o = option_named(command, name);
        return name + " is missing" + (o == nullptr ? "" : ": " + text_of(*o));
    }
    if (e.get_name() == "ArgumentMismatch" && text.find(" required ") != std::string::npos) {
        const std::string name = text.substr(0, text.find(':'));
        const CLI::Option* o = option_named(command, name);
        const int values = o == nullptr ? 1 : o->get_items_expected_min();
        return name + (values > 1 ? ": got too few values, expected " + std::to_string(values) +
                                        " with commas between them"
                                  : ": a value is missing after it");
    }
    for (const std::string missing : {": Path does not exist: ", ": File does not exist: "})
        if (const std::size_t at = text.find(missing); at != std::string::npos)
            return text.substr(0, at) + ": got '" + text.substr(at + missing.size()) +
                   "', which is not there";
    return text;
}

/// Returns why a text that CLI11 reads as a number cannot be used; empty if it is finite, or no
/// number, which CLI11 reports itself.
std::string finite_fault(const std::string& text) {
    char* end = nullptr;
    const auto x = static_cast<double>(std::strtold(text.c_str(), &end));
    const bool whole = !text.empty() && end == text.c_str() + text.size();
    return !whole || std::isfinite(x) ? "" : "got '" + text + "', expected a finite number";
}

/// Makes the options of a command and of its subcommands accept finite numbers alone: CLI11 reads
/// nan and inf, and its ranges let NaN pass.
void refuse_non_finite(CLI::App& command) {
    for (CLI::Option* o : command.get_options())
        if (o->get_type_name().starts_with("FLOAT")) o->check(finite_fault);
    for (CLI::App* c : command.get_subcommands([](CLI::App*) { return true; }))
        refuse_non_finite(*c);
}

int fault(const std::string& command, const std::string& sentence) {
    const bool named = sentence.starts_with("rye ");
    std::cerr << (named ? "" : "rye" + (command.empty() ? "" : " " + command) + ": ") << sentence
              << "\n";
    return exit_fault;
}

} // namespace

std::string near_miss(const std::string& word, const std::vector<std::string>& candidates) {
    std::string best;
    std::size_t least = std::max<std::size_t>(1, word.size() / 3) + 1;
    for (const std::string& c : candidates)
        if (const std::size_t n = edits(word, c); n < least) least = n, best = c;
    if (!best.empty()) return best;
    constexpr std::size_t enough = 3; // letters at the beginning of a word
    const std::size_t dashes = std::min(word.find_first_not_of('-'), word.size());
    if (word.size() < dashes + enough) return "";
    for (const std::string& c : candidates)
        if (c.starts_with(word)) return c;
    return "";
}

std::vector<const CLI::App*> commands_of(const CLI::App& app) {
    return app.get_subcommands([](const CLI::App*) { return true; });
}

std::vector<std::string> names_of(const CLI::App& app) {
    std::vector<std::string> names;
    for (const CLI::App* c : commands_of(app)) names.push_back(c->get_name());
    return names;
}

std::vector<const CLI::Option*> options_of(const CLI::App& command) {
    return command.get_options([](const CLI::Option* o) { return !o->get_lnames().empty(); });
}

OptionValue value_of(const CLI::Option& option) {
    using Kind = OptionValue::Kind;
    if (option.get_items_expected_max() == 0 || option.get_expected_min() == 0) return {};
    const std::string type = option.get_type_name();
    if (const std::size_t open = type.find('{'); open != std::string::npos) {
        OptionValue v{Kind::choice, {}};
        std::string words = type.substr(open + 1, type.find('}', open) - open - 1);
        for (std::size_t comma = 0; comma != std::string::npos;) {
            comma = words.find(',');
            v.choices.push_back(words.substr(0, comma));
            if (comma != std::string::npos) words = words.substr(comma + 1);
        }
        return v;
    }
    if (type.starts_with("INT") || type.starts_with("UINT") || type.starts_with("FLOAT"))
        return {Kind::number, {}};
    const std::string help = option.get_description();
    if (help.starts_with("Folder")) return {Kind::folder, {}};
    for (const char* word : {"file", "folder", "File", "npz", "What to write"})
        if (help.find(word) != std::string::npos) return {Kind::file, {}};
    return {Kind::word, {}};
}

std::string text_of(const CLI::Option& option) { return option.get_description(); }

int run_program(CLI::App& app, int argc, char** argv) {
    refuse_non_finite(app);
    const CLI::App* const found = command_of(app, argc, argv);
    const CLI::App& command = found == nullptr ? app : *found;
    const std::string name = found == nullptr ? "" : found->get_name();
    try {
        if (argc > 1 && std::string(argv[1]) == "help") {
            const CLI::App* about = argc > 2 ? command_of(app, argc - 1, argv + 1) : &app;
            if (about == nullptr) return fault("", no_command(app, argc - 1, argv + 1));
            std::cout << about->help(about == &app ? "" : "rye");
            return 0;
        }
        if (const std::string sentence = no_command(app, argc, argv); !sentence.empty())
            return fault("", sentence);
        app.parse(argc, argv);
        std::cout.flush();
        return std::cout ? 0 : fault(name, "standard output cannot be written");
    } catch (const CLI::RuntimeError& e) {
        return e.get_exit_code();
    } catch (const CLI::ParseError& e) {
        if (e.get_exit_code() == 0) return app.exit(e); // help and version
        const std::string more = unexpected(app, command);
        return fault(name, more.empty() ? reworded(command, e) : more);
    } catch (const std::bad_alloc&) {
        return fault(name, "out of memory");
    } catch (const std::exception& e) {
        return fault(name, e.what());
    }
}

} // namespace rye::trainer
