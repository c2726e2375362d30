// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/eye_refraction.hpp: the eyes' points in device memory as the frame's camera sees
/// them through the corneas, by the formulas of avatar/eye_refraction.hpp, and back to the
/// refractive indices and to what places the eyes.
/// An avatar whose corneas do not refract launches nothing and takes no memory.
#pragma once

#include <rye/avatar/cuda/eye_highlights.hpp>
#include <rye/avatar/cuda/eye_points.hpp>

namespace rye::detail {

/// Moves point i of both eyes by its pupil, and sets it as it is seen.
template <EffectSet E>
struct RefractBothEyes {
    static constexpr const char* name = RefractEyePoint<float>::name;
    RefractEyePoint<float> point; ///< of both eyes, with the left one's cornea; without a camera
    const float* camera;          ///< in the world, 3
    const DeviceFrameState* frame;
    Index left; ///< number of the left eye's points
    Slot<E, Pupil, DevicePupils, 1> pupils = {};

    RYE_DEVICE void operator()(Index i) const {
        const int eye = i < left ? 0 : 1;
        if constexpr (has_effect<E, Pupil>) {
            PupilMap<float> map;
            if (pupils.ratio[eye] != nullptr) map = {pupils.iris[eye], *pupils.ratio[eye]};
            MoveEyePoint<float>{pupils.position, map, pupils.moved}(i);
        }
        RefractEyePoint<float> own = point;
        own.cornea += cornea_numbers * eye;
        own.index += eye;
        own.camera = into_eye(frame->eye[eye], column3(camera, 0));
        own(i);
    }
};

/// Takes the cotangent of point i of both eyes from the head's frame into its eye.
struct IntoBothEyes {
    static constexpr const char* name = "eyes, refraction, into the eye";
    const float* g_mean; ///< head frame, 3 x P
    const DeviceFrameState* frame;
    Index left;
    float* g_seen; ///< 3 x P

    RYE_DEVICE void operator()(Index i) const {
        const EyeTransform<float>& eye = frame->eye[i < left ? 0 : 1];
        const Mat3<float> turn = eye.head_rotation.transpose() * eye.rotation;
        const Vec3<float> g = column3(g_mean, i);
        const Vec3<float> seen = turn.transpose() * g;
        put_column<3>(seen, g_seen, i);
    }
};

/// RefractEyePointVjp of an eye of the frame.
struct RefractEyeVjp {
    using Number = float;
    static constexpr const char* name = RefractEyePointVjp<float>::name;
    static constexpr int sums = RefractEyePointVjp<float>::sums;
    RefractEyePointVjp<float> vjp; ///< without a camera
    const float* camera;           ///< in the world, 3
    const DeviceFrameState* frame;
    int eye;

    template <class Sums>
    RYE_DEVICE void operator()(Index i, Sums& sum) const {
        RefractEyePointVjp<float> own = vjp;
        own.point.camera = into_eye(frame->eye[eye], column3(camera, 0));
        own(i, sum);
    }
};

/// Adds the gradients of the indices, and what the camera, taken into the eyes, adds to the sums
/// over the eyes' points.
template <EffectSet E>
struct RefractionVjpKernel {
    static constexpr const char* name = "refraction of a frame, reverse";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {};
    const float* camera; ///< in the world, 3
    const DeviceFrameState* frame;
    const float* sums; ///< of each eye, RefractEyeVjp::sums apart
    float* eye_sums;   ///< of each eye, EyeSums::room apart, added to
    float* g_index;    ///< 1 x 2, added to

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (t == 0) of_eye<0>();
            if (t == 1) of_eye<1>();
        });
    }

  private:
    template <int eye>
    RYE_DEVICE void of_eye() const {
        using Sums = RefractEyePointVjp<float>;
        const float* const own = sums + Sums::sums * eye;
        IntoEye<float> into;
        into.add(frame->eye[eye], column3(camera, 0), column3(own + Sums::camera_at, 0));
        add_into_eye_sums<E, eye>(into, *frame, eye_sums + eye * EyeSums<E, eye>::room);
        g_index[eye] += own[Sums::index_at];
    }
};

/// Refraction by the corneas of an avatar's eyes on a device. `of` and `to` give where arrays of
/// the host's avatar, and their gradients, lie in device memory. E has CornealRefraction.
template <EffectSet E, class Device>
class DeviceRefraction {
  public:
    DeviceRefraction(const Device& device, const EyeOptics<float, E>& host)
        : device_(device),
          host_(&host),
          sums_(device) {}

    /// Takes the corneas, for so many points. Waits. Throws an Error for arrays that do not belong
    /// together.
    void set_fixed(const CudaQueue& queue, Index count) {
        if (!host_->refracts()) return;
        check_optics(*host_);
        cornea_.reserve(queue, 2 * cornea_numbers);
        device_.send(queue, cornea_.data(), host_->cornea.data(),
                     2 * cornea_numbers * sizeof(float));
        seen_.reserve(queue, 3 * static_cast<std::size_t>(count) + 1);
        both_.reserve(queue, 2 * RefractEyeVjp::sums);
    }
    /// The points as they are seen, 3 x P; null without refraction.
    const float* seen() const { return host_->refracts() ? seen_.data() : nullptr; }

    /// Sets the points as they are seen in a frame whose eyes are placed, and as pupils move them.
    template <class Of, class Pupils>
    void see_into(const CudaQueue& queue, const Of& of, const float* camera,
                  const DeviceFrameState* frame, const DeviceEyePoints& points,
                  const Pupils& pupils) {
        if (!host_->refracts()) return;
        launch_each(device_, queue, points.count,
                    RefractBothEyes<E>{refraction(of, points.position, seen_.data()), camera, frame,
                                       points.left, pupils});
    }
    /// Takes the cotangents of the means, head frame, 3 x P, into the eyes; returns them, 3 x P, to
    /// be added to; null without refraction.
    float* into_eyes(const CudaQueue& queue, const DeviceFrameState* frame,
                     const DeviceEyePoints& points, const float* g_mean) {
        if (!host_->refracts()) return nullptr;
        g_seen_.reserve(queue, 3 * static_cast<std::size_t>(points.count) + 1);
        launch_each(device_, queue, points.count,
                    IntoBothEyes{g_mean, frame, points.left, g_seen_.data()});
        return g_seen_.data();
    }
    /// Adds the gradients of the indices to `to`, and to the sums over the points of each eye
    /// (EyeSums), given the cotangents that into_eyes returned.
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of& of, const To& to, const float* camera,
                  const DeviceFrameState* frame, const DeviceEyePoints& points, float* eye_sums) {
        if (!host_->refracts()) return;
        for (int eye = 0; eye < 2; ++eye) {
            const Index first = eye == 0 ? 0 : points.left,
                        n = eye == 0 ? points.left : points.count - points.left;
            RefractEyePoint<float> own = refraction(of, points.position + 3 * first, nullptr);
            own.cornea += cornea_numbers * eye;
            own.index += eye;
            sums_.launch(queue, n,
                         RefractEyeVjp{{own, g_seen_.data() + 3 * first}, camera, frame, eye},
                         {both_.data() + RefractEyeVjp::sums * eye});
        }
        device_.launch(
            queue, 1,
            RefractionVjpKernel<E>{camera, frame, both_.data(), eye_sums, to(host_->index).data});
    }

    /// Memory that is held [bytes].
    std::size_t bytes() const {
        return cornea_.bytes() + seen_.bytes() + g_seen_.bytes() + both_.bytes() + sums_.bytes();
    }

  private:
    template <class Of>
    RefractEyePoint<float> refraction(const Of& of, const float* position, float* seen) const {
        return {position, cornea_.data(), of(host_->index).data, Vec3<float>(0.0F, 0.0F, 0.0F),
                seen};
    }

    Device device_;
    const EyeOptics<float, E>* host_;
    DeviceSums<Device> sums_;
    DeviceBuffer<float> cornea_, seen_, g_seen_, both_;
};

} // namespace rye::detail
