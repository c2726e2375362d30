// SPDX-License-Identifier: Apache-2.0
#include "data/samples.hpp"

#include <rye/avatar/playable.hpp>

namespace rye::trainer {

Subject describe_subject(const Capture& capture, const TrainConfig& config) {
    return rye::describe_subject(
        capture, EyeSource{config.measured_eyes, config.gaussians.eyeball.radius});
}

Pinhole<float> reduced(const Pinhole<float>& camera, int factor) {
    return render_camera(camera, factor);
}

AvatarSample<float> avatar_sample(const Capture& capture, const TrainConfig& config, int frame,
                                  int camera) {
    const AvatarSampleShape shape{config.gaussians.upsampler.doublings, config.avatar.channels,
                                  config.gaze_axis};
    return rye::avatar_sample(capture, shape, {frame, camera});
}

MeshSample<float> mesh_sample(const Capture& capture, const Subject& subject,
                              const TrainConfig& config, int frame,
                              const std::vector<int>& cameras) {
    return rye::mesh_sample(capture, subject,
                            {frame, cameras, config.mesh.image_size, config.gaze_axis});
}

} // namespace rye::trainer
