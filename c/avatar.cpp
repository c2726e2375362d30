// SPDX-License-Identifier: Apache-2.0
/// c/avatar.cpp: avatar files, drawn by drivers, as rye/c/rye.h has them.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <rye/avatar/gaze_at.hpp>
#include <rye/avatar/idle_head.hpp>
#include <rye/io/avatar_file.hpp>
#include <rye/interactive/player.hpp>
#include <rye/rig/gaze.hpp>

#include "objects.hpp"

using namespace rye;
using namespace rye::c;

constexpr double idle_seconds = 3600;

struct rye_avatar {
    ObjectThreads pool;
    PlayableAvatar<float> playable;
    AvatarPlayer<LibraryBackend> player;
    HeadPlace<float> place;
    std::vector<const char*> names;
    std::vector<const float*> convolution;
    std::optional<IdleEyes> idle;
    std::uint64_t idle_seed = 0;
    bool driven = false;

    rye_avatar(const rye_options& o, PlayableAvatar<float> p)
        : pool(o.threads),
          playable(std::move(p)),
          player(LibraryBackend{pool.threads()}, playable),
          place(head_place(playable)) {
        for (const std::string& name : playable.expression_names) names.push_back(name.c_str());
        for (const Columns<float>& w : playable.avatar.upsampler.conv)
            convolution.push_back(w.data());
    }
    rye_avatar(const rye_avatar&) = delete;
    rye_avatar& operator=(const rye_avatar&) = delete;
};

namespace {

/// f(), whose Errors are faults of a file.
template <class F>
auto of_file(F&& f) {
    try {
        return f();
    } catch (const Error& e) {
        throw Failure(RYE_ERROR_FILE, e.what());
    }
}

Drivers<float> drivers_of(const rye_avatar& avatar, const rye_drivers* d) {
    check_struct(d, "drivers");
    const int width = avatar.playable.config.expression;
    require(d->expression_count == width, "drivers: expression_count", "got ", d->expression_count,
            ", expected ", width);
    if (width > 0) check_pointer(d->expression, "drivers: expression");
    Drivers<float> drivers;
    drivers.expression = VecX<float>::Zero(width);
    if (width > 0) drivers.expression = Eigen::Map<const VecX<float>>(d->expression, width);
    for (std::size_t eye = 0; eye < 2; ++eye) {
        check_finite(d->gaze[eye], 2,
                     eye == 0 ? "drivers: gaze of the left eye" : "drivers: gaze of the right eye");
        for (const float angle : d->gaze[eye])
            require(std::abs(angle) <= 1.57F, "drivers: gaze", "got ", angle,
                    " rad, expected at most 1.57 either way");
        drivers.gaze[eye] = gaze_vector<float>(d->gaze[eye][0], d->gaze[eye][1]);
    }
    drivers.pose = Eigen::Map<const Vec<float, 6>>(d->pose);
    drivers.scale = d->scale;
    return drivers;
}

/// As `rye` writes PNG: clamped, to the nearest of 256 levels; opaque.
void to_bytes(const Image<float>& image, std::uint8_t* to) {
    const float* from = image.pixels.data();
    const auto level = [](float x) {
        const float clamped = x > 0.0F ? (x < 1.0F ? x : 1.0F) : 0.0F;
        return static_cast<std::uint8_t>(static_cast<int>(clamped * 255.0F + 0.5F));
    };
    for (Index i = 0; i < image.size(); ++i, from += 3, to += 4) {
        to[0] = level(from[0]);
        to[1] = level(from[1]);
        to[2] = level(from[2]);
        to[3] = 255;
    }
}

void set_pair(const Columns<float>& from, float (&to)[2][2]) {
    for (Index eye = 0; eye < 2; ++eye)
        for (Index angle = 0; angle < 2; ++angle) to[eye][angle] = from(angle, eye);
}

void check_driven(const rye_avatar& avatar) {
    if (!avatar.driven)
        throw Failure(
            RYE_ERROR_STATE,
            "rye_avatar_draw has drawn no picture, nor rye_avatar_drive moved a Gaussian");
}

} // namespace

extern "C" {

rye_status rye_avatar_open(const char* path, const rye_options* options, rye_avatar** avatar) {
    return guarded([&] {
        check_pointer(path, "path");
        check_pointer(avatar, "avatar");
        const rye_options o = checked_options(options);
        *avatar = new rye_avatar(o, of_file([&] { return read_avatar<float>(path); }));
    });
}

rye_status rye_avatar_open_memory(const char* name, const void* bytes, size_t size,
                                  const rye_options* options, rye_avatar** avatar) {
    return guarded([&] {
        check_pointer(name, "name");
        check_pointer(bytes, "bytes");
        check_pointer(avatar, "avatar");
        const rye_options o = checked_options(options);
        const ByteSpan span(static_cast<const std::byte*>(bytes), size);
        *avatar = new rye_avatar(o, of_file([&] { return parse_avatar<float>(span, name); }));
    });
}

void rye_avatar_close(rye_avatar* avatar) { delete avatar; }

rye_status rye_avatar_describe(const rye_avatar* avatar, rye_avatar_info* info) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        check_struct(info, "info");
        const PlayableAvatar<float>& p = avatar->playable;
        info->expression_count = p.config.expression;
        info->channels = p.config.channels;
        info->visual_axes = p.visual_axes() ? 1 : 0;
        info->gaussians = p.avatar.face.position.cols() + p.avatar.eyes.position.cols();
        info->name = p.name.c_str();
        info->background = p.background.data();
        info->expression_low = p.ranges.expression_low.data();
        info->expression_high = p.ranges.expression_high.data();
        info->expression_names = avatar->names.empty() ? nullptr : avatar->names.data();
        set_pair(p.ranges.gaze_low, info->gaze_low);
        set_pair(p.ranges.gaze_high, info->gaze_high);
        for (Index eye = 0; eye < 2; ++eye)
            std::copy_n(p.avatar.eyes.centre.col(eye).data(), 3, info->eye[eye]);
        std::copy_n(avatar->place.middle.data(), 3, info->head);
        info->radius = avatar->place.radius;
    });
}

rye_status rye_avatar_neutral(const rye_avatar* avatar, rye_drivers* drivers, rye_camera* camera) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        check_struct(drivers, "drivers");
        check_struct(camera, "camera");
        const Drivers<float>& d = avatar->playable.neutral;
        drivers->expression_count = static_cast<std::int32_t>(d.expression.size());
        drivers->expression = d.expression.data();
        for (std::size_t eye = 0; eye < 2; ++eye) {
            const Vec2<float> angles = pitch_yaw(d.gaze[eye]);
            std::copy_n(angles.data(), 2, drivers->gaze[eye]);
        }
        std::copy_n(d.pose.data(), 6, drivers->pose);
        drivers->scale = d.scale;
        set_camera(avatar->playable.camera, *camera);
    });
}

rye_status rye_avatar_gaze_at(rye_avatar* avatar, rye_drivers* drivers, const float point[3],
                              float range, float* missed) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        check_pointer(point, "point");
        check_finite(point, 3, "point");
        require(range > 0 && range <= 1.22F, "range", "got ", range,
                " rad, expected above 0 to 1.22");
        const Drivers<float> d = drivers_of(*avatar, drivers);
        const PlayableAvatar<float>& p = avatar->playable;
        check_drivers("drivers", p.config, d);
        const EyeStream<float, TrainedEffects>& eyes = p.avatar.eyes;
        const std::array<Vec3<float>, 2> centre =
            driven_eye_centres(LibraryBackend{avatar->pool.threads()}, eyes, p.config, d);
        const GazeTarget<float> target = target_in_head(
            head_placement(d), GazeTarget<float>{Vec3<float>(point[0], point[1], point[2])});
        for (std::size_t eye = 0; eye < 2; ++eye) {
            const auto e = static_cast<Index>(eye);
            const float radius =
                std::sqrt(eyes.position.middleCols(eyes.first_point(e), eyes.points_of(e))
                              .colwise()
                              .squaredNorm()
                              .maxCoeff());
            require(norm(toward(centre[eye], target)) > target.weight * radius, "point",
                    "lies inside the ", (eye == 0 ? "left" : "right"),
                    " eye, expected one outside of the eyes");
        }
        const AimedEyes<float> aimed = aim_eyes(centre, target, kappas_of(eyes), range);
        for (std::size_t eye = 0; eye < 2; ++eye) {
            const Vec2<float> angles = pitch_yaw(aimed[eye].visual);
            std::copy_n(angles.data(), 2, drivers->gaze[eye]);
            if (missed != nullptr) missed[eye] = aimed[eye].missed;
        }
    });
}

rye_status rye_avatar_idle(rye_avatar* avatar, rye_drivers* drivers, float* expression,
                           std::uint64_t seed, double seconds, float range) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        require(range > 0 && range <= 1.22F, "range", "got ", range,
                " rad, expected above 0 to 1.22");
        require(seconds >= 0 && seconds <= idle_seconds, "seconds", "got ", seconds,
                ", expected 0 to ", idle_seconds);
        Drivers<float> d = drivers_of(*avatar, drivers);
        const PlayableAvatar<float>& p = avatar->playable;
        check_drivers("drivers", p.config, d);
        if (!avatar->idle || avatar->idle_seed != seed) {
            avatar->idle.emplace(IdleSettings{}, seed, idle_seconds);
            avatar->idle_seed = seed;
        }
        LidCoefficients<float> lids;
        if (expression != nullptr)
            lids = lid_coefficients(p.expression_names, p.ranges.expression_high);
        add_idle(avatar->idle->at(seconds), lids, static_cast<double>(range), d);
        for (std::size_t eye = 0; eye < 2; ++eye) {
            const Vec2<float> angles = pitch_yaw(d.gaze[eye]);
            std::copy_n(angles.data(), 2, drivers->gaze[eye]);
        }
        if (expression == nullptr) return;
        std::copy_n(d.expression.data(), d.expression.size(), expression);
        drivers->expression = expression;
    });
}

rye_status rye_avatar_draw(rye_avatar* avatar, const rye_drivers* drivers, const rye_camera* camera,
                           const float* background, rye_picture* picture) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        check_struct(picture, "picture");
        const Drivers<float> d = drivers_of(*avatar, drivers);
        const PlayableAvatar<float>& p = avatar->playable;
        VecX<float> behind = p.background;
        if (background != nullptr)
            behind = Eigen::Map<const VecX<float>>(background, p.config.channels);
        avatar->driven = false; // until the picture is complete
        const Image<float>& image = avatar->player.draw(d, camera_of(camera), behind);
        if (picture->rgb != nullptr)
            std::copy_n(image.pixels.data(), image.pixels.size(), picture->rgb);
        if (picture->rgba != nullptr) to_bytes(image, picture->rgba);
        avatar->driven = true;
    });
}

rye_status rye_avatar_last_work(const rye_avatar* avatar, rye_avatar_work* work) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        check_struct(work, "work");
        check_driven(*avatar);
        const PlayedWork& w = avatar->player.work();
        work->networks = static_cast<std::int32_t>(w.networks);
        work->gaussians = w.gaussians;
        work->tiles = w.tiles;
        work->pixels = w.pixels;
    });
}

rye_status rye_avatar_gaussians(const rye_avatar* avatar, rye_cloud* cloud) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        check_struct(cloud, "cloud");
        check_driven(*avatar);
        const Gaussians<float>& g = avatar->player.gaussians();
        cloud->channels = static_cast<std::int32_t>(g.channels());
        cloud->count = g.count();
        cloud->mean = g.mean.data();
        cloud->rotation = g.rotation.data();
        cloud->scale = g.scale.data();
        cloud->opacity = g.opacity.data();
        cloud->feature = g.feature.data();
    });
}

rye_status rye_avatar_pupils(rye_avatar* avatar, const float ratio[2]) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        check_pointer(ratio, "ratio");
        avatar->player.set_pupils({ratio[0], ratio[1]});
    });
}

rye_status rye_avatar_drive(rye_avatar* avatar, const rye_drivers* drivers,
                            const rye_camera* camera) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        const Drivers<float> d = drivers_of(*avatar, drivers);
        avatar->driven = false; // until all Gaussians are where they belong
        avatar->player.drive(d, camera_of(camera));
        avatar->driven = true;
    });
}

rye_status rye_avatar_dilation(const rye_avatar* avatar, float* dilation) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        check_pointer(dilation, "dilation");
        check_driven(*avatar);
        *dilation = static_cast<float>(avatar->player.dilation());
    });
}

rye_status rye_avatar_upsampler(const rye_avatar* avatar, rye_upsampler* upsampler) {
    return guarded([&] {
        check_pointer(avatar, "avatar");
        check_struct(upsampler, "upsampler");
        const Upsampler<float>& u = avatar->playable.avatar.upsampler;
        upsampler->channels = u.shape.in_channels;
        upsampler->capacity = u.shape.capacity;
        upsampler->doublings = u.shape.doublings;
        upsampler->normalized = u.shape.norm == Normalization::instance ? 1 : 0;
        upsampler->skip = u.shape.skip ? 1 : 0;
        upsampler->convolution = avatar->convolution.data();
        upsampler->out_weight = u.out_weight.data();
        upsampler->out_bias = u.out_bias.data();
    });
}

} // extern "C"
