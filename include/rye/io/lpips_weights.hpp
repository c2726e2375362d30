// SPDX-License-Identifier: Apache-2.0
/// rye/io/lpips_weights.hpp: reads LPIPS weights from the file that
/// cmake/convert_lpips_weights.py writes: float32 tensors named after their fields.
#pragma once

#include <filesystem>
#include <string>

#include <rye/io/safetensors.hpp>
#include <rye/core/format.hpp>
#include <rye/loss/lpips.hpp>

namespace rye {

/// Fills weights, which have the expected shapes, from a file that `who` names. Throws an Error for
/// a missing array, another shape, numbers that are not finite, and negative ones where none
/// may be.
template <Real T>
void load_lpips_weights(const Safetensors& file, const std::string& who, LpipsWeights<T>& weights) {
    LpipsWeights<T>::fields(
        [&](const std::string& name, Columns<T>& a) {
            const Columns<float> read = file.columns<float>(name, a.rows(), a.cols());
            require(
                read.allFinite(), [&] { return who + ": " + name; },
                "has a number that is not finite");
            require(
                !name.starts_with("lin") || read.minCoeff() >= 0, [&] { return who + ": " + name; },
                "has a negative weight: ", read.minCoeff());
            a = read.cast<T>();
        },
        weights);
}

/// Reads the weights that cmake/convert_lpips_weights.py writes. Throws an Error as
/// load_lpips_weights does.
template <Real T>
LpipsWeights<T> read_lpips_weights(const std::filesystem::path& path) {
    LpipsWeights<T> weights;
    load_lpips_weights(read_safetensors(path), path.string(), weights);
    return weights;
}

} // namespace rye
