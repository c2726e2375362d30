// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/two_stream.hpp: the whole avatar (avatar/two_stream.hpp) on a device: parameters
/// in one piece of memory, drivers in device memory, the driven cloud where a DeviceRasterizer
/// reads it, and the vjp from the cloud's cotangents to all parameters. The upsampler's parameters
/// are in the same piece, and its part of a step is elsewhere.
///
///     DeviceTwoStream<E, CudaDevice, DeviceNetworks<1>> avatar(device, queue,
///                                                              {host, config, roles});
///     avatar.set_drivers(queue, drivers);
///     do { avatar.drive_into(queue); } while (!avatar.finish(queue));
///     rasterizer.forward_into(queue, avatar.cloud(), ...);  // its vjp into avatar.g_cloud(queue)
///     avatar.vjp_into(queue, gradient);
///
/// But for set_drivers, finish, upload and download nothing waits. Sums have a fixed order: the
/// same build gives the same bits.
#pragma once

#include <limits>
#include <memory>

#include <rye/avatar/cuda/cloud_buffer.hpp>
#include <rye/avatar/cuda/eye_stream.hpp>
#include <rye/avatar/cuda/face_stream.hpp>
#include <rye/avatar/cuda/head_shading.hpp>
#include <rye/avatar/cuda/view_color.hpp>
#include <rye/backend/cuda/resident.hpp>

namespace rye {

/// An avatar of the host and what is the same in every frame.
template <EffectSet E>
struct AvatarOnHost {
    const TwoStream<float, E>& avatar;
    const AvatarConfig& config;
    const LandmarkRoles& roles;
};

/// An avatar on a device.
template <DeviceEffects E, class Device, class Networks = DeviceNetworks<1>>
class DeviceTwoStream {
    using Host = TwoStream<float, E>;

  public:
    using Parameters = Resident<Host, Device>;

    /// Takes the shapes of the host's avatar, and its numbers. Waits. Throws an Error for networks
    /// that do not fit the tiles, and for landmarks that are not finite.
    DeviceTwoStream(const Device& device, const CudaQueue& queue, const AvatarOnHost<E>& of)
        : device_(device),
          config_(of.config),
          host_(of.avatar),
          layout_(host_),
          parameters_(device, queue, layout_),
          drivers_(of.config),
          codes_(of.config),
          face_(device, config_, host_.face, scratch_),
          eyes_(device, config_, host_.eyes, eye_scratch_) {
        detail::check_corrections(host_, "DeviceTwoStream");
        parameters_.send(queue, host_);
        face_.rest().set_fixed(queue, of.roles);
        const Index n = face_.count() + eyes_.count();
        cloud_.reserve(queue, n, config_.channels);
        driver_numbers_.reserve(queue, static_cast<std::size_t>(drivers_.size) + 1);
        eyes_.set_fixed(queue, drivers_, driver_numbers_.data(), face_.count());
        codes_numbers_.reserve(queue, 2 * static_cast<std::size_t>(codes_.size) + 2);
        state_.reserve(queue, 1);
        sums_.reserve(queue, std::size_t(detail::head_sums) + 6 + (parts_train_pose ? 6 : 0));
        if constexpr (has_effect<E, HeadShading>)
            shading_ = std::make_unique<DeviceHeadShading<Device>>(
                device, queue, host_.shading,
                detail::ShadedCounts{face_.count(), host_.eyes.points_of(0), n});
        if constexpr (has_effect<E, ViewColor>)
            view_color_ = std::make_unique<DeviceViewColors<E, Device>>(
                device, queue, host_.view_color, face_.count(), n,
                detail::DeviceSeenHead<E>{driver_numbers_.data() + drivers_.camera, state_.data()});
        device.fill(queue, sums_.data(), 0, sums_.bytes());
        face_.rest().place_into(queue, at(parameters_));
        static_cast<void>(face_.rest().finish(queue));
    }
    DeviceTwoStream(const DeviceTwoStream&) = delete;
    DeviceTwoStream& operator=(const DeviceTwoStream&) = delete;

    /// The host's avatar that the device's was made of: its shapes, and the addresses by which
    /// `parameters` finds arrays; its numbers are old after a step.
    const Host& shapes() const { return host_; }
    /// Returns the places of the drivers' numbers in drivers().
    const detail::DriverPlaces<E>& driver_places() const { return drivers_; }
    /// Returns the place of every array; gradients and an optimiser's moments have the same layout.
    const ResidentLayout<Host>& layout() const { return layout_; }
    const Parameters& parameters() const { return parameters_; }
    /// Frames that have corrections; any number where the avatar has none.
    Index frames() const {
        Index count = std::numeric_limits<Index>::max();
        if constexpr (has_effect<E, Kappa>)
            if (host_.delta_gaze.size() > 0) count = host_.delta_gaze.cols();
        if constexpr (has_effect<E, ReadsHeadPose>) count = host_.delta_pose.cols();
        return count;
    }
    /// True if the avatar corrects cameras.
    bool corrects_views() const {
        if constexpr (has_effect<E, HeadPose>) return host_.delta_view.size() > 0;
        return false;
    }
    /// Cameras that have corrections.
    Index cameras() const {
        if constexpr (has_effect<E, HeadPose>) return host_.delta_view.cols();
        return 0;
    }
    Index face_count() const { return face_.count(); }
    Index eye_count() const { return eyes_.count(); }

    /// Takes the parameters of an avatar of the same shapes. Waits.
    void upload(const CudaQueue& queue, const Host& from) { parameters_.send(queue, from); }
    /// Gives them: the host's avatar, as its checkpoints have it. Waits.
    void download(const CudaQueue& queue, Host& to) const { parameters_.fetch(queue, to); }

    /// The numbers that set_drivers takes, for kernels that write them; with its errors.
    std::vector<float> packed(const Drivers<float, E>& drivers, Index column,
                              SeenBy<float> seen) const {
        if (!corrects_views()) seen = {};
        if constexpr (has_effect<E, SeesCornea>)
            if (host_.eyes.optics.sees_cornea()) detail::require_camera(drivers.camera);
        if constexpr (has_effect<E, ViewColor>)
            if (host_.has_view_color()) detail::require_camera(drivers.camera, "view_color");
        if constexpr (has_effect<E, Pupil>)
            static_cast<void>(detail::pupil_maps(host_.eyes, drivers));
        require(seen.column < cameras(), "DeviceTwoStream", "column of delta_view is ",
                seen.column, ", expected -1 to ", cameras() - 1);
        require(column >= -1 && column < frames(), "DeviceTwoStream", "column of delta_pose is ",
                column, ", expected -1 to ", frames() - 1);
        return drivers_.packed(drivers, column, seen);
    }
    /// Takes what the next frames are driven by; `column`: the frame's in delta_pose and
    /// delta_gaze, which correct pose and gazes, -1 for none; `seen`: the picture's view, if
    /// cameras are corrected. Waits. Throws an Error for an expression of another width, a gaze
    /// without direction, a column that is not there.
    void set_drivers(const CudaQueue& queue, const Drivers<float, E>& drivers, Index column = -1,
                     const SeenBy<float>& seen = {}) {
        const std::vector<float> numbers = packed(drivers, column, seen);
        device_.send(queue, driver_numbers_.data(), numbers.data(), numbers.size() * sizeof(float));
    }
    /// The drivers' numbers in device memory (DriverPlaces), for kernels that write them.
    float* drivers() const { return driver_numbers_.data(); }

    /// Puts a frame on the stream. Parameters may have changed. `keep`: what a vjp reads.
    void drive_into(const CudaQueue& queue, bool keep = true) {
        const auto of = at(parameters_);
        code(queue);
        branches_.run(queue, 2, [&](std::size_t k, const CudaQueue& q) {
            if (k == 0)
                face_.set(q, of, codes_numbers_.data());
            else
                eyes_.set(q, of, codes_numbers_.data(), state_.data());
        });
        drive_streams(queue, of, keep);
    }
    /// The same with the parameters of the last drive_into: only what the drivers change is redone.
    /// Not for a vjp.
    void redrive_into(const CudaQueue& queue) {
        code(queue);
        face_.set_frame(queue);
        eyes_.set_frame(queue, at(parameters_));
        drive_streams(queue, at(parameters_), false);
    }
    /// The same where also the drivers are those of the last drive_into or redrive_into, but for
    /// gazes, pupils and camera (the frame's column too): redoes what gazes move, the points on the
    /// lists of the gazes' networks and the eyes, with the bits of a redrive_into. Networks of
    /// expression and head pose are not run; what they gave is still there, so this takes no
    /// memory. Lists and influences follow from the points at rest, light from the head pose. Eyes
    /// and their features are done whole, whatever changes them. Not for a vjp.
    void regaze_into([[maybe_unused]] const CudaQueue& queue) {
        if constexpr (!has_effect<E, AnyOf<LeftGaze, RightGaze>>) {
            if constexpr (has_effect<E, ReadsCamera>) redrive_into(queue);
        } else {
            const auto of = at(parameters_);
            code(queue);
            branches_.run(queue, 2, [&](std::size_t k, const CudaQueue& q) {
                if (k == 0) return face_.regaze_into(q, of, state_.data(), face_gaussians());
                eyes_.set_frame(q, of);
                eyes_.regaze_into(q, of, state_.data(), eye_gaussians());
            });
            light_eyes(queue, of, false);
            if constexpr (has_effect<E, ViewColor>)
                if (view_color_->any()) {
                    view_color_->color_again(queue, of, cloud(), face_.rest().gazed());
                    return shade(queue, of);
                }
            if constexpr (has_effect<E, HeadShading>)
                shading_->shade_into(queue, of, cloud().feature, face_.rest().gazed());
        }
    }
    /// Waits for the last frame. Whether its lists had room; where they had none they have now, and
    /// the frame has to be driven again: the gradient of one that had none is not a number. Throws
    /// an Error for a gaze without a direction.
    bool finish(const CudaQueue& queue) {
        std::uint32_t bad = 0;
        if (bad_gaze() != nullptr) device_.fetch(queue, &bad, bad_gaze(), sizeof bad);
        return take(bad, face_.rest().listed(queue));
    }
    /// The same with what has come to the host by the caller's own copies: of *bad_gaze(), and of
    /// the lengths of rooms().
    bool take(std::uint32_t bad, const std::vector<std::uint32_t>& lengths) {
        require(bad == 0, "DeviceTwoStream", "gaze of the ",
                (bad == 1U   ? "left"
                 : bad == 2U ? "right"
                             : "left and the right"),
                " eye is not finite or has no direction");
        return make_room(lengths);
    }
    /// The last frame's eyes whose gaze is bad, in device memory; null if no eye turns.
    const std::uint32_t* bad_gaze() const {
        if constexpr (has_effect<E, AnyOf<LeftGaze, RightGaze>>) return &state_.data()->bad_gaze;
        return nullptr;
    }

    /// Room for lists of those lengths, from the next frame on: what `finish` does, for a caller
    /// that has kept the longest of several frames. Whether there was.
    bool make_room(const std::vector<std::uint32_t>& lengths) {
        return face_.rest().make_room(lengths);
    }
    /// Lengths of the last frame's lists on the device, and the room for them.
    detail::DeviceRooms rooms() const { return face_.rest().rooms(); }

    /// Points of the face that each driver that is on moves, in the order of for_face_fields.
    /// Waits.
    std::vector<std::uint32_t> listed(const CudaQueue& queue) const {
        return face_.rest().listed(queue);
    }

    /// The driven Gaussians in the world: the face's columns first, then the eyes'.
    const DeviceGaussians<float>& cloud() const { return cloud_.view(); }
    DeviceGaussians<float> face_gaussians() const {
        return detail::columns_from(cloud(), {0, face_.count()});
    }
    DeviceGaussians<float> eye_gaussians() const {
        return detail::columns_from(cloud(), {face_.count(), eyes_.count()});
    }
    /// Returns the memory for cotangents of the cloud, which vjp_into consumes. It is taken at the
    /// first call.
    const DeviceGaussians<float>& g_cloud(const CudaQueue& queue) {
        g_cloud_.reserve(queue, cloud().count(), config_.channels);
        return g_cloud_.view();
    }

    /// Adds the gradients of the last drive_into, given the cotangents in g_cloud, which it
    /// consumes: of all parameters but the upsampler's; those of the frame's column of delta_pose
    /// and delta_gaze, and of the picture's of delta_view, if it has one.
    void vjp_into(const CudaQueue& queue, const Parameters& gradient) {
        require(&gradient.layout() == &layout_, "DeviceTwoStream", "gradient is of another layout");
        const auto of = at(parameters_), to = at(gradient);
        const DeviceGaussians<float>& g = g_cloud(queue);
        const Index n = face_.count(), p = eyes_.count();
        float* const g_codes = codes_numbers_.data() + codes_.size;
        device_.fill(queue, g_codes, 0, static_cast<std::size_t>(codes_.size) * sizeof(float));
        float* g_parts = nullptr;
        if constexpr (parts_train_pose) {
            g_parts = sums_.data() + detail::head_sums + 6;
            device_.fill(queue, g_parts, 0, 6 * sizeof(float));
        }
        if constexpr (has_effect<E, HeadShading>)
            shading_->vjp_into(queue, of, to, {state_.data(), cloud().feature, g.feature, g_parts});
        if constexpr (has_effect<E, ViewColor>) view_color_->vjp_into(queue, of, to, cloud(), g);
        const detail::DeviceLidPoints lids =
            eyes_.shadow_vjp_into(queue, of, to, detail::columns_from(g, {n, p}).feature);
        branches_.run(queue, 2, [&](std::size_t k, const CudaQueue& q) {
            if (k == 0)
                face_.vjp_into(
                    q, of, to, {codes_numbers_.data(), g_codes, state_.data()},
                    {face_gaussians(), detail::columns_from(g, {0, n}), sums_.data(), lids});
            else
                eyes_.vjp_into(q, of, to, state_.data(),
                               {eye_gaussians(), detail::columns_from(g, {n, p}), g_parts});
        });
        float* g_delta_gaze = nullptr;
        if constexpr (has_effect<E, Kappa>)
            if (host_.delta_gaze.size() > 0) g_delta_gaze = to(host_.delta_gaze).data;
        eyes_.codes_vjp_into(queue, to, numbers(), g_codes, g_delta_gaze);
        [[maybe_unused]] float* g_delta_view = nullptr;
        if constexpr (has_effect<E, HeadPose>)
            if (corrects_views()) g_delta_view = to(host_.delta_view).data;
        [[maybe_unused]] const float* g_seen = nullptr;
        if constexpr (has_effect<E, ViewColor>) g_seen = view_color_->g_rotation();
        if constexpr (has_effect<E, ReadsHeadPose>)
            device_.launch(queue, 1,
                           detail::FramePoseKernel<E>{drivers_,
                                                      codes_,
                                                      config_.pose_frequencies,
                                                      numbers(),
                                                      {sums_.data(),
                                                       {eyes_.sums(0), eyes_.sums(1)},
                                                       g_codes,
                                                       sums_.data() + detail::head_sums,
                                                       to(host_.delta_pose).data,
                                                       g_delta_view,
                                                       g_parts,
                                                       g_seen}});
    }
    /// The cotangent of the pose after vjp_into: 6 numbers in device memory.
    const float* g_pose() const { return sums_.data() + detail::head_sums; }

    /// Memory of a cloud [bytes].
    std::size_t cloud_bytes() const { return cloud_.bytes(); }
    /// Memory that is held, of parameters, the streams and the clouds [bytes].
    std::size_t bytes() const {
        std::size_t shading = 0;
        if constexpr (has_effect<E, HeadShading>) shading = shading_->bytes();
        if constexpr (has_effect<E, ViewColor>) shading += view_color_->bytes();
        return shading + parameters_.bytes() + face_.bytes() + eyes_.bytes() + scratch_.bytes() +
               eye_scratch_.bytes() + cloud_.bytes() + g_cloud_.bytes() + driver_numbers_.bytes() +
               codes_numbers_.bytes() + state_.bytes() + sums_.bytes();
    }

  private:
    /// True if shading or features lead to the head pose's correction.
    static constexpr bool parts_train_pose =
        has_effect<E, HeadShading> || detail::eyes_train_pose<E>;

    static auto at(const Parameters& p) {
        return [&p](const Columns<float>& array) { return p.of(array); };
    }
    detail::DeviceFrameNumbers numbers() const {
        detail::DeviceFrameNumbers r{driver_numbers_.data(), codes_numbers_.data(), state_.data()};
        if constexpr (has_effect<E, ReadsHeadPose>)
            r.delta_pose = parameters_.of(host_.delta_pose).data;
        if constexpr (has_effect<E, HeadPose>)
            if (corrects_views()) r.delta_view = parameters_.of(host_.delta_view).data;
        if constexpr (has_effect<E, Kappa>) {
            if (host_.eyes.kappa.size() > 0) r.kappa = parameters_.of(host_.eyes.kappa).data;
            if (host_.delta_gaze.size() > 0) r.delta_gaze = parameters_.of(host_.delta_gaze).data;
        }
        return r;
    }
    void code(const CudaQueue& queue) {
        using Read = detail::ReaderOf<Reads::expression | Reads::head_pose | Reads::gaze>;
        if constexpr (has_effect<E, Read>)
            device_.launch(queue, 1,
                           detail::FrameCodesKernel<E>{drivers_, codes_, config_.expression,
                                                       config_.pose_frequencies,
                                                       config_.gaze_frequencies, numbers()});
    }
    template <class Of>
    void light_eyes(const CudaQueue& queue, const Of& of, bool keep) {
        eyes_.light_into(queue, of, state_.data(), cloud().mean.data, of(host_.face.position).data,
                         eye_gaussians(), keep);
    }
    template <class Of>
    void drive_streams(const CudaQueue& queue, const Of& of, bool keep) {
        branches_.run(queue, 2, [&](std::size_t k, const CudaQueue& q) {
            if (k == 0)
                face_.drive_into(q, of, {codes_numbers_.data(), nullptr, state_.data()},
                                 face_gaussians(), keep);
            else
                eyes_.drive_into(q, of, state_.data(), eye_gaussians(), keep);
        });
        light_eyes(queue, of, keep);
        if constexpr (has_effect<E, ViewColor>) view_color_->color_into(queue, of, cloud());
        shade(queue, of);
    }
    template <class Of>
    void shade([[maybe_unused]] const CudaQueue& queue, [[maybe_unused]] const Of& of) {
        if constexpr (has_effect<E, HeadShading>)
            shading_->shade_into(queue, of, state_.data(), cloud().feature);
    }

    Device device_;
    DeviceBranches<Device> branches_;
    AvatarConfig config_;
    Host host_; ///< its shapes, and the addresses that arrays are found by
    ResidentLayout<Host> layout_;
    Parameters parameters_;
    detail::DriverPlaces<E> drivers_;
    detail::CodePlaces<E> codes_;
    detail::DeviceFieldScratch scratch_;
    DeviceMlpScratch eye_scratch_;
    DeviceFaceStream<E, Device, Networks> face_;
    DeviceEyeStream<E, Device, Networks> eyes_;
    [[no_unique_address]] detail::Slot<E, HeadShading, std::unique_ptr<DeviceHeadShading<Device>>>
        shading_;
    [[no_unique_address]] detail::Slot<E, ViewColor, std::unique_ptr<DeviceViewColors<E, Device>>>
        view_color_;
    detail::DeviceCloudBuffer cloud_, g_cloud_;
    DeviceBuffer<float> driver_numbers_, codes_numbers_; ///< codes, then their cotangents
    DeviceBuffer<detail::DeviceFrameState> state_;
    DeviceBuffer<float> sums_; ///< over the face for the head; the pose's cotangent
};

} // namespace rye
