// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/frame_words.hpp: a frame's numbers on their way to kernels that are kept as a
/// graph, and its counts on their way back. They go by a kernel's arguments, which are copied as it
/// is launched, so that nobody waits for the memory that they are in.
#pragma once

#include <cstdint>
#include <cstring>
#include <vector>

#include <rye/backend/cuda/each.hpp>

namespace rye::detail {

/// Some words, put into device memory.
struct PutWords {
    static constexpr const char* name = "frame's numbers";
    static constexpr std::size_t most = 512;
    Array<std::uint32_t, most> word;
    std::uint32_t* to;

    RYE_DEVICE void operator()(Index i) const { to[i] = word[static_cast<std::size_t>(i)]; }
};

/// Puts n numbers of the host, of 32-bit words each, into device memory, as they are now.
template <class Device, class T>
void put_words(const Device& device, const CudaQueue& queue, T* to, const T* from, std::size_t n) {
    static_assert(std::is_trivially_copyable_v<T> && sizeof(T) % sizeof(std::uint32_t) == 0);
    const std::size_t count = n * (sizeof(T) / sizeof(std::uint32_t));
    for (std::size_t at = 0; at < count; at += PutWords::most) {
        const std::size_t some = std::min(count - at, PutWords::most);
        PutWords put{};
        std::memcpy(&put.word, reinterpret_cast<const std::uint32_t*>(from) + at,
                    some * sizeof(std::uint32_t));
        put.to = reinterpret_cast<std::uint32_t*>(to) + at;
        launch_each(device, queue, static_cast<Index>(some), put);
    }
}

/// Counts that lie here and there in device memory: where, and how many.
struct CountsAt {
    const std::uint32_t* from = nullptr;
    std::uint32_t count = 0;
};

/// Gathers counts in one place.
struct GatherWords {
    static constexpr const char* name = "frame's counts";
    static constexpr std::size_t most = 8, words = 8; ///< pieces, and words of a piece
    Array<CountsAt, most> piece;
    std::uint32_t* to; ///< most x words

    RYE_DEVICE void operator()(Index i) const {
        const auto k = static_cast<std::size_t>(i);
        const CountsAt& p = piece[k / words];
        if (k % words < p.count) to[k] = p.from[k % words];
    }
};

/// Counts of a frame that are fetched at once: pieces of up to GatherWords::words.
template <class Device>
class GatheredCounts {
  public:
    explicit GatheredCounts(const Device& device) : device_(device) {}

    /// Makes room for so many pieces. Whether there was.
    bool reserve(const CudaQueue& queue, std::size_t pieces) {
        const std::size_t room = memory_.size(), whole = GatherWords::most * GatherWords::words;
        memory_.reserve(queue, (pieces + GatherWords::most - 1) / GatherWords::most * whole);
        return memory_.size() == room;
    }
    /// Puts the gathering on the stream.
    void gather_into(const CudaQueue& queue, const std::vector<CountsAt>& pieces) const {
        for (std::size_t at = 0; at < pieces.size(); at += GatherWords::most) {
            GatherWords kernel{};
            for (std::size_t k = at; k < std::min(pieces.size(), at + GatherWords::most); ++k)
                kernel.piece[k - at] = pieces[k];
            kernel.to = memory_.data() + at * GatherWords::words;
            launch_each(device_, queue, Index(GatherWords::most * GatherWords::words), kernel);
        }
    }
    /// Takes what was gathered. Waits.
    void fetch(const CudaQueue& queue) {
        host_.resize(memory_.size());
        device_.fetch(queue, host_.data(), memory_.data(), memory_.bytes());
    }
    /// A fetched piece.
    const std::uint32_t* piece(std::size_t k) const {
        return host_.data() + k * GatherWords::words;
    }
    std::size_t bytes() const { return memory_.bytes(); }

  private:
    Device device_;
    DeviceBuffer<std::uint32_t> memory_;
    std::vector<std::uint32_t> host_;
};

} // namespace rye::detail
