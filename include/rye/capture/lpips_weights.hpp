// SPDX-License-Identifier: Apache-2.0
/// rye/capture/lpips_weights.hpp: reads LPIPS weights from the file that
/// cmake/convert_lpips_weights.py writes: float32 tensors named after their fields.
#pragma once

#include <filesystem>
#include <string>

#include <rye/capture/safetensors.hpp>
#include <rye/core/format.hpp>
#include <rye/loss/lpips.hpp>

namespace rye {

/// Reads the weights that cmake/convert_lpips_weights.py writes. Throws Error for a missing array
/// or another shape.
template <Real T>
LpipsWeights<T> read_lpips_weights(const std::filesystem::path& path) {
    const Safetensors file = read_safetensors(path);
    LpipsWeights<T> weights;
    LpipsWeights<T>::fields(
        [&](const std::string& name, Columns<T>& a) {
            const Columns<float> read = file.columns<float>(name, a.rows(), a.cols());
            require(read.allFinite(), path.string() + ": " + name,
                    "has a number that is not finite");
            require(!name.starts_with("lin") || read.minCoeff() >= 0, path.string() + ": " + name,
                    "has a negative weight: " + number_text(read.minCoeff()));
            a = read.cast<T>();
        },
        weights);
    return weights;
}

} // namespace rye
