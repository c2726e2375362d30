// SPDX-License-Identifier: Apache-2.0
/// commands/view.hpp: a training that is shown while it goes on.
#pragma once

#include <atomic>
#include <filesystem>
#include <string>
#include <thread>

namespace rye::trainer {

/// Server of `rye view` for a run's folder on a thread of its own, during its life. It draws the
/// last checkpoint on the CPU, and a fault of it is a note on standard error, never the training's.
class ViewedTraining {
  public:
    /// Throws an Error if the port is taken, or the program was built without a server.
    ViewedTraining(std::filesystem::path run, int port);
    ~ViewedTraining();
    ViewedTraining(const ViewedTraining&) = delete;
    ViewedTraining& operator=(const ViewedTraining&) = delete;

    const std::string& address() const { return address_; }

  private:
    std::atomic<bool> stop_ = false;
    std::string address_;
    std::thread thread_;
};

} // namespace rye::trainer
