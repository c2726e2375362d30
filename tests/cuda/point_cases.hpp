// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/point_cases.hpp: what avatars on a device are made of, each against the host's:
/// lists, sums, influences, codes, networks over a list's points and over one column. For the
/// emulated device and a real one.
#pragma once

#include <doctest/doctest.h>

#include <cmath>
#include <vector>

#include <rye/avatar/weights.hpp>
#include <rye/backend/cuda/each.hpp>
#include <rye/backend/cuda/lists.hpp>
#include <rye/backend/scalar.hpp>
#include <rye/nn/cuda/encoding.hpp>
#include <rye/nn/cuda/mlp_column.hpp>
#include <rye/rig/cuda/influence.hpp>

#include "../support/hostile.hpp"
#include "mlp_arrays.hpp"

namespace rye::test {

/// Indices of positive numbers, of three arrays at once, of few and of many blocks.
template <class Device>
void lists_against_host(const Device& device, const CudaQueue& queue) {
    DeviceLists<Device> lists(device);
    for (const Index n : {0, 1, 255, 256, 257, 5000, 70000}) {
        CAPTURE(n);
        Columns<float> numbers[3] = {noise<float>(1, n, 1), noise<float>(1, n, 2),
                                     Columns<float>::Constant(1, n, 1.0F)};
        if (n > 1) numbers[0](0, n / 2) = std::nanf(""), numbers[1](0, 0) = 0.0F;
        const DeviceArray<Device> a(device, queue, numbers[0]), b(device, queue, numbers[1]),
            c(device, queue, numbers[2]);
        lists.make(queue, {{a.buffer.data(), b.buffer.data(), c.buffer.data(), nullptr}}, 3, n);
        std::uint32_t count[detail::DeviceListArrays::most] = {9, 9, 9, 9};
        lists.fetch_counts(queue, count);
        for (int k = 0; k < 3; ++k) {
            CAPTURE(k);
            std::vector<Index> expected;
            for (Index i = 0; i < n; ++i)
                if (numbers[k](0, i) > 0) expected.push_back(i);
            REQUIRE(count[k] == expected.size());
            std::vector<std::uint32_t> found(expected.size());
            device.fetch(queue, found.data(), lists.list(k), found.size() * 4);
            CHECK(std::vector<Index>(found.begin(), found.end()) == expected);
        }
        CHECK(count[3] == 9);
    }
}

/// Sums of a number, of its square, and of 1.
struct ThreeSums {
    static constexpr const char* name = "three sums";
    static constexpr int sums = 3;
    const float* x;
    template <class Sums>
    RYE_DEVICE void operator()(Index i, Sums& sum) const {
        sum[0] += x[i];
        sum[1] += x[i] * x[i];
        sum[2] += 1.0F;
    }
};

template <class Device>
void sums_against_host(const Device& device, const CudaQueue& queue) {
    DeviceSums<Device> sums(device);
    for (const Index n : {0, 1, 127, 128, 129, 40000}) {
        CAPTURE(n);
        const Columns<float> x = noise<float>(1, n, 4);
        const Columns<double> y = x.cast<double>();
        const DeviceArray<Device> in(device, queue, x), out(device, queue, 3, 1);
        sums.launch(queue, n, ThreeSums{in.buffer.data()}, {out.buffer.data()});
        const double scale = 1 + std::sqrt(static_cast<double>(n));
        const auto near = [&](const Columns<float>& found, double times) {
            CHECK(std::abs(static_cast<double>(found(0)) - times * y.sum()) < 1e-6 * scale);
            CHECK(std::abs(static_cast<double>(found(1)) - times * y.squaredNorm()) <
                  2e-7 * (1 + times * y.squaredNorm()));
            CHECK(static_cast<double>(found(2)) == times * static_cast<double>(n));
        };
        near(out.get(), 1);
        sums.launch(queue, n, ThreeSums{in.buffer.data()}, {out.buffer.data(), true});
        near(out.get(), 2);
    }
}

/// Influences of two kinds and their pull, against the host's of floats, which are the same
/// formulas, and of doubles; a point that is not a number, and no landmark at all.
template <class Device, class M>
void influences_against_host(const Device& device, const CudaQueue& queue, const M& metric) {
    AvatarConfig config;
    config.metric = metric;
    const Index n = 300;
    Columns<float> points = noise<float>(3, n, 5), landmarks = noise<float>(3, 17, 6);
    points.col(7) = landmarks.col(3);
    points(1, 11) = std::nanf("");
    const DeviceArray<Device> at(device, queue, points), marks(device, queue, landmarks),
        lambda(device, queue, 1, n), rest(device, queue, 1, n),
        g_points(device, queue, Columns<float>(Columns<float>::Ones(3, n)));
    DeviceBuffer<int> nearest;
    nearest.reserve(queue, static_cast<std::size_t>(n));
    const DeviceLandmarks of{at.buffer.data(), marks.buffer.data(), 17,
                             detail::checked_ramp(0.05F, 0.25F)};
    launch_each(device, queue, n,
                detail::InfluenceOfPoint{of, metric, metric, lambda.buffer.data(),
                                         rest.buffer.data(), nearest.data()});
    const Columns<float> g = noise<float>(1, n, 7), g_rest = noise<float>(1, n, 8);
    const DeviceArray<Device> on_device(device, queue, g), rest_on_device(device, queue, g_rest);
    launch_each(device, queue, n,
                detail::InfluencePull{of, metric, nearest.data(), on_device.buffer.data(),
                                      rest_on_device.buffer.data(), g_points.buffer.data()});
    std::vector<Index> all(17);
    for (std::size_t k = 0; k < all.size(); ++k) all[k] = static_cast<Index>(k);
    const ScalarBackend<Serial> host;
    const auto truth = [&]<class T>(T, double bound) {
        const Columns<T> x = points.cast<T>(), l = landmarks.cast<T>();
        NearestTrace<T> trace;
        const InfluenceInput<T> in{config, x, l};
        const Columns<T> w = detail::set_weights(host, {in, 0.05, 0.25}, all, trace);
        CHECK(relative(lambda.get(), w) <= bound);
        CHECK(relative(rest.get(), Columns<T>(Columns<T>::Ones(1, n) - w)) <= bound);
        Columns<T> pulled = Columns<T>::Ones(3, n);
        detail::set_weights_vjp(host, {in, 0.05, 0.25}, trace,
                                [&](Index i) { return T(g(i)) - T(g_rest(i)); }, {pulled, nullptr});
        CHECK(pulled != Columns<T>::Ones(3, n));
        CHECK(relative(g_points.get(), pulled) <= bound);
        CHECK(w.minCoeff() == 0);
        CHECK(w.maxCoeff() == 1);
    };
    truth(0.0F, 1e-6);
    truth(0.0, 1e-6);
    const Columns<float> found = lambda.get();
    CHECK(found(7) == 1.0F);
    CHECK(found(11) == 0.0F);
    DeviceLandmarks none = of;
    none.count = 0;
    launch_each(device, queue, n,
                detail::InfluenceOfPoint{none, metric, metric, lambda.buffer.data(),
                                         static_cast<float*>(nullptr), nearest.data()});
    CHECK(lambda.get() == Columns<float>::Zero(1, n));
}

/// Codes of points, and features' bounds, there and back.
template <class Device>
void codes_against_host(const Device& device, const CudaQueue& queue) {
    const Index n = 130;
    const int frequencies = 4;
    const Columns<float> x = 2 * noise<float>(3, n, 1), g = noise<float>(27, n, 2);
    const DeviceArray<Device> in(device, queue, x), code(device, queue, 27, n),
        cotangent(device, queue, g), back(device, queue, Columns<float>(x));
    launch_each(device, queue, 3 * n,
                detail::EncodeNumber{in.buffer.data(), 3, frequencies, code.buffer.data()});
    launch_each(device, queue, 3 * n,
                detail::EncodeNumberVjp{code.buffer.data(), cotangent.buffer.data(), 3, frequencies,
                                        back.buffer.data()});
    const Columns<double> x64 = x.cast<double>(), y = positional_encoding(x64, frequencies),
                          g64 = g.cast<double>();
    CHECK(relative(code.get(), y) < 1e-6);
    CHECK(relative(back.get(),
                   Columns<double>(x64 + positional_encoding_vjp(y, g64, frequencies))) < 1e-6);
    const DeviceArray<Device> bounded(device, queue, 3, n),
        through(device, queue, Columns<float>(Columns<float>::Zero(3, n)));
    launch_each(device, queue, 3 * n, detail::TanhNumber{in.buffer.data(), bounded.buffer.data()});
    launch_each(
        device, queue, 3 * n,
        detail::TanhNumberVjp{bounded.buffer.data(), in.buffer.data(), through.buffer.data()});
    const Columns<double> t = x64.array().tanh();
    CHECK(relative(bounded.get(), t) < 1e-6);
    CHECK(relative(through.get(),
                   Columns<double>(x64.array() * (1 - t.array()) * (1 + t.array()))) < 1e-6);
}

/// A network over the points that a list names: as over those points alone, at their columns, and
/// added to what is there. Columns that the list does not name keep their bits.
template <class Tiles, class Device>
void mlp_of_a_list(const Device& device, const CudaQueue& queue, Index listed,
                   const MlpShape& s = {{21, 40, 33, 5}, 4}) {
    CAPTURE(listed);
    const Index n = 400, inputs = s.point_inputs(), outputs = s.outputs(), room = listed + 37;
    const Mlp<float> m = Mlp<float>::init(s, Random{3});
    const Columns<float> points = noise<float>(inputs, n, 1),
                         frame = noise<float>(s.frame_inputs, 1, 3);
    std::vector<std::uint32_t> which(static_cast<std::size_t>(room), 0xFFFFFF);
    std::vector<Index> picked;
    for (Index k = 0; k < listed; ++k) {
        picked.push_back(k * n / listed);
        which[static_cast<std::size_t>(k)] = static_cast<std::uint32_t>(picked.back());
    }
    const Columns<float> alone = pick_columns(points, picked);
    Columns<float> g_out = noise<float>(outputs, room, 2), g_alone = g_out.leftCols(listed);
    DeviceBuffer<std::uint32_t> list;
    list.reserve(queue, which.size() + 1);
    device.send(queue, list.data(), which.data(), which.size() * 4);
    const auto count = static_cast<std::uint32_t>(listed);
    device.send(queue, list.data() + room, &count, 4);
    const DeviceParameters<Device> parameters(device, queue, m),
        gradient(device, queue, Mlp<float>(s)), expected(device, queue, Mlp<float>(s));
    const DeviceArray<Device> in(device, queue, points), in_alone(device, queue, alone),
        of_frame(device, queue, frame), out(device, queue, outputs, room),
        out_alone(device, queue, outputs, listed), g(device, queue, g_out),
        of_g_alone(device, queue, g_alone), g_frame(device, queue, frame),
        g_frame_alone(device, queue, s.frame_inputs, 1), g_points(device, queue, points),
        g_points_alone(device, queue, inputs, listed);
    DeviceMlpScratch scratch;
    DeviceMlp<Device, Tiles> network(device, s), other(device, s);
    network.share(scratch);
    other.share(scratch);
    network.set(queue, parameters.view, of_frame.buffer.data());
    other.set(queue, parameters.view, of_frame.buffer.data());
    network.forward_into(queue, DeviceMlpPoints{in.read(), {list.data(), list.data() + room}, room},
                         out.view());
    other.forward_into(queue, in_alone.read(), out_alone.view());
    network.vjp_into(queue, g.read(),
                     {gradient.view, g_points.view(), g_frame.buffer.data(), true});
    other.vjp_into(queue, of_g_alone.read(),
                   {expected.view, g_points_alone.view(), g_frame_alone.buffer.data()});
    CHECK(out.get().leftCols(listed) == out_alone.get());
    CHECK(!(out.get().rightCols(37).array() == out.get().rightCols(37).array()).any());
    const Mlp<float> found = gradient.get(s), right = expected.get(s);
    for (std::size_t l = 0; l < m.weight.size(); ++l) {
        CHECK(found.weight[l] == right.weight[l]);
        CHECK(found.bias[l] == right.bias[l]);
    }
    Columns<float> sum = points;
    const Columns<float> added = g_points_alone.get();
    for (Index k = 0; k < listed; ++k) sum.col(picked[std::size_t(k)]) += added.col(k);
    CHECK(relative(g_points.get(), sum) < 2e-7);
    CHECK(relative(g_frame.get(), Columns<float>(frame + g_frame_alone.get())) < 1e-6);
}

/// A network of one column against the host's in double.
template <class Device>
void mlp_column_against_host(const Device& device, const CudaQueue& queue, const MlpShape& s) {
    CAPTURE(s.dims.size());
    const Mlp<float> m = Mlp<float>::init(s, Random{3});
    Mlp<double> m64(s), g64(s);
    for (std::size_t l = 0; l < m.weight.size(); ++l) {
        m64.weight[l] = m.weight[l].cast<double>();
        m64.bias[l] = m.bias[l].cast<double>();
    }
    const Columns<float> x = noise<float>(s.inputs(), 1, 1), g = noise<float>(s.outputs(), 1, 2);
    const Columns<double> x64 = x.cast<double>();
    const ScalarBackend<Serial> host;
    MlpTrace<double> trace;
    const VecX<double> none;
    const Columns<double> y = mlp_forward<double>(host, m64, x64, none, &trace);
    Columns<double> g_x;
    mlp_vjp<double>(host, m64, {x64, none, trace}, Columns<double>(g.cast<double>()),
                    {.params = g64, .points = &g_x});
    const DeviceParameters<Device> parameters(device, queue, m),
        gradient(device, queue, Mlp<float>(s));
    const DeviceArray<Device> in(device, queue, x), cotangent(device, queue, g),
        g_input(device, queue, s.inputs(), 1), out(device, queue, s.outputs(), 1);
    DeviceMlpColumn<Device> network(device, s);
    network.set(queue, parameters.view, in.buffer.data());
    network.forward_into(queue);
    launch_each(device, queue, s.outputs(),
                detail::CopyNumbers{network.outputs(), out.buffer.data()});
    network.vjp_into(queue, cotangent.buffer.data(), gradient.view, g_input.buffer.data());
    CHECK(relative(out.get(), y) < 1e-6);
    CHECK(relative(g_input.get(), g_x) < 1e-6);
    const Mlp<float> found = gradient.get(s);
    for (std::size_t l = 0; l < m.weight.size(); ++l) {
        CAPTURE(l);
        CHECK(relative(found.weight[l], g64.weight[l]) < 1e-6);
        CHECK(relative(found.bias[l], g64.bias[l]) < 1e-6);
    }
}
template <class Device>
void mlp_column_too_deep(const Device& device) {
    CHECK_FAULT(DeviceMlpColumn<Device>(device, MlpShape{{8, 8, 8, 8, 8, 8, 8, 8, 8, 8, 3}}),
                "number of layers is 10");
    CHECK_FAULT(DeviceMlpColumn<Device>(device, MlpShape{{8, 8, 3}, 2}),
                "number of frame inputs is 2");
}

} // namespace rye::test
