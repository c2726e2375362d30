// SPDX-License-Identifier: Apache-2.0
#include "commands/export_avatar.hpp"

#include <cstdio>

#include <rye/capture/avatar_file.hpp>

#include "commands/options.hpp"
#include "data/validate.hpp"
#include "training/playable.hpp"

namespace rye::trainer {

void export_avatar(const AvatarExportOptions& o) {
    const TrainState state = load_trained(o.run);
    const Capture capture =
        read_valid_capture(o.capture.empty() ? std::filesystem::path(state.capture) : o.capture);
    require_same_subject(state, capture);
    const int frame = frame_index(capture, o.frame);
    const PlayableAvatar<float> playable =
        playable_avatar(state, capture, frame, camera_index(capture, o.camera, frame));
    write_avatar(o.out, playable,
                 o.full_precision ? AvatarPrecision::full : AvatarPrecision::half);
    std::printf("%s: %td Gaussians, %.2f MB\n", o.out.c_str(),
                playable.avatar.face.position.cols() + playable.avatar.eyes.position.cols(),
                static_cast<double>(std::filesystem::file_size(o.out)) / 1e6);
}

} // namespace rye::trainer
