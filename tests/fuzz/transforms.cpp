// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/transforms.cpp: any text as the transforms.json of a folder of photographs.
#include "fuzz.hpp"

#include "data/photographs.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    const std::string_view text(reinterpret_cast<const char*>(data), size);
    fuzz::attempt([&] {
        for (const trainer::Photograph& p : trainer::parse_photographs(text, fuzz::name))
            fuzz::demand(p.camera.width > 0 && std::isfinite(p.camera.fx) &&
                             p.camera.camera_from_world.translation.allFinite(),
                         "cameras are finite");
    });
    return 0;
}
