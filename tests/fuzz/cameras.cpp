// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/cameras.cpp: any text as a file of --cameras.
#include "fuzz.hpp"

#include "data/cameras_file.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    const std::string_view text(reinterpret_cast<const char*>(data), size);
    fuzz::attempt([&] {
        for (const trainer::Photograph& p : trainer::parse_cameras(text, fuzz::name))
            fuzz::demand(p.camera.width > 0 && std::isfinite(p.camera.fx) && p.camera.fx > 0 &&
                             p.camera.camera_from_world.rotation.allFinite() &&
                             p.camera.camera_from_world.translation.allFinite(),
                         "cameras are finite");
    });
    return 0;
}
