// SPDX-License-Identifier: Apache-2.0
#include "data/process.hpp"

#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>

#include <fcntl.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>
#ifdef __linux__
#include <sys/prctl.h>
#endif

#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

/// A pipe whose ends are closed with it, and in programs that are started.
struct Pipe {
    std::array<int, 2> ends{-1, -1};
    Pipe() {
        require(::pipe(ends.data()) == 0, "pipe", "cannot be made: ", [] { return std::strerror(errno); });
        for (const int end : ends) ::fcntl(end, F_SETFD, FD_CLOEXEC);
    }
    ~Pipe() {
        close_writing();
        ::close(ends[0]);
    }
    Pipe(const Pipe&) = delete;
    Pipe& operator=(const Pipe&) = delete;
    void close_writing() {
        if (ends[1] >= 0) ::close(ends[1]);
        ends[1] = -1;
    }
};

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

/// Reads both pipes until the program has closed them.
void read_both(Pipe& out, Pipe& err, std::string& message,
               const std::function<void(std::string_view)>& line) {
    std::array<pollfd, 2> wait{{{out.ends[0], POLLIN, 0}, {err.ends[0], POLLIN, 0}}};
    std::string text;
    std::array<char, 4096> bytes{};
    while (wait[0].fd >= 0 || wait[1].fd >= 0) {
        if (::poll(wait.data(), wait.size(), -1) < 0) {
            if (errno == EINTR) continue;
            break;
        }
        for (std::size_t i = 0; i < wait.size(); ++i) {
            if (wait[i].fd < 0 || wait[i].revents == 0) continue;
            const ssize_t got = ::read(wait[i].fd, bytes.data(), bytes.size());
            if (got < 0 && errno == EINTR) continue;
            if (got <= 0) {
                wait[i].fd = -1;
                continue;
            }
            (i == 0 ? text : message).append(bytes.data(), static_cast<std::size_t>(got));
            if (i == 0) hand_out(text, line);
            else keep_tail(message, longest_message);
        }
    }
    if (!text.empty() && line) line(text);
}

} // namespace

std::optional<fs::path> find_program(const std::vector<std::string>& names) {
    const char* const variable = std::getenv("PATH");
    const std::string path = variable != nullptr ? variable : "";
    for (const std::string& name : names)
        for (std::size_t begin = 0; begin <= path.size();) {
            const std::size_t end = std::min(path.find(':', begin), path.size());
            const fs::path file = fs::path(path.substr(begin, end - begin)) / name;
            if (fs::is_regular_file(file) && ::access(file.c_str(), X_OK) == 0) return file;
            begin = end + 1;
        }
    return std::nullopt;
}

ProgramEnd run_program(const std::vector<std::string>& words,
                       const std::function<void(std::string_view)>& line) {
    require(!words.empty(), "run_program", "got no words, expected a program");
    std::vector<std::string> copies = words;
    std::vector<char*> argv;
    for (std::string& word : copies) argv.push_back(word.data());
    argv.push_back(nullptr);
    Pipe out, err;
    const int in = ::open("/dev/null", O_RDONLY | O_CLOEXEC);
    const pid_t parent = ::getpid();
    const pid_t child = ::fork();
    if (child == 0) { // between fork and exec, only calls that are safe in a signal handler
#ifdef __linux__
        ::prctl(PR_SET_PDEATHSIG, SIGTERM);
#endif
        if (::getppid() != parent) ::_exit(127);
        ::dup2(in, 0);
        ::dup2(out.ends[1], 1);
        ::dup2(err.ends[1], 2);
        ::execv(argv[0], argv.data());
        ::_exit(127);
    }
    ::close(in);
    require(child > 0, words[0], "cannot be started: ", [] { return std::strerror(errno); });
    out.close_writing();
    err.close_writing();
    ProgramEnd end;
    read_both(out, err, end.message, line);
    int status = 0;
    while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
    }
    end.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    return end;
}

} // namespace rye::trainer
