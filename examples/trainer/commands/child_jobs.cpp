// SPDX-License-Identifier: Apache-2.0
#include "commands/child_jobs.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <fstream>
#include <list>
#include <thread>

#include <rye/core/error.hpp>

#include "data/noted_stops.hpp"
#include "data/started_program.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

fs::path errors_of(const ChildJob& job) { return job.log.string() + ".errors"; }

/// Starts a command of a job.
StartedProgram start(const ChildJob& job, const std::vector<std::string>& command) {
    std::vector<std::string> words{"rye"};
    words.insert(words.end(), command.begin(), command.end());
    return {own_program(), words, OutputFiles{job.log, errors_of(job)}};
}

} // namespace

std::string last_line(const fs::path& path) {
    std::ifstream file(path);
    std::string last;
    for (std::string line; std::getline(file, line);)
        if (line.find_first_not_of(" \r") != std::string::npos) last = line;
    last.erase(last.find_last_not_of(" \r") + 1);
    return last;
}

int run_children(std::vector<ChildJob> jobs, int at_once,
                 const std::function<void(std::size_t, const ChildResult&)>& ended,
                 const std::function<bool()>& enough) {
    require(fs::exists(own_program()), "rye compare", own_program().string(),
            " is not there, by which it starts its own commands");
    struct Running {
        std::size_t job, command;
        Clock::time_point began;
        StartedProgram program;
    };
    std::list<Running> running;
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
    bool told = false, stopped = false;
    Clock::time_point asked{};
    /// Returns the signal that stops the jobs, or 0.
    const auto stop = [&] {
        const auto now = Clock::now();
        if (enough && !stopped && now - asked > std::chrono::milliseconds(200)) {
            asked = now;
            stopped = enough();
        }
        return stops.signal() != 0 ? stops.signal() : stopped ? SIGTERM : 0;
    };
    const auto begin = [&](std::size_t job, std::size_t command, Clock::time_point began) {
        running.push_back({job, command, began, start(jobs[job], jobs[job].commands[command])});
    };
    while (!waiting.empty() || !running.empty()) {
        while (stop() == 0 && running.size() < static_cast<std::size_t>(at_once)) {
            const auto next = next_ready();
            if (next == waiting.end()) break;
            const std::size_t job = *next;
            waiting.erase(next);
            std::error_code ignored;
            fs::create_directories(jobs[job].log.parent_path(), ignored);
            fs::remove(jobs[job].log, ignored);
            begin(job, 0, Clock::now());
        }
        if (stop() != 0) {
            if (!told)
                for (Running& r : running) r.program.stop();
            told = true;
            if (running.empty()) break;
        }
        std::optional<int> ended_with;
        const auto found = std::find_if(running.begin(), running.end(), [&](Running& r) {
            return (ended_with = r.program.ended()).has_value();
        });
        if (found == running.end()) {
            std::this_thread::sleep_for(std::chrono::milliseconds(20));
            continue;
        }
        const Running r = std::move(*found);
        running.erase(found);
        const ChildJob& job = jobs[r.job];
        const int code = *ended_with;
        if (code == 0 && r.command + 1 < job.commands.size() && stop() == 0) {
            begin(r.job, r.command + 1, r.began);
            continue;
        }
        const bool done = code == 0 && r.command + 1 == job.commands.size();
        if (stop() != 0 && !done) continue; // stopped, not failed
        ended(r.job, {code, code == 0 ? "" : last_line(errors_of(job)),
                      std::chrono::duration<double>(Clock::now() - r.began).count()});
    }
    return stops.signal() != 0 ? stops.signal() : stopped ? SIGTERM : 0;
}

} // namespace rye::trainer
