// SPDX-License-Identifier: Apache-2.0
#include "data/started_program.hpp"

#include <algorithm>
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

#include "data/system.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

/// File that is closed with it, and in programs that are started.
struct Descriptor {
    int number = -1;
    Descriptor() = default;
    explicit Descriptor(int n) : number(n) {}
    ~Descriptor() { close(); }
    Descriptor(const Descriptor&) = delete;
    Descriptor& operator=(const Descriptor&) = delete;
    void close() {
        if (number >= 0) ::close(number);
        number = -1;
    }
};

struct Pipe {
    Descriptor reading, writing;
    Pipe() {
        std::array<int, 2> ends{-1, -1};
        require(::pipe(ends.data()) == 0, "pipe", "cannot be made: ", [] { return std::strerror(errno); });
        for (const int end : ends) ::fcntl(end, F_SETFD, FD_CLOEXEC);
        reading.number = ends[0];
        writing.number = ends[1];
    }
};

/// own_group: in a process group of its own, where signals that ask it to stop end it.
::pid_t start(const fs::path& file, const std::vector<std::string>& words, int out, int err,
              bool own_group) {
    std::vector<std::string> copies = words;
    std::vector<char*> argv;
    for (std::string& word : copies) argv.push_back(word.data());
    argv.push_back(nullptr);
    const Descriptor in(::open("/dev/null", O_RDONLY | O_CLOEXEC));
    const ::pid_t parent = ::getpid();
    const ::pid_t child = ::fork();
    if (child == 0) { // between fork and exec, only calls that are safe in a signal handler
#ifdef __linux__
        ::prctl(PR_SET_PDEATHSIG, SIGTERM);
#endif
        if (::getppid() != parent) ::_exit(127);
        if (own_group) {
            ::setpgid(0, 0);
            for (const int signal : stop_signals) ::signal(signal, SIG_DFL);
        }
        ::dup2(in.number, 0);
        ::dup2(out, 1);
        ::dup2(err, 2);
        ::execv(file.c_str(), argv.data());
        ::_exit(127);
    }
    require(child > 0, words.front(), "cannot be started: ", [] { return std::strerror(errno); });
    return child;
}

int code_of(int status) { return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status); }

} // namespace

struct StartedProgram::Process {
    ::pid_t id = -1;
    std::optional<Pipe> out, err;
};

StartedProgram::StartedProgram(const fs::path& file, const std::vector<std::string>& words)
    : process_(std::make_unique<Process>()) {
    Process& p = *process_;
    p.id = start(file, words, p.out.emplace().writing.number, p.err.emplace().writing.number, false);
    p.out->writing.close();
    p.err->writing.close();
}

StartedProgram::StartedProgram(const fs::path& file, const std::vector<std::string>& words,
                               const OutputFiles& output)
    : process_(std::make_unique<Process>()) {
    const Descriptor out(::open(output.out.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666));
    const Descriptor err(::open(output.errors.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666));
    require(out.number >= 0 && err.number >= 0, output.out.string(),
            "cannot be written: ", [] { return std::strerror(errno); });
    process_->id = start(file, words, out.number, err.number, true);
}

StartedProgram::~StartedProgram() = default;
StartedProgram::StartedProgram(StartedProgram&&) noexcept = default;
StartedProgram& StartedProgram::operator=(StartedProgram&&) noexcept = default;

void StartedProgram::read(const std::function<void(bool, std::string_view)>& take) {
    std::array<pollfd, 2> wait{{{process_->out->reading.number, POLLIN, 0},
                                {process_->err->reading.number, POLLIN, 0}}};
    std::array<char, 4096> bytes{};
    while (wait[0].fd >= 0 || wait[1].fd >= 0) {
        if (::poll(wait.data(), wait.size(), -1) < 0) {
            if (errno == EINTR) continue;
            break;
        }
        for (std::size_t i = 0; i < wait.size(); ++i) {
            if (wait[i].fd < 0 || wait[i].revents == 0) continue;
            const ::ssize_t got = ::read(wait[i].fd, bytes.data(), bytes.size());
            if (got < 0 && errno == EINTR) continue;
            if (got <= 0) wait[i].fd = -1;
            else take(i == 1, {bytes.data(), static_cast<std::size_t>(got)});
        }
    }
}

int StartedProgram::wait() {
    int status = 0;
    while (::waitpid(process_->id, &status, 0) < 0 && errno == EINTR) {
    }
    return code_of(status);
}

std::optional<int> StartedProgram::ended() {
    int status = 0;
    if (::waitpid(process_->id, &status, WNOHANG) != process_->id) return std::nullopt;
    return code_of(status);
}

void StartedProgram::stop() { ::kill(process_->id, SIGTERM); }

fs::path own_program() { return "/proc/self/exe"; } // even if its file has been replaced since

std::vector<fs::path> program_folders() {
    const std::string path = environment("PATH").value_or("");
    std::vector<fs::path> folders;
    for (std::size_t begin = 0; begin <= path.size();) {
        const std::size_t end = std::min(path.find(':', begin), path.size());
        folders.emplace_back(path.substr(begin, end - begin));
        begin = end + 1;
    }
    return folders;
}

std::optional<fs::path> program_in(const fs::path& folder, const std::string& name) {
    const fs::path file = folder / name;
    std::error_code ignored; // a folder of PATH may be closed to this user
    if (fs::is_regular_file(file, ignored) && ::access(file.c_str(), X_OK) == 0) return file;
    return std::nullopt;
}

} // namespace rye::trainer
