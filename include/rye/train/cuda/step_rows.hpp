// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/step_rows.hpp: draws of a run of steps as a table in device memory, and the views
/// among them that come from the host's memory.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include <rye/train/cuda/step_kernels.hpp>

namespace rye::detail {

/// Draws of a run of steps.
template <class Device>
class DeviceStepRows {
  public:
    explicit DeviceStepRows(const Device& device) : device_(device) {}

    /// Sends the draws, of steps of so many pictures; waits. Returns true if the table or places of
    /// views have moved. Throws an Error for a view that does not exist and for a part of a step.
    bool send(const CudaQueue& queue, const std::vector<StepDraw>& draws, std::size_t pictures,
              DeviceViews<Device>& views) {
        require(draws.size() % pictures == 0, "DeviceAvatarTrainer", "got ", draws.size(),
                " draws, expected a multiple of ", pictures);
        std::vector<DeviceStepRow> rows;
        fetched_.clear();
        before_.clear();
        for (const StepDraw& d : draws) {
            require(d.view >= 0 && d.view < views.count(), "DeviceAvatarTrainer", "step ",
                    rows.size(), " shows view ", d.view, ", there are ", views.count());
            before_.push_back(static_cast<Index>(fetched_.size()));
            Index entry = d.view;
            if (views.on_host(d.view)) {
                entry = views.entry_of_fetched(before_.back());
                fetched_.push_back(d.view);
            }
            rows.push_back({entry, d.rate, d.scale, {d.blank[0], d.blank[1], d.blank[2]}});
        }
        const void *const rows_before = rows_.data(), *const places_before = places_;
        rows_.reserve(queue, rows.size());
        device_.send(queue, rows_.data(), rows.data(), rows.size() * sizeof(DeviceStepRow));
        places_ = views.places(queue);
        return rows_.data() != rows_before || places_ != places_before;
    }
    /// Begins to fetch the views of the draws from number `first` on.
    void fetch(const CudaQueue& queue, DeviceViews<Device>& views, std::size_t first) const {
        if (!fetched_.empty() && first < before_.size())
            views.fetch(queue, fetched_, before_[first]);
    }

    const DeviceStepRow* data() const { return rows_.data(); }
    /// Returns the views' arrays, in device memory.
    const DeviceViewPlace* places() const { return places_; }
    std::size_t bytes() const { return rows_.bytes(); }

  private:
    Device device_;
    DeviceBuffer<DeviceStepRow> rows_;
    const DeviceViewPlace* places_ = nullptr;
    std::vector<Index> fetched_; ///< views that come from the host, in the order of the draws
    std::vector<Index> before_;  ///< number of them before each draw
};

} // namespace rye::detail
