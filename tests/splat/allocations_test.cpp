// SPDX-License-Identifier: Apache-2.0
// With warmed-up memory a render and its vjp allocate nothing.
#include <rye/splat/lanes.hpp>

#include <cstdlib>
#include <new>

#include <doctest/doctest.h>

#include "../support/scenes.hpp"

namespace {

std::size_t allocations = 0;

void* counted(std::size_t size, std::size_t alignment) {
    ++allocations;
    void* p = nullptr;
    if (posix_memalign(&p, std::max(alignment, sizeof(void*)), size) != 0) throw std::bad_alloc();
    return p;
}

} // namespace

void* operator new(std::size_t n) { return counted(n, 0); }
void* operator new[](std::size_t n) { return counted(n, 0); }
// Used by the library's stable sort.
void* operator new(std::size_t n, const std::nothrow_t&) noexcept {
    try {
        return counted(n, 0);
    } catch (const std::bad_alloc&) {
        return nullptr;
    }
}
void* operator new(std::size_t n, std::align_val_t a) { return counted(n, std::size_t(a)); }
void* operator new[](std::size_t n, std::align_val_t a) { return counted(n, std::size_t(a)); }
void operator delete(void* p) noexcept { std::free(p); }
void operator delete[](void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }
void operator delete[](void* p, std::size_t) noexcept { std::free(p); }
void operator delete(void* p, const std::nothrow_t&) noexcept { std::free(p); }
void operator delete(void* p, std::align_val_t) noexcept { std::free(p); }
void operator delete[](void* p, std::align_val_t) noexcept { std::free(p); }
void operator delete(void* p, std::size_t, std::align_val_t) noexcept { std::free(p); }
void operator delete[](void* p, std::size_t, std::align_val_t) noexcept { std::free(p); }

using namespace rye;
using namespace rye::test;

TEST_CASE("rasterizer: a step whose memory is there allocates nothing") {
    for (const Index channels : {3, 16}) {
        const Scenery<float> s = random_scene<float>(300, channels, 5);
        const Rasterizer<> rasterizer;
        Raster<float> raster;
        RasterScratch<float> scratch;
        Gaussians<float> gradient;
        const Columns<float> cotangent = noise<float>(channels, 37 * 29, 21);
        std::size_t last = 0;
        for (int step = 0; step < 3; ++step) {
            const std::size_t before = allocations;
            rasterizer.forward_into(XsimdBackend<DefaultArch, Serial>{}, s.gaussians, s.camera,
                                    s.background, raster, &scratch);
            rasterizer.vjp_into(XsimdBackend<DefaultArch, Serial>{}, s.gaussians, s.camera,
                                s.background, raster, RasterCotangent<float>{cotangent}, gradient,
                                &scratch);
            last = allocations - before;
            if (step == 0) CHECK(last > 0);
        }
        CHECK(last == 0);
    }
}
