// SPDX-License-Identifier: Apache-2.0
// A metric of the influence that has a value but no slope could not be trained through.
// expect: InfluenceMetric
#include <rye/rig/influence.hpp>

struct Sharp {
    float value(const rye::Ramp<float>& ramp, float squared) const {
        return squared < ramp.near ? 1.0f : 0.0f;
    }
#if !REJECT
    float slope(const rye::Ramp<float>&, float) const { return 0.0f; }
#endif
};

float weight(const rye::Ramp<float>& ramp) { return rye::influence(Sharp{}, ramp, 0.1f); }
