// SPDX-License-Identifier: Apache-2.0
// lpips WEIGHTS IMAGES WIDTH HEIGHT RESULT: rye's half of lpips_torch.py. IMAGES holds "a" and "b",
// RESULT receives "value" and "gradient", all float64.
#include <cstdio>
#include <cstdlib>
#include <exception>

#include <rye/backend/scalar.hpp>
#include <rye/io/lpips_weights.hpp>

int main(int argc, char** argv) {
    using namespace rye;
    if (argc != 6)
        return std::fputs("usage: lpips WEIGHTS IMAGES WIDTH HEIGHT RESULT\n", stderr), 2;
    try {
        const Safetensors images = read_safetensors(argv[2]);
        const auto image = [&](const char* name) {
            Image<double> i(std::atoi(argv[3]), std::atoi(argv[4]), 3);
            i.pixels = images.columns<double>(name, 3, i.size());
            return i;
        };
        const LpipsVgg<double> lpips{read_lpips_weights<double>(argv[1])};
        const LossGradient<double> loss = lpips(ScalarBackend{}, image("a"), image("b"));
        const Columns<double> value = Columns<double>::Constant(1, 1, loss.value);
        write_safetensors(argv[5],
                          {tensor_entry("value", value), tensor_entry("gradient", loss.gradient)});
    } catch (const std::exception& e) {
        return std::fprintf(stderr, "%s\n", e.what()), 1;
    }
    return 0;
}
