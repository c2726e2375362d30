// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/lpips.cpp: any bytes as LPIPS weights, of a network so narrow that an input can
/// hold it.
#include "fuzz.hpp"

#include <rye/io/lpips_weights.hpp>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    fuzz::attempt([&] {
        const Safetensors file = parse_safetensors(fuzz::unchecked(data, size), fuzz::name);
        LpipsWeights<float> weights(VggShape{3, {1, 2, 1, 1, 2}, {1, 1, 1, 1, 1}});
        load_lpips_weights(file, fuzz::name, weights);
        LpipsWeights<float>::fields(
            [](const std::string&, const Columns<float>& a) {
                fuzz::demand(a.allFinite(), "weights are finite");
            },
            weights);
    });
    return 0;
}
