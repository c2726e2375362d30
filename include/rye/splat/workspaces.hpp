// SPDX-License-Identifier: Apache-2.0
/// rye/splat/workspaces.hpp: memory of walks over tiles, held by one thread at a time and kept for
/// the next call. Allocating it for every run of tiles would cost as much as the walks: large
/// blocks come from the system a page fault at a time. What it holds is anything.
#pragma once

#include <cstddef>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

namespace rye {

/// Memory of threads between calls, each piece used by one thread at a time.
class Workspaces {
  public:
    /// Base of what is kept.
    struct Space {
        virtual ~Space() = default;
    };

    /// Returns its memory to the pool when it is destroyed.
    template <class W>
    class Acquired {
      public:
        Acquired(Workspaces& from, std::unique_ptr<W> space)
            : from_(from),
              space_(std::move(space)) {}
        Acquired(const Acquired&) = delete;
        Acquired& operator=(const Acquired&) = delete;
        ~Acquired() { from_.give_back(std::move(space_)); }
        W& operator*() const { return *space_; }

      private:
        Workspaces& from_;
        std::unique_ptr<W> space_;
    };

    Workspaces() = default;
    /// Copies begin empty: there is no state in here.
    Workspaces(const Workspaces&) {}
    Workspaces& operator=(const Workspaces&) { return *this; }

    template <class W>
    Acquired<W> acquire() {
        const std::lock_guard<std::mutex> lock(mutex_);
        for (auto& idle : idle_)
            if (auto* const w = dynamic_cast<W*>(idle.get())) {
                idle.release();
                std::swap(idle, idle_.back());
                idle_.pop_back();
                return Acquired<W>(*this, std::unique_ptr<W>(w));
            }
        idle_.reserve(++made_);      // giving back must not fail
        return Acquired<W>(*this, std::make_unique<W>());
    }

  private:
    void give_back(std::unique_ptr<Space> space) {
        const std::lock_guard<std::mutex> lock(mutex_);
        idle_.push_back(std::move(space));
    }

    std::mutex mutex_;
    std::vector<std::unique_ptr<Space>> idle_;
    std::size_t made_ = 0;
};

} // namespace rye
