// SPDX-License-Identifier: Apache-2.0
// A cache compares drivers; what an effect of one's own reads is not known to it.
// expect: KeptFromFrameToFrame
// lines: 40
#include <rye/backend/scalar.hpp>
#include <rye/interactive/drive_cache.hpp>

#include "own_effect.hpp"

#if REJECT
using Mine = rye::More<rye::PaperEffects, Blush>;
#else
using Mine = rye::More<rye::PaperEffects, rye::CornealRefraction>;
#endif

void keep(const rye::TwoStream<float, Mine>& avatar, const rye::AvatarConfig& config,
          const rye::LandmarkRoles& roles) {
    const rye::DriveCache<rye::ScalarBackend<>, float, Mine> cache({}, avatar, config, roles);
}
