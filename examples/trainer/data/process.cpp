// SPDX-License-Identifier: Apache-2.0
#include "data/process.hpp"

#include <rye/core/error.hpp>

#include "data/started_program.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t longest_message = 600, longest_line = 1U << 20U;

void keep_tail(std::string& text, std::size_t most) {
    if (text.size() > most) text.erase(0, text.size() - most);
}

/// Takes whole lines off the text.
void hand_out(std::string& text, const std::function<void(std::string_view)>& line) {
    std::size_t begin = 0;
    for (std::size_t end; (end = text.find('\n', begin)) != std::string::npos; begin = end + 1)
        if (line) line(std::string_view(text).substr(begin, end - begin));
    text.erase(0, begin);
    keep_tail(text, longest_line);
}

} // namespace

std::optional<fs::path> find_program(const std::vector<std::string>& names) {
    const std::vector<fs::path> folders = program_folders();
    for (const std::string& name : names)
        for (const fs::path& folder : folders)
            if (const auto file = program_in(folder, name)) return file;
    return std::nullopt;
}

ProgramEnd run_program(const std::vector<std::string>& words,
                       const std::function<void(std::string_view)>& line) {
    require(!words.empty(), "run_program", "got no words, expected a program");
    StartedProgram program(words.front(), words);
    ProgramEnd end;
    std::string text;
    program.read([&](bool errors, std::string_view bytes) {
        (errors ? end.message : text) += bytes;
        if (errors) keep_tail(end.message, longest_message);
        else hand_out(text, line);
    });
    if (!text.empty() && line) line(text);
    end.code = program.wait();
    return end;
}

} // namespace rye::trainer
