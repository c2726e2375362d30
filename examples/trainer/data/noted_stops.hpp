// SPDX-License-Identifier: Apache-2.0
/// data/noted_stops.hpp: signals that ask the program to stop, noted instead of obeyed.
#pragma once

#include <array>
#include <csignal>

#include "data/system.hpp"

namespace rye::trainer {

/// Recorder of these signals during its life; one at a time.
class NotedStops {
  public:
    NotedStops() {
        signal_ = 0;
        for (std::size_t i = 0; i < before_.size(); ++i)
            before_[i] = std::signal(stop_signals[i], note);
    }
    ~NotedStops() {
        for (std::size_t i = 0; i < before_.size(); ++i) std::signal(stop_signals[i], before_[i]);
    }
    NotedStops(const NotedStops&) = delete;
    NotedStops& operator=(const NotedStops&) = delete;

    /// Returns the last one; 0 if there was none.
    int signal() const { return signal_; }

  private:
    static void note(int signal) {
        signal_ = signal;
        std::signal(signal, note); // some systems drop it after one signal
    }

    static inline volatile std::sig_atomic_t signal_ = 0;
    std::array<void (*)(int), stop_signals.size()> before_{};
};

} // namespace rye::trainer
