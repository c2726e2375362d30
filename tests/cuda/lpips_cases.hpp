// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/lpips_cases.hpp: the learned perceptual distance on a device against the host's in
/// double, for the emulated device and a real one.
#pragma once

#include <rye/loss/cuda/lpips.hpp>

#include "image_loss_cases.hpp"

namespace rye::test {

/// A small network of random weights.
inline LpipsWeights<float> small_lpips() {
    VggShape shape;
    shape.channels = {4, 5, 6, 7, 8};
    shape.convolutions = {2, 1, 2, 1, 1};
    LpipsWeights<float> w(shape);
    std::uint64_t seed = 20;
    LpipsWeights<float>::fields(
        [&](const std::string& name, Columns<float>& a) {
            a = noise<float>(a.rows(), a.cols(), seed++);
            if (name.starts_with("lin")) a = a.cwiseAbs();
            if (name.ends_with("weight") && a.cols() > 1) a *= 0.5F;
        },
        w);
    return w;
}

struct LpipsCase {
    int width, height;           ///< of the picture
    int crop_width, crop_height; ///< of the crop
    std::int32_t at[2];
    double bound;
};

template <int N, class Device>
void lpips_against_host(const Device& device, const CudaQueue& queue, const LpipsCase& c) {
    CAPTURE(N);
    CAPTURE(c.width);
    const LpipsWeights<float> weights = small_lpips();
    LpipsVgg<double> host{LpipsWeights<double>(weights.net.shape)};
    LpipsWeights<double>::fields([](const std::string&, Columns<double>& a,
                                    const Columns<float>& b) { a = b.cast<double>(); },
                                 host.weights, weights);
    const Image<float> a = float_picture(c.width, c.height, 3, 1),
                       b = byte_picture(c.width, c.height, 3, 2);
    const auto cropped = [&](const Image<float>& from) {
        Image<double> r(c.crop_width, c.crop_height, 3);
        for (int y = 0; y < r.height; ++y)
            for (int x = 0; x < r.width; ++x)
                r.at(x, y) = from.at(x + c.at[0], y + c.at[1]).cast<double>();
        return r;
    };
    const LossGradient<double> part = host(ScalarBackend<Serial>{}, cropped(a), cropped(b));
    LossGradient<double> whole{part.value, Columns<double>::Zero(3, a.size())};
    for (int y = 0; y < c.crop_height; ++y)
        for (int x = 0; x < c.crop_width; ++x)
            whole.gradient.col((y + c.at[1]) * c.width + x + c.at[0]) =
                part.gradient.col(y * c.crop_width + x);

    DeviceBuffer<std::int32_t> place;
    place.reserve(queue, 2);
    device.send(queue, place.data(), c.at, sizeof c.at);
    const DeviceFloats<Device> picture(device, queue, a), truth(device, queue, b);
    const DeviceBytes<Device> bytes(device, queue, b);
    DeviceLpips<Device, N> lpips(device, queue, weights);
    DeviceLpipsTruth kept, of_bytes;
    CHECK_FAULT(lpips.into(queue, picture.read(), kept, 1.0, picture.view()),
                "the truth was not set");
    const DeviceCrop crop{c.crop_width, c.crop_height, place.data()};
    lpips.truth_into(queue, truth.read(), crop, kept);
    lpips.truth_into(queue, bytes.read(), crop, of_bytes);
    for (const DeviceLpipsTruth* const of : {&kept, &of_bytes})
        term_against_host(device, queue, whole, a, c.bound, [&](double weight, const auto& to) {
            return lpips.into(queue, picture.read(), *of, weight, to);
        });
    // As an objective's perceptual loss, with features that are made there and with kept ones.
    lpips.crop = crop;
    for (const DeviceLpipsTruth* const of : {static_cast<const DeviceLpipsTruth*>(nullptr),
                                             static_cast<const DeviceLpipsTruth*>(&kept)}) {
        lpips.kept = of;
        term_against_host(device, queue, whole, a, c.bound, [&](double weight, const auto& to) {
            return lpips.into(queue, picture.read(), bytes.read(), weight, to);
        });
    }
    // The value alone, of whole pictures.
    const double value = host.value(ScalarBackend<Serial>{}, in_double(a), in_double(b));
    CHECK(std::abs(lpips.value(queue, picture.read(), truth.read()) - value) < c.bound * value);
    CHECK(std::abs(lpips.value(queue, picture.read(), bytes.read()) - value) < c.bound * value);
    const DeviceFloats<Device> other(device, queue, float_picture(c.width + 1, c.height, 3, 1));
    CHECK_FAULT(lpips.value(queue, picture.read(), other.read()),
                "DeviceLpips: truth has 3 channels");
    CHECK_FAULT(lpips.truth_into(queue, truth.read(), {c.width + 1, 16}, kept), "crop of");
    CHECK_FAULT(lpips.truth_into(queue, truth.read(), {15, 16}, kept), "got 15 x 16 pixels");
}

} // namespace rye::test
