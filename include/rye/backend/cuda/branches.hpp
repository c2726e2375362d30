// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/branches.hpp: work that may run at once on a device, where each piece alone
/// would leave most of it idle. In a captured graph these are branches.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include <rye/backend/cuda.hpp>
#include <rye/backend/cuda/member_type.hpp>

namespace rye {

/// A device that has streams beside a queue's.
template <class D>
concept DeviceWithBranches = requires {
    typename D::Branch;
};

/// Streams beside a queue's. Memory that was allocated on them must not outlive them, as it goes
/// back through them.
template <class Device>
class DeviceBranches {
  public:
    /// Calls f(k, queue) for k in [0, count), each with a queue of its own. No piece of work may
    /// read or write what another one writes. All of it runs after earlier work of `queue` and
    /// before later work. A device of one stream runs the last piece first, which exposes a piece
    /// that needs an earlier one.
    template <class F>
    void run(const CudaQueue& queue, std::size_t count, const F& f) {
        if constexpr (DeviceWithBranches<Device>) {
            while (branch_.size() + 1 < count)
                branch_.push_back(std::make_unique<typename Device::Branch>());
            std::vector<CudaQueue> queues{queue};
            for (std::size_t k = 1; k < count; ++k) queues.push_back(branch_[k - 1]->begin(queue));
            for (std::size_t k = 0; k < count; ++k) f(k, queues[k]);
            for (std::size_t k = 1; k < count; ++k) branch_[k - 1]->end(queue);
        } else {
            for (std::size_t k = count; k-- > 0;) f(k, queue);
        }
    }

  private:
    template <class D>
    using BranchOf = typename D::Branch;

    std::vector<std::unique_ptr<detail::MemberType<Device, BranchOf>>> branch_;
};

} // namespace rye
