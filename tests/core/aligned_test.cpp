// SPDX-License-Identifier: Apache-2.0
#include <rye/core/aligned.hpp>

#include <cstdint>

#include <doctest/doctest.h>

using namespace rye;

TEST_CASE("an aligned array begins a line of the cache, keeps what it is told to and never shrinks") {
    AlignedArray<float> a;
    CHECK(a.data() == nullptr);
    for (const Index n : {0, 1, 7, 16, 1000}) {
        const auto at = reinterpret_cast<std::uintptr_t>(a.reserve(n));
        CHECK(at % AlignedArray<float>::alignment == 0);
    }
    float* const first = a.data();
    CHECK(a.reserve(10) == first);
    CHECK(a.grow(1000, 1000) == first);
    for (Index i = 0; i < 1000; ++i) first[i] = static_cast<float>(i);
    const float* const larger = a.grow(100000, 1000);
    CHECK(larger == a.data());
    bool same = true;
    for (Index i = 0; i < 1000; ++i) same = same && larger[i] == static_cast<float>(i);
    CHECK(same);
    CHECK(AlignedArray<float>(a).data() == nullptr);
    CHECK(a.data() == larger);
}
