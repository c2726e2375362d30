// SPDX-License-Identifier: Apache-2.0
#include "commands/child_jobs.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <fstream>
#include <list>
#include <map>

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>
#ifdef __linux__
#include <sys/prctl.h>
#endif

#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

volatile std::sig_atomic_t stop_signal = 0;
void note_stop(int signal) { stop_signal = signal; }

/// This program's file, even if it has been replaced since it started.
constexpr const char* self = "/proc/self/exe";

/// Recorder of SIGINT and SIGTERM, which are noted instead of obeyed during its life.
class NotedStops {
  public:
    NotedStops() {
        stop_signal = 0;
        struct sigaction action {};
        action.sa_handler = note_stop;
        for (std::size_t i = 0; i < 2; ++i) ::sigaction(signals[i], &action, &before_[i]);
    }
    ~NotedStops() {
        for (std::size_t i = 0; i < 2; ++i) ::sigaction(signals[i], &before_[i], nullptr);
    }
    NotedStops(const NotedStops&) = delete;
    NotedStops& operator=(const NotedStops&) = delete;

  private:
    static constexpr std::array<int, 2> signals{SIGINT, SIGTERM};
    std::array<struct sigaction, 2> before_{};
};

/// Starts a command. Its process has a group of its own, so that the terminal's SIGINT reaches this
/// process alone, which forwards it once.
pid_t start(const std::vector<std::string>& command, const fs::path& log) {
    std::vector<std::string> words{"rye"};
    words.insert(words.end(), command.begin(), command.end());
    std::vector<char*> argv;
    for (std::string& w : words) argv.push_back(w.data());
    argv.push_back(nullptr);
    const std::string errors = log.string() + ".errors";
    const int out = ::open(log.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
    const int err = ::open(errors.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    const int in = ::open("/dev/null", O_RDONLY | O_CLOEXEC);
    require(out >= 0 && err >= 0 && in >= 0, log.string(),
            "cannot be written: ", [&] { return std::strerror(errno); });
    const pid_t parent = ::getpid();
    const pid_t child = ::fork();
    if (child == 0) { // between fork and exec, only calls that are safe in a signal handler
#ifdef __linux__
        ::prctl(PR_SET_PDEATHSIG, SIGTERM);
#endif
        if (::getppid() != parent) ::_exit(127);
        ::setpgid(0, 0);
        ::signal(SIGINT, SIG_DFL);
        ::signal(SIGTERM, SIG_DFL);
        ::dup2(in, 0);
        ::dup2(out, 1);
        ::dup2(err, 2);
        ::execv(self, argv.data());
        ::_exit(127);
    }
    for (const int file : {out, err, in}) ::close(file);
    require(child > 0, "rye compare",
            "cannot start a process: ", [&] { return std::strerror(errno); });
    return child;
}

std::string last_line(const fs::path& path) {
    std::ifstream file(path);
    std::string last;
    for (std::string line; std::getline(file, line);)
        if (!line.empty()) last = line;
    return last;
}

int code_of(int status) { return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status); }

} // namespace

int run_children(std::vector<ChildJob> jobs, int at_once,
                 const std::function<void(std::size_t, const ChildResult&)>& ended) {
    require(::access(self, X_OK) == 0, "rye compare", self,
            " is not there, by which it starts its own commands");
    struct Running {
        std::size_t job, command;
        Clock::time_point began;
    };
    std::map<pid_t, Running> running;
    std::list<std::size_t> waiting;
    for (std::size_t i = 0; i < jobs.size(); ++i) waiting.push_back(i);
    Clock::time_point looked{};
    /// Returns the first job that may start, or the end of the list.
    const auto next_ready = [&] {
        const auto now = Clock::now();
        const bool looks = running.empty() || now - looked > std::chrono::milliseconds(300);
        if (looks) looked = now;
        const auto ready = [&](std::size_t i) {
            return !jobs[i].ready || (looks && jobs[i].ready(jobs[i]));
        };
        const auto found = std::find_if(waiting.begin(), waiting.end(), ready);
        return found == waiting.end() && running.empty() ? waiting.begin() : found;
    };
    const NotedStops stops;
    bool told = false;
    const auto begin = [&](Running r) {
        const ChildJob& job = jobs[r.job];
        running.emplace(start(job.commands[r.command], job.log), r);
    };
    while (!waiting.empty() || !running.empty()) {
        while (stop_signal == 0 && running.size() < static_cast<std::size_t>(at_once)) {
            const auto next = next_ready();
            if (next == waiting.end()) break;
            const std::size_t job = *next;
            waiting.erase(next);
            std::error_code ignored;
            fs::create_directories(jobs[job].log.parent_path(), ignored);
            fs::remove(jobs[job].log, ignored);
            begin({job, 0, Clock::now()});
        }
        if (stop_signal != 0) {
            if (!told)
                for (const auto& [pid, r] : running) ::kill(pid, SIGTERM);
            told = true;
            if (running.empty()) break;
        }
        int status = 0;
        const pid_t pid = ::waitpid(-1, &status, WNOHANG);
        const auto found = pid > 0 ? running.find(pid) : running.end();
        if (found == running.end()) {
            ::usleep(20000);
            continue;
        }
        Running r = found->second;
        running.erase(found);
        const ChildJob& job = jobs[r.job];
        const int code = code_of(status);
        if (code == 0 && r.command + 1 < job.commands.size() && stop_signal == 0) {
            begin({r.job, r.command + 1, r.began});
            continue;
        }
        const bool done = code == 0 && r.command + 1 == job.commands.size();
        if (stop_signal != 0 && !done) continue; // stopped, not failed
        const fs::path errors = job.log.string() + ".errors";
        ended(r.job, {code, code == 0 ? "" : last_line(errors),
                      std::chrono::duration<double>(Clock::now() - r.began).count()});
    }
    return stop_signal;
}

} // namespace rye::trainer
