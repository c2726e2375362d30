// SPDX-License-Identifier: Apache-2.0
// Lesson 11: your avatar in your program. Reads a file of `rye export --run RUN --out NAME.avatar`,
// turns the eyes, looks from the side, and writes that picture:
//     lesson_11_draw_my_avatar NAME.avatar picture.ppm
#include <algorithm>
#include <cstdio>

#include <rye/avatar/gaze_at.hpp>
#include <rye/backend/lanes.hpp>
#include <rye/io/avatar_file.hpp>
#include <rye/interactive/player.hpp>
#include <rye/splat/lanes.hpp>

using namespace rye;

namespace {

bool write_ppm(const char* path, const Image<float>& picture) {
    std::FILE* const file = std::fopen(path, "wb");
    if (file == nullptr) return false;
    std::fprintf(file, "P6\n%d %d\n255\n", picture.width, picture.height);
    for (Index i = 0; i < picture.pixels.size(); ++i)
        std::fputc(static_cast<int>(255 * std::clamp(picture.pixels(i), 0.0f, 1.0f) + 0.5f), file);
    return std::fclose(file) == 0;
}

} // namespace

int main(int count, char** words) try {
    if (count != 3) {
        std::fprintf(stderr, "expected two arguments: NAME.avatar picture.ppm\n");
        return 2;
    }
    const PlayableAvatar<float> head = read_avatar<float>(words[1]);
    const XsimdBackend<> backend;
    AvatarPlayer player(backend, head); // keeps what the next picture needs again

    Drivers<float> drivers = head.neutral; // expression, head pose, a unit gaze for each eye
    const Image<float> before = player.draw(drivers, head.camera, head.background);
    for (Vec3<float>& gaze : drivers.gaze) gaze = gaze_vector(0.1f, 0.35f); // pitch, yaw [rad]
    const Image<float> after = player.draw(drivers, head.camera, head.background);
    std::printf("%d x %d pixels; the gaze moved %td Gaussians and redrew %td pixels\n", after.width,
                after.height, player.work().gaussians, player.work().pixels);

    // By a camera of one's own, to the left of the face, wherever the head is.
    const HeadPlacement<float> at = head_placement(drivers);
    const auto side = look_at<float>(at.apply({4, 0, 12}), at.apply({0, 0, 0}), {0, 1, 0}, 0.35f,
                                     {after.width, after.height});
    const Image<float>& aside = player.draw(drivers, side, head.background);

    if (!write_ppm(words[2], aside)) return std::perror(words[2]), 1;
    return (after.pixels - before.pixels).cwiseAbs().maxCoeff() > 0 ? 0 : 1;
} catch (const Error& e) { // names file, field and value
    std::fprintf(stderr, "%s\n", e.what());
    return 1;
}
