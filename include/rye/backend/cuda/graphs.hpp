// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/graphs.hpp: work that is put on a stream again and again, kept as graphs where
/// a device has them. Each kind of work runs once as it is, in which its memory is taken.
#pragma once

#include <cstddef>
#include <map>
#include <set>

#include <rye/backend/cuda.hpp>
#include <rye/backend/cuda/member_type.hpp>

namespace rye {

/// A device whose work can be kept and launched again.
template <class D>
concept DeviceWithGraphs = requires {
    typename D::Graph;
};

/// Graphs of one device by their keys. Key: all arguments of the work that may change; Kind: those
/// that determine its memory.
template <class Device, class Kind, class Key>
class KeptGraphs {
  public:
    static constexpr std::size_t most = 64; ///< graphs that are kept; more work runs as it is

    /// Runs the work of a key, which f() puts on the queue's stream. The first work of a kind may
    /// move memory that other kinds share, so it forgets their graphs.
    template <class F>
    void run(const CudaQueue& queue, const Kind& kind, const Key& key, const F& f) {
        if constexpr (DeviceWithGraphs<Device>) {
            if (queue.idle) return f();
            if (warm_.insert(kind).second) {
                graphs_.clear();
            } else {
                auto at = graphs_.find(key);
                if (at == graphs_.end() && graphs_.size() < most)
                    at = graphs_.emplace(key, Device::Graph::of(queue, f)).first;
                if (at != graphs_.end()) return at->second.launch(queue);
            }
        }
        f();
    }
    /// Forgets all graphs: to be called if memory that they use was moved, or is to grow.
    void forget() {
        graphs_.clear();
        warm_.clear();
    }
    std::size_t size() const { return graphs_.size(); }

  private:
    template <class D>
    using GraphOf = typename D::Graph;

    std::set<Kind> warm_;
    std::map<Key, MemberType<Device, GraphOf>> graphs_;
};

} // namespace rye
