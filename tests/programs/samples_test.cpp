// SPDX-License-Identifier: Apache-2.0
// Images whose sides a stage's factor does not divide: whole, with cameras that match them.
#include "data/samples.hpp"

#include <doctest/doctest.h>

#include "../support/hostile.hpp"
#include "data/picture.hpp"
#include "tiny_capture.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

/// An image with the pixel's position as colour: (x + 0.5, y + 0.5, 1).
Image<float> places(int width, int height) {
    Image<float> image(width, height, 3);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
            image.at(x, y) << static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f, 1;
    return image;
}

} // namespace

TEST_CASE("dataset: a picture is extended at its right and lower side alone, up to whole blocks") {
    for (const int factor : {1, 2, 3, 5, 8, 16})
        for (const auto& [w, h] : {std::pair(48, 31), std::pair(33, 48), std::pair(16, 17)}) {
            const Image<float> from = places(w, h);
            const Image<float> repeated = extended(from, factor);
            const Image<float> zero = extended(from, factor, Border::zero);
            CHECK(repeated.width == (w + factor - 1) / factor * factor);
            CHECK(repeated.height == (h + factor - 1) / factor * factor);
            bool right = true;
            for (int y = 0; y < repeated.height; ++y)
                for (int x = 0; x < repeated.width; ++x) {
                    const bool inside = x < w && y < h;
                    const auto edge = from.at(std::min(x, w - 1), std::min(y, h - 1));
                    right = right && repeated.at(x, y) == edge &&
                            zero.at(x, y) == (inside ? Eigen::Vector3f(edge)
                                                     : Eigen::Vector3f(Eigen::Vector3f::Zero()));
                }
            CHECK(right);
        }
}

TEST_CASE("dataset: blocks and the reduced camera agree: a point falls where its block is") {
    Pinhole<float> camera = TinyCapture::pinhole(0).cast<float>();
    camera.cx = 17.25f;
    camera.cy = 20.5f;
    for (const int factor : {1, 2, 3, 4, 7, 16})
        for (const auto& [w, h] : {std::pair(48, 48), std::pair(50, 47), std::pair(31, 65)}) {
            camera.width = w;
            camera.height = h;
            const Pinhole<float> small = reduced(camera, factor);
            const Image<float> blocks = shrunk(places(w, h), factor);
            CHECK(small.width == blocks.width);
            CHECK(small.height == blocks.height);
            const Vec3<float> x(0.2f, 0.1f, 0.9f);
            const Vec3<float> at = camera.project_point(x), there = small.project_point(x);
            CHECK(there.x() * static_cast<float>(factor) == doctest::Approx(at.x()).epsilon(1e-5));
            CHECK(there.y() * static_cast<float>(factor) == doctest::Approx(at.y()).epsilon(1e-5));
            CHECK(small.cx * static_cast<float>(factor) == doctest::Approx(camera.cx));
            CHECK(small.cy * static_cast<float>(factor) == doctest::Approx(camera.cy));
            // The middle of the first block is the mean of its pixels' positions.
            CHECK(blocks.at(0, 0)[0] == doctest::Approx(0.5 * factor));
            CHECK(blocks.at(0, 0)[1] == doctest::Approx(0.5 * factor));
        }
}

TEST_CASE("dataset: samples of both stages have whole blocks, and no loss beyond the picture") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    for (int f = 0; f < TinyCapture::frames; ++f)
        for (int c = 0; c < TinyCapture::cameras; ++c) // 45 x 43 of the 48 x 48 pixels
            for (const char* stem : {"image", "mask", "eye_mask"}) {
                const Image8 all =
                    read_image8(tiny.image(f, c, stem), std::string(stem) == "image" ? 3 : 1);
                Image8 part{45, 43, all.channels, {}};
                for (int y = 0; y < part.height; ++y)
                    for (int i = 0; i < part.width * part.channels; ++i)
                        part.values.push_back(
                            all.values[static_cast<std::size_t>(y * all.width * all.channels + i)]);
                write_png(tiny.image(f, c, stem), part);
            }
    const Capture capture = read_capture(folder.path);
    REQUIRE(capture.width == 45);
    TrainConfig config = preset("tiny");
    config.gaussians.upsampler.doublings = 3;
    config.mesh.image_size = 10; // blocks of 4
    const AvatarSample<float> s = avatar_sample(capture, config, 0, 1);
    CHECK(s.camera.width == 6);
    CHECK(s.camera.height == 6);
    CHECK(s.truth.width == 48);
    CHECK(s.truth.height == 48);
    CHECK(s.truth_small.width == 6);
    for (const Columns<float>* a : {&s.visible, &s.eyes}) CHECK(a->cols() == 48 * 48);
    for (const Columns<float>* a : {&s.visible_small, &s.eyes_small, &s.mask_small})
        CHECK(a->cols() == 36);
    CHECK(s.visible.sum() == 45 * 43);
    const Image<float> mask = capture.mask(0, 1);
    CHECK(s.truth.at(44, 42)[0] == doctest::Approx(capture.image(0, 1).at(44, 42)[0] + 1 -
                                                   mask.at(44, 42)[0]));
    const Subject subject = describe_subject(capture, config);
    const MeshSample<float> m = mesh_sample(capture, subject, config, 0, {1});
    CHECK(m.views[0].camera.width == 12);
    CHECK(m.views[0].camera.height == 11);
    CHECK(m.views[0].truth.width == 12);
    CHECK(m.views[0].visible.sum() == doctest::Approx(45.0 * 43 / 16));
}
