// SPDX-License-Identifier: Apache-2.0
#include "commands/film.hpp"

#include <cmath>
#include <memory>

#include "data/auto_exposure.hpp"
#include "data/film_encoder.hpp"
#include "data/moving_picture.hpp"
#include "data/picture.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

/// Colour of the wall behind the head, from above to below.
constexpr double wall_above[3] = {158, 163, 168}, wall_below[3] = {104, 102, 98};

/// Puts a picture that is black outside its mask in front of the wall.
void put_before_wall(Image8& picture, const Image8& mask) {
    for (std::size_t i = 0; i < mask.values.size(); ++i) {
        const auto row = static_cast<double>(i / static_cast<std::size_t>(mask.width));
        const double down = row / mask.height, open = 1 - mask.values[i] / 255.0;
        for (std::size_t c = 0; c < 3; ++c) {
            const double wall = std::lerp(wall_above[c], wall_below[c], down);
            const double sum = picture.values[3 * i + c] + open * wall;
            picture.values[3 * i + c] = static_cast<std::uint8_t>(std::lround(std::min(sum, 255.0)));
        }
    }
}

} // namespace

void check_film(const fs::path& file) {
    if (extension_of(file) != ".y4m") require_ffmpeg(file);
}

void write_film(const fs::path& capture, const CaptureScene& scene, const FilmSettings& settings,
                const fs::path& file) {
    check_film(file);
    const bool plain = extension_of(file) == ".y4m";
    fs::path pictures = file;
    if (!plain) pictures += ".y4m";
    {
        const std::unique_ptr<MovingPicture> video =
            moving_picture(pictures, OutFormat::y4m, {settings.rate, 1},
                           static_cast<int>(scene.frames.size()));
        const std::string camera = scene.cameras.front().id;
        AutoExposure exposure(settings.rate);
        for (const SceneFrame& f : scene.frames) {
            const fs::path images = capture / "images" / f.id;
            Image8 picture = read_image8(images / ("image_" + camera +
                                                   (scene.settings.png ? ".png" : ".jpg")), 3);
            put_before_wall(picture, read_image8(images / ("mask_" + camera + ".png"), 1));
            if (settings.auto_exposure) exposure.expose(picture);
            video->add(picture);
        }
        video->finish();
    }
    if (!plain) encode_film(pictures, file);
}

} // namespace rye::trainer
