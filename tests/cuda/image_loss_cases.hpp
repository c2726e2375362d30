// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/image_loss_cases.hpp: losses of image structure on a device against the host's in
/// double, for the emulated device and a real one.
#pragma once

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/loss/cuda/dssim.hpp>
#include <rye/loss/cuda/pyramid.hpp>
#include <rye/loss/cuda/smoothness.hpp>

#include "../support/hostile.hpp"
#include "pictures.hpp"

namespace rye::test {

/// Value and gradient of a term, which is added to what is there; a second launch gives the same
/// bits. f(weight, g): the term on the device.
template <class Device, class F>
void term_against_host(const Device& device, const CudaQueue& queue,
                       const LossGradient<double>& host, const Image<float>& like, double bound,
                       const F& f) {
    const double weight = 0.7;
    const Columns<float> before = noise<float>(like.channels(), like.size(), 77);
    DeviceLossReport<Device> report(device);
    Image<float> g_before = like;
    g_before.pixels = before;
    const DeviceFloats<Device> g(device, queue, g_before), again(device, queue, g_before);
    report.sum_into(queue, {f(weight, g.view())});
    const LossReport r = report.fetch(queue);
    CHECK(r.finite());
    CHECK(std::abs(double(r.value[0]) - host.value) <= bound * std::abs(host.value) + 1e-7);
    CHECK(std::abs(double(r.total) - weight * host.value) <= bound * std::abs(host.value) + 1e-7);
    const Columns<double> own = g.array.get().template cast<double>() - before.cast<double>();
    const double rounding = 2e-7 * before.cast<double>().norm();
    CHECK((own - weight * host.gradient).norm() <=
          bound * weight * host.gradient.norm() + rounding);
    report.sum_into(queue, {f(weight, again.view())});
    CHECK(report.fetch(queue).value[0] == r.value[0]);
    CHECK(again.array.get() == g.array.get());
}

template <class Device>
void dssim_against_host(const Device& device, const CudaQueue& queue) {
    DeviceDssim<Device> dssim_of(device);
    for (const ImageSize size : {ImageSize{5, 3}, ImageSize{32, 16}, ImageSize{45, 37}}) {
        const auto [w, h] = size;
        CAPTURE(size.width);
        const Image<float> a = float_picture(w, h, 3, 1), b = byte_picture(w, h, 3, 2);
        const DeviceFloats<Device> da(device, queue, a), db(device, queue, b);
        const DeviceBytes<Device> bytes(device, queue, b);
        const LossGradient<double> host =
            dssim<double>(ScalarBackend<Serial>{}, in_double(a), in_double(b));
        // The gradient alone, without what its sum with other terms rounds off.
        Image<float> zero(w, h, 3);
        const DeviceFloats<Device> g(device, queue, zero);
        dssim_of.into(queue, da.read(), db.read(), 1.0, g.view());
        CHECK(relative(g.array.get(), host.gradient) <= 1e-6);
        term_against_host(device, queue, host, a, 1e-5, [&](double weight, const auto& to) {
            return dssim_of.into(queue, da.read(), db.read(), weight, to);
        });
        term_against_host(device, queue, host, a, 1e-5, [&](double weight, const auto& to) {
            return dssim_of.into(queue, da.read(), bytes.read(), weight, to);
        });
    }
    const DeviceFloats<Device> a(device, queue, float_picture(9, 8, 3, 1)),
        b(device, queue, float_picture(8, 9, 3, 2));
    CHECK_FAULT(dssim_of.into(queue, a.read(), b.read(), 1.0, a.view()),
                "second picture has 3 channels of 8 x 9 pixels in 72 columns, expected 3 channels "
                "of 9 x 8");
}

template <class Device>
void pyramid_against_host(const Device& device, const CudaQueue& queue) {
    const PyramidGradientLoss loss{{1.0, 0.5, 2.0}};
    DevicePyramidLoss<Device> own(device, loss);
    for (const ImageSize size : {ImageSize{1, 1}, ImageSize{7, 2}, ImageSize{33, 29}}) {
        const auto [w, h] = size;
        CAPTURE(size.width);
        const Image<float> a = float_picture(w, h, 3, 3), b = byte_picture(w, h, 3, 4);
        const DeviceFloats<Device> da(device, queue, a), db(device, queue, b);
        const DeviceBytes<Device> bytes(device, queue, b);
        const LossGradient<double> host = loss(ScalarBackend<Serial>{}, in_double(a), in_double(b));
        term_against_host(device, queue, host, a, 1e-6, [&](double weight, const auto& to) {
            return own.into(queue, da.read(), db.read(), weight, to);
        });
        term_against_host(device, queue, host, a, 1e-6, [&](double weight, const auto& to) {
            return own.into(queue, da.read(), bytes.read(), weight, to);
        });
    }
}

template <class Device>
void smoothness_against_host(const Device& device, const CudaQueue& queue) {
    const Columns<float> values = noise<float>(5, 60, 8);
    const detail::NeighbourGraph graph = detail::four_nearest(noise<float>(3, 60, 9));
    Image<float> like(60, 1, 5);
    like.pixels = values;
    const LossGradient<double> host = smoothness<double>(values.cast<double>(), graph);
    DeviceSmoothness<Device> own(device);
    own.set(queue, graph);
    const DeviceFloats<Device> v(device, queue, like);
    term_against_host(device, queue, host, like, 1e-6, [&](double weight, const auto& to) {
        return own.into(queue, v.read().pixels, weight, to.pixels);
    });
    detail::NeighbourGraph wrong = graph;
    wrong[7][2] = 60;
    CHECK_FAULT(own.set(queue, wrong), "neighbour 2 of point 7 is 60, the graph has 60 points");
    own.set(queue, detail::NeighbourGraph(3));
    CHECK_FAULT(own.into(queue, v.read().pixels, 1.0, v.view().pixels),
                "the graph has 3 points, the values 60");
}

/// A term that is not finite is named by its place, and the others keep their values.
template <class Device>
void report_of_bad_terms(const Device& device, const CudaQueue& queue) {
    Image<float> a = float_picture(7, 5, 3, 1);
    const Image<float> b = float_picture(7, 5, 3, 2);
    const DeviceFloats<Device> good(device, queue, a), truth(device, queue, b);
    a.pixels(1, 20) = std::numeric_limits<float>::quiet_NaN();
    const DeviceFloats<Device> bad(device, queue, a), g(device, queue, b);
    DeviceDssim<Device> first(device), second(device);
    DeviceLossReport<Device> report(device);
    CHECK_FAULT(report.fetch(queue), "nothing was summed yet");
    report.sum_into(queue, {first.into(queue, good.read(), truth.read(), 0.5, g.view()),
                            second.into(queue, bad.read(), truth.read(), 2.0, g.view())});
    const LossReport r = report.fetch(queue);
    CHECK(!r.finite());
    CHECK(r.bad == 1);
    CHECK(std::isfinite(r.value[0]));
    CHECK(std::isnan(r.total));
    CHECK_FAULT(report.sum_into(queue, std::vector<DeviceLossTerm>(13)),
                "got 13 terms, 12 are the most");
}

} // namespace rye::test
