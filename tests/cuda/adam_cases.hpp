// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/adam_cases.hpp: Adam on a device against the host's, for the emulated device and a
/// real one.
#pragma once

#include <doctest/doctest.h>

#include <limits>

#include <rye/backend/scalar.hpp>
#include <rye/nn/cuda/adam.hpp>

#include "../support/hostile.hpp"
#include "../support/scenes.hpp"
#include "device_render.hpp"

namespace rye::test {

struct ThreeArrays {
    Columns<float> a, b, c;

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f("a", p.a...);
        f("b", p.b...);
        f("c", p.c...);
    }
    static ThreeArrays some(std::uint64_t seed) {
        return {noise<float>(3, 700, seed), noise<float>(5, 1, seed + 1),
                noise<float>(1, 9, seed + 2)};
    }
};

/// Steps with fields that start late and rates that change; a gradient that is not finite, which
/// changes nothing; and on from the host's state. `bound`: relative error of values and moments.
template <class Device>
void adam_against_host(const Device& device, const CudaQueue& queue, double bound) {
    ThreeArrays p = ThreeArrays::some(1);
    Adam<ThreeArrays> adam(p);
    const ResidentLayout<ThreeArrays> layout(p);
    Resident<ThreeArrays, Device> parameters(device, queue, layout),
        gradient(device, queue, layout);
    DeviceAdam<ThreeArrays, Device> optimiser(device, queue, layout);
    parameters.send(queue, p);
    const DeviceColumns<float> of_b = parameters.of(p.b);
    CHECK(of_b.rows == 5);
    CHECK(of_b.cols == 1);
    const Columns<float> elsewhere;
    CHECK_FAULT(parameters.of(elsewhere), "not one of the struct's 3");

    std::int64_t step = 0;
    const auto rate = [&](const std::string& name) {
        if (name == "b" && step < 3) return 0.0;
        return name == "c" ? 1e-3 * static_cast<double>(step) : 1e-2;
    };
    const auto equal = [&](const auto& optimiser_now) {
        ThreeArrays found = p;
        parameters.fetch(queue, found);
        Adam<ThreeArrays> state(p);
        optimiser_now.fetch(queue, state);
        CHECK(state.step == adam.step);
        CHECK(state.field_steps == adam.field_steps);
        ThreeArrays::fields(
            [&](const std::string& name, const auto& x, const auto& y, const auto& m,
                const auto& m_host, const auto& v, const auto& v_host) {
                CAPTURE(name);
                CHECK(relative(x, y) <= bound);
                CHECK(relative(m, m_host) <= bound);
                CHECK(relative(v, v_host) <= bound);
            },
            found, p, state.m, adam.m, state.v, adam.v);
    };
    const ScalarBackend<Serial> host;
    for (; step < 6; ++step) {
        const ThreeArrays g = ThreeArrays::some(10 + static_cast<std::uint64_t>(step));
        gradient.send(queue, g);
        optimiser.set_rates(queue, rate);
        optimiser.step_into(queue, parameters, gradient);
        CHECK(optimiser.report(queue).applied);
        CHECK(adam_step(host, p, g, adam, rate).applied);
        equal(optimiser);
    }
    ThreeArrays bad = ThreeArrays::some(30);
    bad.a(2, 600) = std::numeric_limits<float>::infinity();
    bad.c(0, 3) = std::numeric_limits<float>::quiet_NaN();
    gradient.send(queue, bad);
    optimiser.step_into(queue, parameters, gradient);
    const AdamReport report = optimiser.report(queue);
    CHECK(!report.applied);
    CHECK(report.first_bad_field == "a");
    CHECK(adam_step(host, p, bad, adam, rate).first_bad_field == "a");
    equal(optimiser);
    // A field that does not move may have any gradient.
    const auto only_b = [](const std::string& name) { return name == "b" ? 1e-2 : 0.0; };
    optimiser.set_rates(queue, only_b);
    optimiser.step_into(queue, parameters, gradient);
    CHECK(optimiser.report(queue).applied);
    adam_step(host, p, bad, adam, only_b);
    equal(optimiser);

    DeviceAdam<ThreeArrays, Device> resumed(device, queue, layout);
    resumed.send(queue, adam);
    parameters.send(queue, p);
    const ThreeArrays g = ThreeArrays::some(40);
    gradient.send(queue, g);
    resumed.set_rates(queue, rate);
    resumed.step_into(queue, parameters, gradient);
    adam_step(host, p, g, adam, rate);
    equal(resumed);
}

} // namespace rye::test
