// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/eye_highlights.hpp: highlights of the eyes in device memory, by the formulas of
/// avatar/eye_lights.hpp: lights as the frame's camera sees them in both corneas, what they add to
/// the colours of the eyeballs' Gaussians, and back to the lights and to what places the eyes.
/// An avatar without lights launches nothing.
#pragma once

#include <rye/avatar/cuda/frame.hpp>
#include <rye/avatar/eye_optics.hpp>
#include <rye/avatar/eye_points.hpp>

namespace rye {

namespace detail {

/// Both eyes' points in device memory, the left eye's first.
struct DeviceEyePoints {
    const float* position; ///< in the eyeball's frame, 3 x P
    Index count, left;     ///< P, and how many of them are the left eye's
    const float* seen;     ///< as the camera sees them through the corneas, 3 x P
    float* g_seen;         ///< their cotangents, added to; null if the corneas do not refract
};

/// Adds the cotangents of an eye's transform to the sums over the eye's points, `to`.
template <EffectSet E, int eye>
RYE_DEVICE void add_into_eye_sums(const IntoEye<float>& into, const DeviceFrameState& frame,
                                  float* to) {
    using Places = EyeSums<E, eye>;
    Vec3<float> translation(0.0F, 0.0F, 0.0F);
    if constexpr (has_effect<E, HeadPose>) translation = frame.head.translation;
    const PlacedEyeCotangent<float> g = placed_eye_vjp<float>(into, frame.eye[eye], translation);
    if constexpr (has_effect<E, HeadPose>) {
        HeadTransformGradient<float> head;
        head.rotation = g.head_rotation;
        head.translation = g.head_translation;
        add_head_sums(head, to, Places::head_at);
    }
    if constexpr (Places::turn) {
        TurnCotangent<float> turn;
        turn.rotation = g.turn;
        add_turn_sums(turn, to, Places::turn_at);
    }
    if constexpr (has_effect<E, EyeOffset>)
        for (int k = 0; k < 3; ++k) to[Places::centre_at + k] += g.centre[k];
}

/// Sets the lights as the camera sees them in each eye, the left eye's first.
struct SeeLightsKernel {
    static constexpr const char* name = "lights in the corneas";
    static constexpr int threads = 2 * int(most_lights), blocks = 1;
    struct Shared {};
    LightArrays<float> lights;
    const float* camera; ///< in the world, 3
    const DeviceFrameState* frame;
    SeenLight<float>* seen; ///< 2 x count

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (t >= 2 * int(lights.count)) return;
            const int eye = t / int(lights.count);
            seen[t] = see_light<float>(lights, eye, t % int(lights.count), frame->eye[eye],
                                       column3(camera, 0));
        });
    }
};

/// Adds the highlights to point i of both eyes.
struct HighlightBothEyes {
    static constexpr const char* name = LightEyePoint<float>::name;
    LightEyePoint<float> point; ///< of the left eye
    Index left;                 ///< number of its points

    RYE_DEVICE void operator()(Index i) const {
        LightEyePoint<float> own = point;
        if (i >= left) {
            own.lights += own.count;
            own.points.cornea += cornea_numbers;
        }
        own(i);
    }
};

/// Numbers that the sums of a light in an eye are apart.
inline constexpr int light_room = 16;

} // namespace detail

static_assert(detail::LightEyePointVjp<float>::sums <= detail::light_room);

namespace detail {

/// Cotangents that a light in an eye leads to: of the eye's transform, and of the light's place.
struct DeviceLightGradient {
    IntoEye<float> eye;
    Vec3<float> light; ///< in the world
};

/// Adds the gradients of the lights, and what the lights and the camera, taken into the eyes, add
/// to the sums over the eyes' points.
template <EffectSet E>
struct HighlightsVjpKernel {
    static constexpr const char* name = "lights in the corneas, reverse";
    static constexpr int threads = 2 * int(most_lights), blocks = 1;
    struct Shared {};
    LightArrays<float> lights;
    const float* camera;
    const DeviceFrameState* frame;
    const SeenLight<float>* seen;
    const float* sums;          ///< of each light in each eye, light_room apart
    DeviceLightGradient* apart; ///< 2 x count
    float* eye_sums;            ///< of each eye, EyeSums::room apart, added to
    float* g_position;          ///< 3 x count, added to
    float* g_intensity;         ///< light_channels x count, added to

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        const int count = int(lights.count);
        block.each_thread([&](int t) {
            if (t < 2 * count) of_light(t, t / count, t % count);
        });
        block.each_thread([&](int t) {
            if (t < count) {
                const Vec3<float> a = apart[t].light, b = apart[count + t].light;
                for (int k = 0; k < 3; ++k) g_position[3 * t + k] += a[k] + b[k];
                for (int c = 0; c < light_channels; ++c)
                    g_intensity[light_channels * t + c] +=
                        intensity_sum(t, c) + intensity_sum(count + t, c);
            }
            if (t == 0) of_eye_sums<0>();
            if (t == 1) of_eye_sums<1>();
        });
    }

  private:
    RYE_DEVICE float intensity_sum(int t, int channel) const {
        return sums[light_room * t + LightEyePointVjp<float>::intensity_at + channel];
    }
    RYE_DEVICE void of_light(int t, int eye, int light) const {
        const EyeTransform<float>& placed = frame->eye[eye];
        const LightGradient<float> own = light_vjp<float>(seen[t], sums + light_room * t);
        DeviceLightGradient g;
        g.light = g.eye.add(placed, column3(lights.position, light), own.light);
        g.eye.add(placed, column3(camera, 0), own.camera);
        apart[t] = g;
    }
    template <int eye>
    RYE_DEVICE void of_eye_sums() const {
        IntoEye<float> sum;
        for (int l = 0; l < int(lights.count); ++l) {
            const IntoEye<float>& own = apart[eye * int(lights.count) + l].eye;
            sum.rotation += own.rotation;
            sum.translation += own.translation;
        }
        add_into_eye_sums<E, eye>(sum, *frame, eye_sums + eye * EyeSums<E, eye>::room);
    }
};

/// Highlights of an avatar's eyes on a device. `of` and `to` give where arrays of the host's
/// avatar, and their gradients, lie in device memory. E has Glint.
template <EffectSet E, class Device>
class DeviceHighlights {
  public:
    DeviceHighlights(const Device& device, const EyeOptics<float, E>& host)
        : device_(device),
          host_(&host),
          sums_(device) {}

    /// Takes corneas and widths. Waits. Throws an Error for arrays that do not belong together.
    void set_fixed(const CudaQueue& queue) {
        if (host_->lights() == 0) return;
        check_optics(*host_);
        const auto lights = static_cast<std::size_t>(host_->lights());
        const auto send = [&](DeviceBuffer<float>& to, const Columns<float>& a) {
            to.reserve(queue, static_cast<std::size_t>(a.size()));
            device_.send(queue, to.data(), a.data(),
                         static_cast<std::size_t>(a.size()) * sizeof(float));
        };
        send(cornea_, host_->cornea);
        send(width_, host_->light_width);
        seen_.reserve(queue, 2 * lights);
        apart_.reserve(queue, 2 * lights);
        light_sums_.reserve(queue, 2 * lights * light_room);
    }

    /// Adds the highlights of a frame, whose eyes are placed, to the features, C x P. `camera`: its
    /// centre in the world, 3 numbers in device memory.
    template <class Of>
    void add_into(const CudaQueue& queue, const Of& of, const float* camera,
                  const DeviceFrameState* frame, const DeviceEyePoints& points,
                  const DeviceColumns<float>& feature) {
        if (host_->lights() == 0) return;
        const LightArrays<float> lights = arrays(of);
        device_.launch(queue, 1, SeeLightsKernel{lights, camera, frame, seen_.data()});
        launch_each(device_, queue, points.count,
                    HighlightBothEyes{{{points.position, points.seen, cornea_.data()},
                                       seen_.data(),
                                       lights.intensity,
                                       lights.count,
                                       feature.rows,
                                       feature.data},
                                      points.left});
    }
    /// Adds the gradients of the lights to `to`, and to the sums over the points of each eye
    /// (EyeSums), given the cotangent of the features of the last add_into.
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of& of, const To& to, const float* camera,
                  const DeviceFrameState* frame, const DeviceEyePoints& points,
                  const DeviceColumns<float>& g, float* eye_sums) {
        if (host_->lights() == 0) return;
        const LightArrays<float> lights = arrays(of);
        for (int eye = 0; eye < 2; ++eye)
            for (Index l = 0; l < lights.count; ++l) {
                const Index first = eye == 0 ? 0 : points.left,
                            n = eye == 0 ? points.left : points.count - points.left,
                            at = eye * lights.count + l;
                float* const g_seen =
                    points.g_seen == nullptr ? nullptr : points.g_seen + 3 * first;
                sums_.launch(
                    queue, n,
                    LightEyePointVjp<float>{{points.position + 3 * first, points.seen + 3 * first,
                                             cornea_.data() + cornea_numbers * eye},
                                            seen_.data() + at,
                                            lights.intensity + light_channels * l,
                                            g.rows,
                                            g.data + g.rows * first,
                                            g_seen},
                    {light_sums_.data() + light_room * at});
            }
        device_.launch(
            queue, 1,
            HighlightsVjpKernel<E>{lights, camera, frame, seen_.data(), light_sums_.data(),
                                   apart_.data(), eye_sums, to(host_->light_position).data,
                                   to(host_->light_intensity).data});
    }

    /// Memory that is held [bytes].
    std::size_t bytes() const {
        return cornea_.bytes() + width_.bytes() + seen_.bytes() + apart_.bytes() +
               light_sums_.bytes() + sums_.bytes();
    }

  private:
    template <class Of>
    LightArrays<float> arrays(const Of& of) const {
        return {cornea_.data(), of(host_->light_position).data, of(host_->light_intensity).data,
                width_.data(), host_->lights()};
    }

    Device device_;
    const EyeOptics<float, E>* host_;
    DeviceSums<Device> sums_;
    DeviceBuffer<float> cornea_, width_, light_sums_;
    DeviceBuffer<SeenLight<float>> seen_;
    DeviceBuffer<DeviceLightGradient> apart_;
};

} // namespace detail

} // namespace rye
