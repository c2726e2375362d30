// SPDX-License-Identifier: Apache-2.0
// An avatar is driven by what its own effects read.
// expect: (invalid initialization|cannot convert initializer list).*AvatarFrame
#include <rye/avatar/two_stream.hpp>
#include <rye/backend/scalar.hpp>

using Mine = rye::Less<rye::PaperEffects, rye::Expression>;
#if REJECT
using Driven = rye::PaperEffects;
#else
using Driven = Mine;
#endif

void show(const rye::TwoStream<float, Mine>& avatar, const rye::AvatarConfig& config,
          const rye::LandmarkRoles& roles, const rye::Drivers<float, Driven>& drivers,
          rye::TwoStreamTrace<float, Mine>& trace) {
    rye::drive(rye::ScalarBackend<>{}, avatar, {config, roles, drivers}, trace);
}
