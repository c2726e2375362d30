// SPDX-License-Identifier: Apache-2.0
/// benchmarks/cuda/subject.hpp: avatars that trainings and pictures on a device are timed on, the
/// same everywhere: as many points and as wide networks as asked for, and nothing trained.
#pragma once

#include <algorithm>
#include <cmath>

#include <rye/avatar/two_stream.hpp>
#include <rye/rig/driven_features.hpp>

#include "scenes.hpp"

namespace rye::bench {

/// Networks, channels and super-resolution; numbers of points.
struct DeviceSubjectSizes {
    AvatarConfig config;
    UpsamplerShape upsampler;
    Index points = 100000, of_an_eye = 2048;
};

/// A face of points on a shell, with landmarks in front as many as a tracker gives.
template <EffectSet E>
struct DeviceSubject {
    AvatarConfig config;
    LandmarkRoles roles;
    TwoStream<float, E> avatar;
    Drivers<float, E> drivers;

    explicit DeviceSubject(const DeviceSubjectSizes& sizes) : config(sizes.config) {
        const Index points = sizes.points;
        const Random random(5);
        // Gaussians cover the shell however many there are.
        const DeviceScenery shell = head(points, config.channels, 512, 860, 1001,
                                         0.01 * std::sqrt(100000 / static_cast<double>(points)));
        const auto noise = [&](Index rows, Index cols, double size, std::uint64_t key) {
            Columns<float> x(rows, cols);
            const Random own = random.fork(key);
            for (Index i = 0; i < x.size(); ++i)
                x(i) =
                    static_cast<float>(size * (2 * own.uniform(static_cast<std::uint64_t>(i)) - 1));
            return x;
        };
        FaceStream<float, E>& f = avatar.face;
        f.position = shell.gaussians.mean;
        f.rotation = shell.gaussians.rotation;
        f.log_scale = shell.gaussians.scale.array().log();
        f.opacity_logit = noise(1, points, 2, 1);
        f.feature = noise(config.feature, points, 1, 2);
        f.networks = FaceNetworks<float, E>::init(config, random.fork(3));
        f.exp_attributes = Mlp<float>::init(
            mlp_shape(config.feature, config.expression, config.networks.exp_attributes, 8),
            random.fork(4));
        f.pose_attributes = Mlp<float>::init(
            mlp_shape(config.feature, config.pose_code(), config.networks.pose_attributes, 8),
            random.fork(5));
        // Landmarks on the front: 6 around each eye, the others over the face.
        f.landmarks = noise(3, 66, 1, 6);
        for (Index k = 0; k < 66; ++k) {
            const bool eye = k >= 36 && k < 48;
            float x = 0.6F * f.landmarks(0, k), y = 0.7F * f.landmarks(1, k);
            if (eye) {
                x = (k < 42 ? -0.3F : 0.3F) + 0.12F * f.landmarks(0, k);
                y = 0.25F + 0.05F * f.landmarks(1, k);
            }
            f.landmarks.col(k) << x, y, 0.92F * std::sqrt(1 - std::min(0.9F, x * x + y * y));
            (eye ? roles.eye[k < 42 ? 1U : 0U] : roles.expression).push_back(k);
        }
        EyeStream<float, E>& e = avatar.eyes;
        const Index all = 2 * sizes.of_an_eye;
        e.feature = noise(config.channels, all, 1, 7);
        if constexpr (std::same_as<EyeAppearanceOf<E>, DrivenFeatures>)
            e.networks = init_eye_appearance<DrivenFeatures, float>(
                             appearance_sizes<E>(config, all), random.fork(15))
                             .networks;
        e.log_scale = noise(3, all, 0.3, 8).array() - 5.0F;
        e.rotation = noise(4, all, 1, 9);
        e.opacity_logit = noise(1, all, 2, 10);
        e.offset = EyeOffsetNetwork<float>::init(config, random.fork(11));
        e.position = noise(3, all, 1, 12).colwise().normalized() * 0.12F;
        e.spacing = Columns<float>::Constant(1, all, 0.01F);
        e.centre.resize(3, 2);
        e.centre << 0.3F, -0.3F, 0.25F, 0.25F, 0.8F, 0.8F;
        avatar.delta_pose = Columns<float>::Zero(6, 1);
        if constexpr (has_effect<E, HeadShading>)
            avatar.shading =
                initial_shading<float>(Columns<float>(f.position.colwise().normalized()));
        UpsamplerShape shape = sizes.upsampler;
        shape.in_channels = config.channels;
        avatar.upsampler = Upsampler<float>::init(shape, random.fork(14));
        drivers.expression = noise(config.expression, 1, 0.5, 13);
        drivers.pose << 0.1F, -0.1F, 0.05F, 0.02F, 0.0F, 0.01F;
        drivers.gaze = {Vec3<float>(0.2F, 0.1F, 0.97F), Vec3<float>(0.15F, 0.1F, 0.98F)};
    }
};

} // namespace rye::bench
