// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/safetensors.cpp: any bytes as a file of tensors, each read by its type and shape.
#include "fuzz.hpp"

#include <rye/io/safetensors.hpp>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    fuzz::attempt([&] {
        const Safetensors file = parse_safetensors(fuzz::unchecked(data, size), fuzz::name);
        std::size_t held = 0;
        for (const auto& item : file.tensors()) {
            const std::string& key = item.first;
            const TensorEntry& tensor = item.second;
            held += tensor.bytes.size();
            fuzz::attempt([&] { file.columns<float>(key); });
            fuzz::attempt([&] { file.columns<double>(key); });
            fuzz::attempt([&] { file.values<std::int64_t>(key, tensor.shape); });
            fuzz::attempt([&] { file.values<std::uint8_t>(key, tensor.shape); });
            fuzz::attempt([&] { file.values<std::uint32_t>(key, tensor.shape); });
        }
        fuzz::demand(held <= size, "tensors have bytes of their own");
    });
    return 0;
}
