// SPDX-License-Identifier: Apache-2.0
// The timed scene has the same bytes here as where the checksums were recorded.
#include <doctest/doctest.h>

#include "head_scene.hpp"

using namespace rye;
using namespace rye::bench;

TEST_CASE("scenes: the head's bytes are those of the recorded sums") {
    CHECK(checksum(head_scene(20000, 3, 8).gaussians) == 0x4d567e16cfe08301ULL);
    CHECK(checksum(head_scene(20000, 32, 8).gaussians) == 0x95a950f2202bb6d8ULL);
    CHECK(checksum(head_scene(100000, 3, 8).gaussians) == 0xa1f8bbf8ccb45769ULL);
    CHECK(checksum(head_scene(100000, 32, 8).gaussians) == 0xbb142166c27e51d9ULL);
}

TEST_CASE("scenes: a channel does not depend on how many there are") {
    const HeadScene few = head_scene(100, 3, 16), many = head_scene(100, 32, 16);
    CHECK(few.gaussians.feature == many.gaussians.feature.topRows(3));
    CHECK(few.cotangent == many.cotangent.topRows(3));
}
