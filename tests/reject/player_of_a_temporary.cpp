// SPDX-License-Identifier: Apache-2.0
// A player keeps where its avatar is.
// expect: deleted
#include <utility>

#include <rye/backend/scalar.hpp>
#include <rye/interactive/player.hpp>

void play(rye::PlayableAvatar<float>& avatar) {
#if REJECT
    rye::AvatarPlayer<rye::ScalarBackend<>> player({}, std::move(avatar));
#else
    rye::AvatarPlayer<rye::ScalarBackend<>> player({}, avatar);
#endif
    (void)player;
}
