// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda.hpp: arguments of device code: the caller's stream, the caller's memory, views
/// of the caller's arrays. Types only: this header needs neither nvcc nor CUDA's headers.
/// No implicit stream, pool or device.
#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <string>

#include <rye/core/column_array.hpp>
#include <rye/core/error.hpp>

struct CUstream_st;

namespace rye {

/// CUDA's cudaStream_t.
using CudaStream = CUstream_st*;

/// A source of device memory: any type with these two functions. Memory is used on the stream that
/// it was allocated for. `allocate` returns null, or throws, if it fails.
template <class M>
concept DeviceMemory = requires(M& m, void* p, std::size_t bytes, CudaStream stream) {
    { m.allocate(bytes, stream) } -> std::same_as<void*>;
    m.release(p, stream);
};

/// A reference to somebody's device memory, of any type that is DeviceMemory.
class DeviceArena {
  public:
    template <DeviceMemory M>
        requires(!std::same_as<M, DeviceArena>)
    DeviceArena(M& memory)
        : memory_(&memory),
          allocate_([](void* m, std::size_t bytes, CudaStream s) {
              return static_cast<M*>(m)->allocate(bytes, s);
          }),
          release_([](void* m, void* p, CudaStream s) { static_cast<M*>(m)->release(p, s); }) {}

    /// Throws an Error if the allocation fails.
    void* allocate(std::size_t bytes, CudaStream stream) const {
        void* const p = allocate_(memory_, bytes, stream);
        if (p == nullptr)
            throw Error("device memory: no room for " + std::to_string(bytes) + " bytes");
        return p;
    }
    void release(void* p, CudaStream stream) const { release_(memory_, p, stream); }

  private:
    void* memory_;
    void* (*allocate_)(void*, std::size_t, CudaStream);
    void (*release_)(void*, void*, CudaStream);
};

/// The caller's stream, with the caller's memory. Always an argument, never a global.
struct CudaQueue {
    CudaStream stream;
    DeviceArena memory;
    /// True if nothing is done and what is fetched is 0: memory is taken as ever, so that a caller
    /// learns beforehand how much work needs. With IdleMemory, none is there.
    bool idle = false;
};

/// Memory of an idle queue: addresses that nobody may read or write.
class IdleMemory {
  public:
    void* allocate(std::size_t bytes, CudaStream) {
        constexpr std::size_t whole = 256;
        void* const p = reinterpret_cast<void*>(next_);
        next_ += (bytes + whole) / whole * whole;
        return p;
    }
    void release(void*, CudaStream) {}

  private:
    std::uintptr_t next_ = std::uintptr_t(1) << (sizeof(void*) * 8 - 2); ///< no process has it
};

/// Columns in device memory.
template <class T>
using DeviceColumns = ColumnArray<T>;

/// Memory that only grows, and goes back to its arena at the end. It belongs to one stream at a
/// time: that of the last reserve.
template <class T>
class DeviceBuffer {
  public:
    DeviceBuffer() = default;
    DeviceBuffer(const DeviceBuffer&) = delete;
    DeviceBuffer& operator=(const DeviceBuffer&) = delete;
    ~DeviceBuffer() { clear(); }

    /// Makes room for n numbers. If it grows, the former numbers are lost.
    void reserve(const CudaQueue& queue, std::size_t n) {
        if (n <= size_) return;
        clear();
        arena_ = queue.memory;
        stream_ = queue.stream;
        data_ = static_cast<T*>(queue.memory.allocate(n * sizeof(T), queue.stream));
        size_ = n;
    }
    void clear() noexcept {
        if (data_ != nullptr) arena_.release(data_, stream_);
        data_ = nullptr;
        size_ = 0;
    }
    T* data() const { return data_; }
    std::size_t size() const { return size_; }
    std::size_t bytes() const { return size_ * sizeof(T); }

  private:
    /// The arena of nothing, until memory is asked for.
    struct None {
        void* allocate(std::size_t, CudaStream) { return nullptr; }
        void release(void*, CudaStream) {}
    };
    static inline None none_;
    DeviceArena arena_{none_};
    CudaStream stream_ = nullptr;
    T* data_ = nullptr;
    std::size_t size_ = 0;
};

} // namespace rye
