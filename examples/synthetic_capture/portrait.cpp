// SPDX-License-Identifier: Apache-2.0
// portrait FILE.png: the made-up head that cmake/quickstart.sh trains on, drawn in its first gaze
// from the front, 512 x 512. It is built in a minute, before the program rye.
#include <cmath>
#include <cstdio>

#include "data/picture.hpp"
#include "synthetic_capture/scene.hpp"

using namespace rye;
using namespace rye::trainer;

int main(int count, char** words) try {
    if (count != 2) {
        std::fprintf(stderr, "usage: portrait FILE.png\n");
        return 2;
    }
    const CaptureSettings settings{.size = 512};
    const HeadModel head = procedural_head(settings.seed);
    const CaptureScene scene = capture_scene(head, settings);
    const SceneCamera* front = &scene.cameras.front();
    for (const SceneCamera& c : scene.cameras)
        if (std::hypot(c.yaw_deg, c.pitch_deg) < std::hypot(front->yaw_deg, front->pitch_deg))
            front = &c;
    HeadPicture p =
        PosedHead(head, scene.frames.front().state).picture(front->camera, settings.samples);
    constexpr float grey = 0.85F;
    for (Index i = 0; i < p.image.pixels.cols(); ++i)
        p.image.pixels.col(i).array() += grey * (1 - p.mask.pixels(0, i));
    write_png(words[1], p.image);
    return 0;
} catch (const std::exception& e) {
    std::fprintf(stderr, "portrait: %s\n", e.what());
    return 1;
}
