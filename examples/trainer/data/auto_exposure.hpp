// SPDX-License-Identifier: Apache-2.0
/// examples/trainer/data/auto_exposure.hpp: what a phone's camera does to the brightness of a film.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include <rye/math/srgb.hpp>

#include "data/picture.hpp"

namespace rye::trainer {

/// Gain of linear light that keeps the mean of each picture where that of the first one was. It
/// follows within `lag` seconds, so that a face that comes into the light is too bright at first.
class AutoExposure {
  public:
    /// rate: pictures a second.
    explicit AutoExposure(double rate, double lag = 0.4) : step_(1 - std::exp(-1 / (rate * lag))) {
        for (std::size_t i = 0; i < linear_.size(); ++i)
            linear_[i] = linear_from_srgb(static_cast<double>(i) / 255);
    }

    /// Exposes the next picture, sRGB of 3 channels; returns the gain.
    double expose(Image8& picture) {
        double sum = 1e-6;
        for (const std::uint8_t v : picture.values) sum += linear_[v];
        const double mean = sum / static_cast<double>(picture.values.size());
        if (first_ == 0) first_ = mean;
        log_gain_ += step_ * (std::log(first_ / mean) - log_gain_);
        const double gain = std::exp(log_gain_);
        std::array<std::uint8_t, 256> shown{};
        for (std::size_t i = 0; i < shown.size(); ++i)
            shown[i] = static_cast<std::uint8_t>(
                std::lround(255 * std::min(1.0, srgb_from_linear(gain * linear_[i]))));
        for (std::uint8_t& v : picture.values) v = shown[v];
        return gain;
    }

  private:
    double step_, log_gain_ = 0;
    double first_ = 0; ///< mean of the first picture; 0: there was none
    std::array<double, 256> linear_{};
};

} // namespace rye::trainer
