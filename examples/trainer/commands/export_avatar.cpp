// SPDX-License-Identifier: Apache-2.0
#include "commands/export_avatar.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include <rye/io/avatar_file.hpp>
#include <rye/interactive/player.hpp>
#include <rye/rig/gaze.hpp>

#include "commands/lights_option.hpp"
#include "commands/options.hpp"
#include "drawing/playable.hpp"

namespace rye::trainer {
namespace {

/// Returns the smallest PSNR [dB] of the file's pictures against those of the exported avatar: at
/// the neutral drivers and with both eyes at each corner of their ranges, from the default camera.
double least_psnr(const PlayableAvatar<float>& exported, const PlayableAvatar<float>& read) {
    AvatarPlayer<TrainBackend> right(train_backend(), exported), got(train_backend(), read);
    double least = std::numeric_limits<double>::infinity();
    Drivers<float> d = exported.neutral;
    for (int corner = -1; corner < 4; ++corner) {
        if (corner >= 0)
            for (std::size_t eye = 0; eye < 2; ++eye) {
                const auto e = static_cast<Index>(eye);
                const Columns<float>& pitch =
                    corner % 2 == 0 ? exported.ranges.gaze_low : exported.ranges.gaze_high;
                const Columns<float>& yaw =
                    corner < 2 ? exported.ranges.gaze_low : exported.ranges.gaze_high;
                d.gaze[eye] = gaze_vector(pitch(0, e), yaw(1, e));
            }
        const Columns<float>& a = right.draw(d, exported.camera, exported.background).pixels;
        const Columns<float>& b = got.draw(d, exported.camera, exported.background).pixels;
        const double error = (a - b).cast<double>().squaredNorm() / static_cast<double>(a.size());
        least = std::min(least, -10 * std::log10(error));
    }
    return least;
}

} // namespace

void export_avatar(const AvatarExportOptions& o) {
    TrainState state = load_trained(o.run);
    relight(state, o.run, o.lights);
    const Capture capture = driving_capture(o.run, state, o.capture);
    const int frame = frame_index(capture, o.frame);
    PlayableAvatar<float> playable =
        playable_avatar(state, capture, frame, camera_index(capture, o.camera, frame));
    // The file's camera says how large training had the head in its pictures.
    const double share = share_of_trained(o.run, state, capture);
    if (share != 1) playable.camera = scaled(playable.camera, 1 / share);
    write_avatar(o.out, playable, o.full_precision ? AvatarPrecision::full : AvatarPrecision::half);
    const double psnr = least_psnr(playable, read_avatar<float>(o.out));
    char quality[80] = "its pictures are the run's, bit for bit";
    if (std::isfinite(psnr))
        std::snprintf(quality, sizeof quality, "its pictures are the run's to %.1f dB or more",
                      psnr);
    std::printf("%s: %td Gaussians, %.2f MB; %s\n", o.out.c_str(),
                playable.avatar.face.position.cols() + playable.avatar.eyes.position.cols(),
                static_cast<double>(std::filesystem::file_size(o.out)) / 1e6, quality);
}

} // namespace rye::trainer
