// SPDX-License-Identifier: Apache-2.0
/// rye/splat/workspaces.hpp: memory of walks over tiles, held by one thread at a time and kept for
/// the next call. Allocating it for every run of tiles would cost as much as the walks: large
/// blocks come from the system a page fault at a time. Contents are uninitialised. A thread gets
/// back the memory that it returned before, which its cache still holds, and seldom waits for
/// another one.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

namespace rye::detail {

/// Memory of threads between calls, each piece used by one thread at a time.
class Workspaces {
    struct Shelf;

  public:
    /// Base of workspaces.
    struct Space {
        virtual ~Space() = default;
    };

    /// Returns its memory to the pool when it is destroyed.
    template <class W>
    class Acquired {
      public:
        Acquired(Shelf& from, std::unique_ptr<W> space)
            : from_(from),
              space_(std::move(space)) {}
        Acquired(const Acquired&) = delete;
        Acquired& operator=(const Acquired&) = delete;
        ~Acquired() { from_.give_back(std::move(space_)); }
        W& operator*() const { return *space_; }

      private:
        Shelf& from_;
        std::unique_ptr<W> space_;
    };

    Workspaces() = default;
    /// Copies begin empty: there is no state in here.
    Workspaces(const Workspaces&) {}
    Workspaces& operator=(const Workspaces&) { return *this; }

    template <class W>
    Acquired<W> acquire() {
        const std::size_t number = number_of_thread();
        Shelf& own = shelves_[number];
        std::unique_ptr<W> space = own.template take<W>(1);
        for (std::size_t k = 1; k < shelves && space == nullptr; ++k)
            space = shelves_[(number + k) % shelves].template take<W>(0);
        return Acquired<W>(own, space != nullptr ? std::move(space) : std::make_unique<W>());
    }

  private:
    static constexpr std::size_t shelves = 64;

    /// Workspaces that one thread, or a few, gave back.
    struct alignas(64) Shelf {
        std::mutex mutex;
        std::vector<std::unique_ptr<Space>> idle;
        std::size_t lent = 0;

        /// Returns an idle workspace, or null; reserves room for the workspaces that are still to
        /// be given back, which must not fail.
        template <class W>
        std::unique_ptr<W> take(std::size_t more) {
            const std::lock_guard<std::mutex> lock(mutex);
            lent += more;
            idle.reserve(idle.size() + lent);
            for (auto& space : idle)
                if (auto* const w = dynamic_cast<W*>(space.get())) {
                    space.release();
                    std::swap(space, idle.back());
                    idle.pop_back();
                    return std::unique_ptr<W>(w);
                }
            return nullptr;
        }
        void give_back(std::unique_ptr<Space> space) {
            const std::lock_guard<std::mutex> lock(mutex);
            idle.push_back(std::move(space));
            --lent;
        }
    };

    /// Returns a number of the calling thread: its id, mixed, as ids are often addresses, whose low
    /// bits are the same.
    static std::size_t number_of_thread() {
        const std::uint64_t id = std::hash<std::thread::id>()(std::this_thread::get_id());
        return static_cast<std::size_t>(id * 0x9E3779B97F4A7C15U >> 58U) % shelves;
    }

    std::array<Shelf, shelves> shelves_;
};

} // namespace rye::detail
