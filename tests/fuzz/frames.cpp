// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/frames.cpp: any bytes as the frames.safetensors of a run.
#include "fuzz.hpp"

#include "data/run_frames.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    fuzz::attempt([&] {
        const trainer::Capture c = trainer::parse_frames(fuzz::unchecked(data, size), fuzz::name);
        for (const trainer::CaptureFrame& f : c.frames)
            fuzz::demand(f.has_gaze && f.scale > 0 && f.landmarks.allFinite() && f.pose.allFinite(),
                         "frames are finite");
        fuzz::demand(c.views.size() == c.frames.size() * c.camera_ids.size(), "a view each");
    });
    return 0;
}
