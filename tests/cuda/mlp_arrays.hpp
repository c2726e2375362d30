// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/mlp_arrays.hpp: a network's parameters in device memory.
#pragma once

#include <memory>
#include <vector>

#include <rye/nn/cuda/mlp.hpp>

#include "../support/scenes.hpp"
#include "device_render.hpp"

namespace rye::test {

/// Parameters in device memory.
template <class Device>
struct DeviceParameters {
    std::vector<std::unique_ptr<DeviceArray<Device>>> arrays;
    DeviceMlpParameters view;

    DeviceParameters(const Device& device, const CudaQueue& queue, const Mlp<float>& m) {
        const auto put = [&](const Columns<float>& a) {
            arrays.push_back(std::make_unique<DeviceArray<Device>>(device, queue, a));
            return arrays.back()->view();
        };
        for (std::size_t l = 0; l < m.weight.size(); ++l) {
            view.weight.push_back(put(m.weight[l]));
            view.bias.push_back(put(m.bias[l]));
        }
    }
    Mlp<float> get(const MlpShape& shape) const {
        Mlp<float> m(shape);
        for (std::size_t l = 0; l < m.weight.size(); ++l) {
            m.weight[l] = arrays[2 * l]->get();
            m.bias[l] = arrays[2 * l + 1]->get();
        }
        return m;
    }
};

} // namespace rye::test
