// SPDX-License-Identifier: Apache-2.0
/// rye/core/aligned.hpp: uninitialised memory from a cache line's start. A vector across two lines
/// is slow, and slower still to read back.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <new>
#include <type_traits>
#include <utility>

#include <rye/core/config.hpp>

namespace rye {

/// Scratch of one array of T whose first element begins a line of the cache. It grows and never
/// shrinks; elements have no value until they are written.
template <class T>
class AlignedArray {
    static_assert(std::is_trivially_destructible_v<T> && std::is_trivially_copyable_v<T>);

  public:
    static constexpr std::size_t alignment = 64; ///< [bytes]

    AlignedArray() = default;
    /// Copies begin empty: elements are a scratch of their owner.
    AlignedArray(const AlignedArray&) {}
    AlignedArray& operator=(const AlignedArray&) { return *this; }
    AlignedArray(AlignedArray&&) = default;
    AlignedArray& operator=(AlignedArray&&) = default;

    T* data() { return memory_.get(); }
    const T* data() const { return memory_.get(); }

    /// Makes room for n elements and returns the first. If there was not as much, the former
    /// elements are gone.
    T* reserve(Index n) {
        const auto wanted = static_cast<std::size_t>(std::max<Index>(n, 1));
        if (wanted > capacity_) {
            const std::size_t larger = wanted + wanted / 2;
            memory_.reset();
            capacity_ = 0;
            memory_.reset(static_cast<T*>(
                ::operator new(larger * sizeof(T), std::align_val_t(alignment))));
            std::uninitialized_default_construct_n(memory_.get(), larger);
            capacity_ = larger;
        }
        return memory_.get();
    }
    /// Does what reserve does, but the first `kept` elements stay.
    T* grow(Index n, Index kept) {
        if (static_cast<std::size_t>(n) <= capacity_) return memory_.get();
        AlignedArray larger;
        larger.reserve(n);
        if (kept > 0) std::copy_n(memory_.get(), kept, larger.memory_.get());
        std::swap(memory_, larger.memory_);
        std::swap(capacity_, larger.capacity_);
        return memory_.get();
    }

  private:
    struct Release {
        void operator()(T* p) const { ::operator delete(p, std::align_val_t(alignment)); }
    };

    std::unique_ptr<T[], Release> memory_;
    std::size_t capacity_ = 0;           ///< elements
};

} // namespace rye
