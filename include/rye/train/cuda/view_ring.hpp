// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/view_ring.hpp: pictures that a device has no room for: they stay in the host's
/// memory, and a few places in the device's hold those that come next. A copy runs beside the
/// pictures before it, on a stream of its own where the device has several.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include <rye/backend/cuda/branches.hpp>
#include <rye/backend/cuda/member_type.hpp>

namespace rye {

/// Places for pictures in device memory, taken in turn.
template <class Device>
class ViewRing {
  public:
    static constexpr Index places = 3;

    explicit ViewRing(const Device& device) : device_(device) {}

    /// Makes room for pictures of so many bytes.
    void reserve(const CudaQueue& queue, std::size_t bytes) {
        bytes_ = bytes;
        for (Place& p : place_) {
            p.memory.reserve(queue, bytes);
            if constexpr (DeviceWithBranches<Device>)
                if (p.branch == nullptr) p.branch = std::make_unique<typename Device::Branch>();
        }
    }
    /// Returns place k's memory.
    const std::uint8_t* place(Index k) const {
        return place_[static_cast<std::size_t>(k)].memory.data();
    }

    /// Begins to fetch pictures, in page-locked memory of the host, in this order from number
    /// `first` on: number j comes to place j % places. No earlier work may read the places.
    void begin(const CudaQueue& queue, const std::vector<const std::uint8_t*>& order, Index first) {
        order_ = order;
        next_ = first;
        for (Index j = first; j < first + places; ++j) fetch(queue, j);
    }
    /// Lets later work of the queue follow the copy of the next picture.
    void await(const CudaQueue& queue) {
        if constexpr (DeviceWithBranches<Device>) at(next_).branch->end(queue);
        static_cast<void>(queue);
    }
    /// Ends the use of that picture by the work that is on the queue, and fetches a later one to
    /// its place.
    void used(const CudaQueue& queue) { fetch(queue, next_++ + places); }

    std::size_t bytes() const {
        std::size_t sum = 0;
        for (const Place& p : place_) sum += p.memory.bytes();
        return sum;
    }

  private:
    template <class D>
    using BranchOf = typename D::Branch;
    struct Place {
        DeviceBuffer<std::uint8_t> memory;
        std::unique_ptr<detail::MemberType<Device, BranchOf>> branch;
    };

    Place& at(Index j) { return place_[static_cast<std::size_t>(j % places)]; }
    void fetch(const CudaQueue& queue, Index j) {
        if (j >= static_cast<Index>(order_.size())) return;
        Place& to = at(j);
        const std::uint8_t* const from = order_[static_cast<std::size_t>(j)];
        if constexpr (DeviceWithBranches<Device>)
            device_.send_later(to.branch->begin(queue), to.memory.data(), from, bytes_);
        else
            device_.send_later(queue, to.memory.data(), from, bytes_);
    }

    Device device_;
    std::size_t bytes_ = 0;
    std::array<Place, static_cast<std::size_t>(places)> place_;
    std::vector<const std::uint8_t*> order_;
    Index next_ = 0;
};

} // namespace rye
