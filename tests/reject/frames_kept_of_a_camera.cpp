// SPDX-License-Identifier: Apache-2.0
// A cache compares drivers; what refraction moves, every camera moves.
// expect: KeptFromFrameToFrame
// lines: 34
#include <rye/interactive/drive_cache.hpp>
#include <rye/backend/scalar.hpp>

#if REJECT
using Mine = rye::More<rye::PaperEffects, rye::CornealRefraction>;
#else
using Mine = rye::PaperEffects;
#endif

void keep(const rye::TwoStream<float, Mine>& avatar, const rye::AvatarConfig& config,
          const rye::LandmarkRoles& roles) {
    const rye::DriveCache<rye::ScalarBackend<>, float, Mine> cache({}, avatar, config, roles);
}
