// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/loss_cases.hpp: losses on a device against the host's, for the emulated device and a
/// real one.
#pragma once

#include <doctest/doctest.h>

#include <limits>

#include <rye/backend/scalar.hpp>
#include <rye/loss/cuda/photometric.hpp>

#include "../support/hostile.hpp"
#include "../support/scenes.hpp"
#include "device_render.hpp"

namespace rye::test {

template <class Device>
void masked_l1_against_host(const Device& device, const CudaQueue& queue) {
    for (const Index pixels : {0, 1, 1023, 3000})
        for (const bool masked : {false, true}) {
            CAPTURE(pixels);
            CAPTURE(masked);
            Columns<float> a = noise<float>(3, pixels, 1);
            const Columns<float> b = noise<float>(3, pixels, 2),
                                 before = noise<float>(3, pixels, 4);
            Columns<float> mask = masked ? noise<float>(1, pixels, 3) : Columns<float>();
            if (masked && pixels > 5) {
                mask(0, 5) = 0;
                a(1, 5) = std::numeric_limits<float>::quiet_NaN();
            }
            if (pixels > 7) a.col(7) = b.col(7); // slope 0
            Columns<float> g_host = before;
            const float host =
                add_masked_l1<float>(ScalarBackend<Serial>{}, a, b, {mask, 0.7F}, g_host);
            const DeviceArray<Device> da(device, queue, a), db(device, queue, b),
                dm(device, queue, mask), g(device, queue, before), value(device, queue, 1, 1);
            DeviceBuffer<double> partial;
            DeviceImagePair images{da.read(), db.read()};
            if (masked) images.mask = dm.read();
            masked_l1_into(device, queue, images, 0.7F, g.view(), partial, value.buffer.data());
            CHECK(relative(value.get(), Columns<float>(Columns<float>::Constant(1, 1, host))) <=
                  1e-6);
            CHECK(relative(g.get(), g_host) <= 1e-7);
        }
    const DeviceArray<Device> a(device, queue, noise<float>(3, 4, 1)),
        b(device, queue, noise<float>(3, 5, 1)), value(device, queue, 1, 1);
    DeviceBuffer<double> partial;
    CHECK_FAULT(masked_l1_into(device, queue, {a.read(), b.read()}, 1.0F, a.view(), partial,
                               value.buffer.data()),
                "second image is 3 x 5, expected 3 x 4");
}

} // namespace rye::test
