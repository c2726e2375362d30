// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/corrected_cameras.cpp: any text as the cameras.json of a run.
#include "fuzz.hpp"

#include "data/corrected_cameras.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    const std::string_view text(reinterpret_cast<const char*>(data), size);
    fuzz::attempt([&] {
        for (const trainer::CorrectedCamera& c :
             trainer::parse_corrected_cameras(text, fuzz::name))
            for (const Pinhole<double>& camera : {c.wrong, c.right})
                fuzz::demand(camera.fx > 0 && camera.fy > 0 &&
                                 camera.camera_from_world.rotation.allFinite() &&
                                 camera.camera_from_world.translation.allFinite(),
                             "a camera has finite numbers");
    });
    return 0;
}
