// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/eye_lids.hpp: shadows of the upper lids in device memory, by the formulas of
/// avatar/eye_lids.hpp: the lids of a frame, what they take from the colours of the eyeballs'
/// Gaussians, and back to the lids' numbers, to their points and to what places the eyes.
/// An avatar without shadows launches nothing.
#pragma once

#include <rye/avatar/cuda/eye_points.hpp>
#include <rye/avatar/cuda/frame.hpp>
#include <rye/avatar/eye_lids.hpp>

namespace rye {

namespace detail {

/// The lids of both eyes in device memory; their points are Gaussians of the face.
struct DeviceLidPoints {
    const float* line = nullptr; ///< EyeStream::lid_line, 3 x count
    Index count = 0;             ///< of both eyes; 0: there are no shadows
    float* at = nullptr;         ///< x and y from the eye's centre, in radii, 2 x count
    float* g = nullptr;          ///< their cotangents in the head's frame, 2 x count
    float radius[2] = {1, 1};

    RYE_HD Index of_eye() const { return count / 2; }
    RYE_HD LidArc<float> points(int eye) const { return {at + eye * count, of_eye()}; }
    RYE_HD Index column(Index k) const { return static_cast<Index>(line[3 * k]); }
};

/// Sets both lids of a frame whose eyes are placed and whose face is driven.
template <EffectSet E>
struct PlaceLidsKernel {
    static constexpr const char* name = "lids of a frame";
    static constexpr int threads = 64, blocks = 1;
    struct Shared {};
    DeviceLidPoints lids;
    const float* mean;    ///< of the face in the world, 3 x N
    const float* rest;    ///< the face's positions at rest, 3 x N
    const float* numbers; ///< trained, lid_numbers x 2
    const DeviceFrameState* frame;
    LidOfEye<float>* to; ///< 2

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            for (Index k = t; k < lids.count; k += threads) {
                const int eye = k < lids.of_eye() ? 0 : 1;
                const EyeTransform<float>& placed = frame->eye[eye];
                const Vec3<float> from = column3(mean, lids.column(k)) - placed.translation;
                const Vec3<float> in_head =
                    Rigid<float>{placed.head_rotation, from}.turn_back(from);
                for (int a = 0; a < 2; ++a) {
                    const float driven = in_head[a] / placed.scale - rest[3 * lids.column(k) + a];
                    lids.at[2 * k + a] = (lids.line[3 * k + 1 + a] + driven) / lids.radius[eye];
                }
            }
        });
        block.each_thread([&](int t) {
            if (t < 2 * lid_nodes) {
                const int eye = t / lid_nodes, node = t % lid_nodes;
                to[eye].height[std::size_t(node)] = lids.points(eye).mean(node).height;
            }
            if (t == 32) set_rest<0>();
            if (t == 33) set_rest<1>();
        });
    }

  private:
    template <int eye>
    RYE_DEVICE void set_rest() const {
        Mat3<float> turn = Rigid<float>::identity_rotation();
        if constexpr (eye_turns<E, std::size_t(eye)>) turn = quat_matrix(frame->turn[eye]);
        set_lid_turn(turn, lids.radius[eye], to[eye]);
        set_lid_numbers(numbers + lid_numbers * eye, to[eye]);
    }
};

/// Darkens point i of both eyes.
struct ShadeBothEyes {
    static constexpr const char* name = ShadeEyePoint<float>::name;
    ShadeEyePoint<float> point; ///< of the left eye, whose points and lid come first
    Index left;                 ///< number of its points

    RYE_DEVICE void operator()(Index i) const {
        ShadeEyePoint<float> own = point;
        if (i >= left) ++own.lid;
        own(i);
    }
};

/// What a lid adds to the cotangents of its eye's place in the head.
struct DeviceLidPlace {
    Mat3<float> turn;
    Vec3<float> centre;
};

/// Numbers that the sums of an eye's lid are apart.
inline constexpr int lid_room = 24;

} // namespace detail

static_assert(LidSums::count <= detail::lid_room);

namespace detail {

/// Adds the gradients of the lids' numbers, and sets the cotangents of the lids' points and of the
/// eyes' places.
struct LidsVjpKernel {
    static constexpr const char* name = "lids of a frame, reverse";
    static constexpr int threads = 64, blocks = 1;
    struct Shared {};
    DeviceLidPoints lids;
    const float *numbers, *sums; ///< sums: lid_room apart
    float* g_numbers;            ///< lid_numbers x 2, added to
    DeviceLidPlace* place;       ///< 2

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            for (Index k = t; k < lids.count; k += threads) {
                const int eye = k < lids.of_eye() ? 0 : 1;
                float own[2] = {0.0F, 0.0F};
                lids.points(eye).vjp(k - eye * lids.of_eye(),
                                     sums + lid_room * eye + LidSums::height_at, own);
                for (int a = 0; a < 2; ++a) lids.g[2 * k + a] = own[a] / lids.radius[eye];
            }
        });
        block.each_thread([&](int t) {
            if (t >= 2) return;
            const float* const own = sums + lid_room * t;
            lid_numbers_vjp(numbers + lid_numbers * t, own, g_numbers + lid_numbers * t);
            place[t].turn = lid_turn_vjp(own, lids.radius[t]);
            Vec3<float> centre(0.0F, 0.0F, 0.0F);
            for (Index k = 0; k < lids.of_eye(); ++k)
                for (int a = 0; a < 2; ++a) centre[a] -= lids.g[2 * (t * lids.of_eye() + k) + a];
            place[t].centre = centre;
        });
    }
};

/// Adds an eye's part of that to the sums over its points.
template <EffectSet E>
struct AddLidPlace {
    static constexpr const char* name = "lids, places of eyes";
    const DeviceLidPlace* place;
    float* eye_sums; ///< of each eye, EyeSums::room apart

    RYE_DEVICE void operator()(Index i) const {
        if (i == 0) add<0>();
        if (i == 1) add<1>();
    }

  private:
    template <int eye>
    RYE_DEVICE void add() const {
        using Places = EyeSums<E, eye>;
        float* const to = eye_sums + eye * Places::room;
        if constexpr (Places::turn) {
            TurnCotangent<float> turn;
            turn.rotation = place[eye].turn;
            add_turn_sums(turn, to, Places::turn_at);
        }
        if constexpr (has_effect<E, EyeOffset>)
            for (int k = 0; k < 3; ++k) to[Places::centre_at + k] += place[eye].centre[k];
    }
};

/// Adds coordinate i (x or y) of the cotangents of the lids' points to those of the face's means in
/// the head's frame, one after the other. What its positions at rest get of the means cancels what
/// they get by themselves.
struct AddLidPoints {
    static constexpr const char* name = "lids, points of the face";
    DeviceLidPoints lids;
    float* g_mean; ///< 3 x N

    RYE_DEVICE void operator()(Index i) const {
        for (Index k = 0; k < lids.count; ++k) g_mean[3 * lids.column(k) + i] += lids.g[2 * k + i];
    }
};

/// Shadows of an avatar's lids on a device. `of` and `to` give where arrays of the host's avatar,
/// and their gradients, lie in device memory. E has LidShadow.
template <EffectSet E, class Device>
class DeviceLids {
  public:
    DeviceLids(const Device& device, const EyeStream<float, E>& host)
        : device_(device),
          host_(&host),
          sums_(device) {}

    /// Returns true if the lids cast shadows.
    bool any() const { return host_->has_lid_shadow(); }

    /// Takes the lids' columns of a face of so many Gaussians. Waits. Throws as check_lids does.
    void set_fixed(const CudaQueue& queue, Index face) {
        if (!any()) return;
        check_lids(*host_, face);
        const auto count = static_cast<std::size_t>(host_->lid_line.cols());
        line_.reserve(queue, 3 * count);
        device_.send(queue, line_.data(), host_->lid_line.data(), 3 * count * sizeof(float));
        points_.reserve(queue, 4 * count);
        eye_.reserve(queue, 2);
        place_.reserve(queue, 2);
        lid_sums_.reserve(queue, 2 * lid_room);
        lids_ = {line_.data(),
                 host_->lid_line.cols(),
                 points_.data(),
                 points_.data() + 2 * count,
                 {eyeball_radius(*host_, 0), eyeball_radius(*host_, 1)}};
    }

    /// Darkens the features, C x P, of a frame whose eyes are placed and whose face, means in the
    /// world and positions at rest, is driven. position: the eyes' points, 3 x P. keep: what a vjp
    /// reads.
    template <class Of>
    void shade_into(const CudaQueue& queue, const Of& of, const float* mean, const float* rest,
                    const DeviceFrameState* frame, const float* position,
                    const DeviceColumns<float>& feature, bool keep) {
        if (!any()) return;
        if (keep) plain_.reserve(queue, std::size_t(shaded_channels * feature.cols));
        device_.launch(
            queue, 1,
            PlaceLidsKernel<E>{lids_, mean, rest, of(host_->lid_shadow).data, frame, eye_.data()});
        launch_each(device_, queue, feature.cols,
                    ShadeBothEyes{{position, eye_.data(), feature.rows, feature.data,
                                   keep ? plain_.data() : nullptr},
                                  host_->points_of(0)});
    }
    /// Adds the gradient of the lids' numbers, given the cotangent of the features of the last
    /// shade_into that kept. Sets g_plain, points and what add_places_into adds.
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of& of, const To& to, const float* position,
                  const DeviceColumns<float>& g) {
        if (!any()) return;
        g_plain_.reserve(queue, static_cast<std::size_t>(g.size()));
        g_ = {g_plain_.data(), g.rows, g.cols};
        for (int eye = 0; eye < 2; ++eye) {
            const Index first = host_->first_point(eye);
            sums_.launch(queue, host_->points_of(eye),
                         ShadeEyePointVjp<float>{position + 3 * first, eye_.data() + eye, g.rows,
                                                 plain_.data() + shaded_channels * first,
                                                 g.data + g.rows * first, g_.data + g.rows * first},
                         {lid_sums_.data() + lid_room * eye});
        }
        device_.launch(queue, 1,
                       LidsVjpKernel{lids_, of(host_->lid_shadow).data, lid_sums_.data(),
                                     to(host_->lid_shadow).data, place_.data()});
    }
    /// Adds to the sums over the points of each eye (EyeSums).
    void add_places_into(const CudaQueue& queue, float* eye_sums) {
        if (any()) launch_each(device_, queue, 2, AddLidPlace<E>{place_.data(), eye_sums});
    }

    /// The cotangent of the features before the shadow.
    const DeviceColumns<float>& g_plain() const { return g_; }
    /// The lids' points and their cotangents.
    const DeviceLidPoints& points() const { return lids_; }
    /// Memory that is held [bytes].
    std::size_t bytes() const {
        return line_.bytes() + points_.bytes() + plain_.bytes() + g_plain_.bytes() +
               lid_sums_.bytes() + eye_.bytes() + place_.bytes() + sums_.bytes();
    }

  private:
    Device device_;
    const EyeStream<float, E>* host_;
    DeviceSums<Device> sums_;
    DeviceLidPoints lids_;
    DeviceColumns<float> g_{};
    DeviceBuffer<float> line_, points_, plain_, g_plain_, lid_sums_;
    DeviceBuffer<LidOfEye<float>> eye_;
    DeviceBuffer<DeviceLidPlace> place_;
};

} // namespace detail

} // namespace rye
