// SPDX-License-Identifier: Apache-2.0
#include "commands/progress.hpp"

#include <cstdio>
#include <iostream>

#include "data/system.hpp"

namespace rye::trainer {

std::string brief(const std::string& name, double value) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%.4f", value);
    return name + " " + digits;
}

std::string clock_text(double seconds) {
    const auto whole = static_cast<long long>(seconds);
    char text[32];
    std::snprintf(text, sizeof text, "%lld:%02d", whole / 60, static_cast<int>(whole % 60));
    return text;
}

std::string left_words(double seconds, Index done, Index total) {
    if (done <= 0 || done >= total) return {};
    return ", " +
           clock_text(seconds / static_cast<double>(done) * static_cast<double>(total - done)) +
           " left";
}

Progress::Progress(std::string stage, Index total, bool quiet)
    : stage_(std::move(stage)),
      total_(total),
      quiet_(quiet),
      tty_(is_terminal(Stream::output)) {}

void Progress::show(Index step, const std::vector<std::string>& losses, bool last, Index taken) {
    if (quiet_) return;
    const double now = seconds();
    if (first_step_ < 0) first_step_ = step - taken;
    if (!last && now - shown_ < (tty_ ? 0.2 : 10.0)) return;
    shown_ = now;
    const double done = static_cast<double>(step - first_step_);
    const double ms = 1e3 * now / done;
    char text[32];
    std::snprintf(text, sizeof text, "  %4.*f ms/step, ", ms < 10 ? 2 : 0, ms);
    const std::string begin = stage_ + " " + std::to_string(step) + "/" + std::to_string(total_);
    const std::string end =
        text + clock_text(now / done * static_cast<double>(total_ - step)) + " left";
    const std::size_t width = tty_ ? terminal_width() : 0;
    std::string shown;
    for (const std::string& loss : losses) {
        const std::size_t all = begin.size() + shown.size() + 2 + loss.size() + end.size();
        if (width > 0 && all >= width) break;
        shown += "  " + loss;
    }
    std::cout << (tty_ ? "\r\033[K" : "") << begin << shown << end << (tty_ && !last ? "" : "\n")
              << std::flush;
}

double Progress::seconds() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
}

} // namespace rye::trainer
