// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/drivers.cpp: any text as a table of --driving; what is read survives writing.
#include "fuzz.hpp"

#include "data/driver_table.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    const std::string_view text(reinterpret_cast<const char*>(data), size);
    fuzz::attempt([&] {
        const trainer::DriverNames names{2, {"smile", "blink"}};
        Drivers<float> rest;
        rest.expression.setZero(2);
        rest.pose.setZero();
        rest.gaze = {Vec3<float>(0, 0, 1), Vec3<float>(0, 0, 1)};
        const auto frames = trainer::parse_drivers(text, fuzz::name, names, rest);
        const std::vector<std::string> ids(frames.size(), "a");
        const std::string written = trainer::text_of_drivers(frames, ids);
        const auto again = trainer::parse_drivers(written, fuzz::name, names, rest);
        fuzz::demand(again.size() == frames.size(), "as many frames");
        for (std::size_t f = 0; f < frames.size(); ++f)
            fuzz::demand(frames[f].expression == again[f].expression &&
                             frames[f].pose == again[f].pose && frames[f].scale == again[f].scale &&
                             (frames[f].gaze[0] - again[f].gaze[0]).norm() < 1e-6f,
                         "they come back");
    });
    return 0;
}
