// SPDX-License-Identifier: Apache-2.0
/// `rye completion SHELL` and `rye manual`.
#include "commands/completion.hpp"

#include <filesystem>
#include <iostream>
#include <memory>
#include <span>

#include <CLI/CLI.hpp>

#include <rye/io/atomic_file.hpp>
#include <rye/core/config.hpp>

#include "commands/commands.hpp"
#include "commands/program.hpp"

namespace rye::trainer {
namespace {

using Kind = OptionValue::Kind;

std::string replaced(std::string text, const std::string& what, const std::string& by) {
    for (std::size_t at = text.find(what); at != std::string::npos;
         at = text.find(what, at + by.size()))
        text.replace(at, what.size(), by);
    return text;
}

std::string joined(const std::vector<std::string>& words) {
    std::string out;
    for (const std::string& w : words) out += (out.empty() ? "" : " ") + w;
    return out;
}

std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

/// Candidates for the words after a command: its options, and values of a choice without a name.
struct Words {
    std::vector<std::string> options, choices;
    bool files = false; ///< true if it takes a file without a name
};

Words words_of(const CLI::App& command) {
    Words w;
    for (const CLI::Option* o : options_of(command))
        w.options.push_back("--" + o->get_lnames().front());
    for (const CLI::Option* o : command.get_options()) {
        if (o->get_positional()) {
            const OptionValue v = value_of(*o);
            w.choices.insert(w.choices.end(), v.choices.begin(), v.choices.end());
            w.files = w.files || v.kind == Kind::file || v.kind == Kind::folder;
        }
    }
    return w;
}

} // namespace

std::string shell_word(const std::string& text) { return "'" + replaced(text, "'", "'\\''") + "'"; }

std::string bash_completion(const CLI::App& app) {
    std::string values, words;
    for (const CLI::App* c : commands_of(app)) {
        for (const CLI::Option* o : options_of(*c)) {
            const OptionValue v = value_of(*o);
            if (v.kind == Kind::none) continue;
            std::string action = "COMPREPLY=()";
            if (v.kind == Kind::choice)
                action =
                    "COMPREPLY=($(compgen -W " + shell_word(joined(v.choices)) + " -- \"$word\"))";
            if (v.kind == Kind::file)
                action = "compopt -o filenames; mapfile -t COMPREPLY < <(compgen -f -- \"$word\")";
            if (v.kind == Kind::folder)
                action = "compopt -o filenames; mapfile -t COMPREPLY < <(compgen -d -- \"$word\")";
            values += "    " + c->get_name() + ":--" + o->get_lnames().front() + ") " + action +
                      "; return ;;\n";
        }
        const Words w = words_of(*c);
        words +=
            "    " + c->get_name() + ") words=" +
            shell_word(joined(w.options) + (w.choices.empty() ? "" : " " + joined(w.choices))) +
            " files=" + (w.files ? "1" : "") + " ;;\n";
    }
    return "# bash completion for rye, written by `rye completion bash`\n"
           "_rye() {\n"
           "    local word=${COMP_WORDS[COMP_CWORD]} before= command= words= files=\n"
           "    COMPREPLY=()\n"
           "    if [ \"$COMP_CWORD\" -eq 1 ]; then\n"
           "        COMPREPLY=($(compgen -W " +
           shell_word(joined(names_of(app)) + " --help --version") +
           " -- \"$word\"))\n"
           "        return\n"
           "    fi\n"
           "    before=${COMP_WORDS[COMP_CWORD-1]} command=${COMP_WORDS[1]}\n"
           "    case $command:$before in\n" +
           values +
           "    esac\n"
           "    case $command in\n" +
           words +
           "    *) return ;;\n"
           "    esac\n"
           "    COMPREPLY=($(compgen -W \"$words\" -- \"$word\"))\n"
           "    if [ -n \"$files\" ] && [ ${#COMPREPLY[@]} -eq 0 ]; then\n"
           "        compopt -o filenames\n"
           "        mapfile -t COMPREPLY < <(compgen -f -- \"$word\")\n"
           "    fi\n"
           "}\n"
           "complete -F _rye rye\n";
}

std::string zsh_completion(const CLI::App& app) {
    // Brackets and colons are special in the specifications of _arguments.
    const auto plain = [](const std::string& text) {
        return replaced(replaced(replaced(first_line(text), "[", "("), "]", ")"), ":", "\\:");
    };
    const auto action = [&](const OptionValue& v) -> std::string {
        switch (v.kind) {
            case Kind::none:
                return "";
            case Kind::choice:
                return ":value:(" + joined(v.choices) + ")";
            case Kind::file:
                return ":file:_files";
            case Kind::folder:
                return ":folder:_files -/";
            default:
                return ":value: ";
        }
    };
    std::string commands, cases;
    for (const CLI::App* c : commands_of(app)) {
        commands += "        " +
                    shell_word(c->get_name() + ":" +
                               replaced(first_line(c->get_description()), ":", "\\:")) +
                    "\n";
        cases += "    " + c->get_name() + ")\n        _arguments";
        for (const CLI::Option* o : options_of(*c))
            cases +=
                " \\\n            " + shell_word("--" + o->get_lnames().front() + "[" +
                                                 plain(text_of(*o)) + "]" + action(value_of(*o)));
        for (const CLI::Option* o : c->get_options())
            if (o->get_positional())
                cases += " \\\n            " +
                         shell_word(":" + replaced(o->get_name(true, false), ":", "") +
                                    (value_of(*o).kind == Kind::choice
                                         ? ":(" + joined(value_of(*o).choices) + ")"
                                         : ":_files"));
        cases += "\n        ;;\n";
    }
    return "#compdef rye\n# zsh completion for rye, written by `rye completion zsh`\n"
           "_rye() {\n"
           "    local -a commands=(\n" +
           commands +
           "    )\n"
           "    if (( CURRENT == 2 )); then\n"
           "        _describe command commands\n"
           "        _arguments '--help[Print the help and exit]' '--version[Print the version and "
           "exit]'\n"
           "        return\n"
           "    fi\n"
           "    local command=$words[2]\n"
           "    shift words\n"
           "    (( CURRENT-- ))\n"
           "    case $command in\n" +
           cases +
           "    esac\n"
           "}\n"
           "if [ \"$funcstack[1]\" = _rye ]; then\n"
           "    _rye \"$@\"\n"
           "else\n"
           "    compdef _rye rye\n"
           "fi\n";
}

std::string fish_completion(const CLI::App& app) {
    const auto fish_quoted = [](const std::string& text) {
        return "'" + replaced(replaced(first_line(text), "\\", "\\\\"), "'", "\\'") + "'";
    };
    std::string out =
        "# fish completion for rye, written by `rye completion fish`\n"
        "complete -c rye -f\n"
        "complete -c rye -n __fish_use_subcommand -l help -d 'Print the help and exit'\n"
        "complete -c rye -n __fish_use_subcommand -l version "
        "-d 'Print the version and exit'\n";
    for (const CLI::App* c : commands_of(app)) {
        out += "complete -c rye -n __fish_use_subcommand -a " + c->get_name() + " -d " +
               fish_quoted(c->get_description()) + "\n";
        const std::string here =
            "complete -c rye -n '__fish_seen_subcommand_from " + c->get_name() + "'";
        for (const CLI::Option* o : options_of(*c)) {
            const OptionValue v = value_of(*o);
            std::string value;
            if (v.kind == Kind::choice) value = " -x -a " + shell_word(joined(v.choices));
            if (v.kind == Kind::number || v.kind == Kind::word) value = " -x";
            if (v.kind == Kind::file) value = " -r -F";
            if (v.kind == Kind::folder) value = " -x -a '(__fish_complete_directories)'";
            out += here + " -l " + o->get_lnames().front() + value + " -d " +
                   fish_quoted(text_of(*o)) + "\n";
        }
        const Words w = words_of(*c);
        if (!w.choices.empty()) out += here + " -a " + shell_word(joined(w.choices)) + "\n";
        if (w.files) out += here + " -F\n";
    }
    return out;
}

// ---- the manual ---------------------------------------------------------------------------------

namespace {

/// Returns text between macros: hyphens stay hyphens, and no line begins a macro.
std::string roff(const std::string& text) {
    std::string out = replaced(replaced(text, "\\", "\\e"), "-", "\\-");
    out = replaced(replaced(out, "`", "\\(ga"), "'", "\\(aq");
    std::string safe;
    bool begins = true;
    for (const char c : out) {
        if (begins && c == '.') safe += "\\&";
        safe += c;
        begins = c == '\n';
    }
    return safe;
}

/// Returns the words in upper case that stand for the value, such as FILE or PITCH,YAW.
std::string value_word(const CLI::Option& o) {
    const OptionValue v = value_of(o);
    switch (v.kind) {
        case Kind::none:
            return "";
        case Kind::choice:
            return replaced(joined(v.choices), " ", "|");
        case Kind::number:
            return "NUMBER";
        case Kind::file:
            return "FILE";
        case Kind::folder:
            return "FOLDER";
        case Kind::word:
            break;
    }
    return "VALUE";
}

std::string entry(const CLI::Option& o) {
    const std::string value = value_word(o);
    const std::string name =
        o.get_positional() ? o.get_name(true, false) : "--" + o.get_lnames().front();
    std::string help = text_of(o);
    if (!o.get_default_str().empty()) help += " [" + o.get_default_str() + "]";
    if (o.get_required()) help += " (required)";
    return ".TP\n\\fB" + roff(name) + "\\fR" +
           (value.empty() || o.get_positional() ? "" : " \\fI" + roff(value) + "\\fR") + "\n" +
           roff(help) + "\n";
}

} // namespace

std::string manual_page(const CLI::App& app, const std::string& version) {
    std::string out = ".TH RYE 1 \"\" \"rye " + version +
                      "\" \"User Commands\"\n"
                      ".SH NAME\nrye \\- gaze-redirectable Gaussian head avatars\n"
                      ".SH SYNOPSIS\n.B rye\n.I COMMAND\n[\\fIOPTION\\fR ...]\n"
                      ".SH DESCRIPTION\n" +
                      roff(app.get_description()) + "\n.SH COMMANDS\n";
    for (const CLI::App* c : commands_of(app)) {
        out += ".SS rye " + c->get_name() + "\n" + roff(c->get_description()) + "\n";
        for (const CLI::Option* o : c->get_options())
            if (o->get_positional() && o->get_lnames().empty()) out += entry(*o);
        for (const CLI::Option* o : options_of(*c)) out += entry(*o);
    }
    out += ".SH EXIT STATUS\n" + roff(app.get_footer()) + "\n";
    return out;
}

// ---- the commands
// ---------------------------------------------------------------------------------

namespace {

struct TextOptions {
    std::string shell;
    std::filesystem::path out;
};

/// Writes to --out, or else to standard output.
void write_or_print(const std::string& text, const std::filesystem::path& out) {
    if (out.empty())
        std::cout << text;
    else
        write_atomic(out, std::as_bytes(std::span(text)), Durability::atomic_only);
}

} // namespace

void add_completion(CLI::App& app) {
    auto o = std::make_shared<TextOptions>();
    CLI::App* c = app.add_subcommand("completion", "Print the completion script of a shell");
    c->add_option("shell", o->shell, "Shell that reads it")
        ->required()
        ->check(CLI::IsMember({"bash", "zsh", "fish"}));
    c->add_option("--out", o->out, "File to write, instead of standard output");
    c->callback([o, &app] {
        write_or_print(o->shell == "bash"  ? bash_completion(app)
                       : o->shell == "zsh" ? zsh_completion(app)
                                           : fish_completion(app),
                       o->out);
    });
}

void add_manual(CLI::App& app) {
    auto o = std::make_shared<TextOptions>();
    CLI::App* c = app.add_subcommand("manual", "Print the manual page: rye manual | man -l -");
    c->add_option("--out", o->out, "File to write, instead of standard output");
    c->callback([o, &app] {
        const std::string version = std::to_string(RYE_VERSION_MAJOR) + "." +
                                    std::to_string(RYE_VERSION_MINOR) + "." +
                                    std::to_string(RYE_VERSION_PATCH);
        write_or_print(manual_page(app, version), o->out);
    });
}

} // namespace rye::trainer
