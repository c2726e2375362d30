// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/flame_params.cpp: any bytes as a flame_param file of VHAP.
#include "fuzz.hpp"

#include <cmath>

#include "importers/flame_params.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    fuzz::attempt([&] {
        const trainer::FlameParams p =
            trainer::parse_flame_params(fuzz::bytes_of(data, size), fuzz::name);
        for (const double x : p.expression) fuzz::demand(std::isfinite(x), "finite expressions");
        fuzz::demand(p.rotation.allFinite(), "a finite rotation");
        for (const Vec3<double>& gaze : p.gaze)
            fuzz::demand(std::abs(gaze.norm() - 1) < 1e-6, "unit gazes");
    });
    return 0;
}
