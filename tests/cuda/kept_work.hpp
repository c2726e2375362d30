// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/kept_work.hpp: an emulated device with graphs: what is put on a stream while one is
/// captured is kept with its arguments, and done whenever the graph is launched. As on a device
/// nothing may wait or ask for memory meanwhile, and memory that was given back has no numbers.
#pragma once

#include <functional>
#include <map>
#include <vector>

#include <rye/backend/cuda/emulation.hpp>
#include <rye/core/error.hpp>

namespace rye::test {

/// The emulated device with graphs.
struct DeviceOfKeptWork {
    using Work = std::vector<std::function<void()>>;
    EmulatedDevice device;

    static inline Work* captured = nullptr; ///< of the graph that is being captured
    static inline int launches = 0;         ///< of graphs

    /// Work that was put on a stream once.
    class Graph {
      public:
        template <class F>
        static Graph of(const CudaQueue&, const F& f) {
            Graph r;
            captured = &r.work_;
            f();
            captured = nullptr;
            return r;
        }
        void launch(const CudaQueue&) const {
            ++launches;
            for (const auto& f : work_) f();
        }

      private:
        Work work_;
    };

    template <class Kernel>
    void launch(const CudaQueue& queue, Index blocks, const Kernel& kernel) const {
        later([=, d = device] { d.launch(queue, blocks, kernel); });
    }
    void fill(const CudaQueue& queue, void* p, int byte, std::size_t bytes) const {
        later([=, d = device] { d.fill(queue, p, byte, bytes); });
    }
    void send_later(const CudaQueue& queue, void* to, const void* from, std::size_t bytes) const {
        later([=, d = device] { d.send(queue, to, from, bytes); });
    }
    void send(const CudaQueue& queue, void* to, const void* from, std::size_t bytes) const {
        refuse("a copy that waits");
        device.send(queue, to, from, bytes);
    }
    void fetch(const CudaQueue& queue, void* to, const void* from, std::size_t bytes) const {
        refuse("a copy to the host");
        device.fetch(queue, to, from, bytes);
    }
    static void refuse(const char* what) {
        require(captured == nullptr, "kept work", what, " while a graph is captured");
    }

  private:
    template <class F>
    static void later(const F& f) {
        if (captured != nullptr)
            captured->emplace_back(f);
        else
            f();
    }
};

/// Its memory.
class MemoryOfKeptWork {
  public:
    void* allocate(std::size_t bytes, CudaStream stream) {
        DeviceOfKeptWork::refuse("memory");
        void* const p = memory_.allocate(bytes, stream);
        bytes_[p] = bytes;
        return p;
    }
    void release(void* p, CudaStream) { std::memset(p, 0xFF, bytes_.at(p)); } // and keeps it
    ~MemoryOfKeptWork() {
        for (const auto& [p, bytes] : bytes_) memory_.release(p, nullptr);
    }

  private:
    HostMemory memory_;
    std::map<void*, std::size_t> bytes_;
};

} // namespace rye::test
