// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/eye_stream.hpp: the driven eyeballs (avatar/eye_stream.hpp) in device memory:
/// the offset's network, one transform an eye, its features and mechanism, and what they do to each
/// Gaussian; with the vjp to all parameters and to the pose's code.
#pragma once

#include <memory>
#include <string>

#include <rye/avatar/cuda/driven_features.hpp>
#include <rye/avatar/cuda/eye_highlights.hpp>
#include <rye/avatar/cuda/eye_lids.hpp>
#include <rye/avatar/cuda/eye_points.hpp>
#include <rye/avatar/cuda/eye_refraction.hpp>
#include <rye/avatar/cuda/field.hpp>
#include <rye/avatar/cuda/gaze_mechanisms.hpp>

namespace rye {

namespace detail {

/// World cotangents of the eyes' Gaussians, which the vjp consumes.
struct DeviceEyeCotangent {
    DeviceGaussians<float> world, g;
    float* g_pose = nullptr; ///< of the pose as the eyes' features read it, 6, added to, or null
};

} // namespace detail

/// The eyes of an avatar on a device. `of` gives where each array of the host's struct lies in
/// device memory, as Resident::of does.
template <DeviceEffects E, class Device, class Networks = DeviceNetworks<1>>
class DeviceEyeStream {
    using A = typename detail::NetworksOf<E>::Activation;
    using Appearance = DeviceEyeAppearance<EyeAppearanceOf<E>, Device, Networks>;

  public:
    /// Throws an Error for networks that do not fit their kernels. Networks of the features have
    /// `scratch` among them.
    DeviceEyeStream(const Device& device, const AvatarConfig& config,
                    const EyeStream<float, E>& host, DeviceMlpScratch& scratch)
        : device_(device),
          config_(config),
          host_(&host),
          codes_(config),
          sums_(device),
          appearance_(device, host.appearance(), scratch) {
        if constexpr (detail::own_turn<E>)
            mechanism_ = std::make_unique<DeviceGazeMechanism<GazeMechanismOf<E>, Device>>(
                device, host.mechanism());
        if constexpr (has_effect<E, Glint>)
            highlights_ =
                std::make_unique<detail::DeviceHighlights<E, Device>>(device, host.optics);
        if constexpr (has_effect<E, CornealRefraction>)
            refraction_ =
                std::make_unique<detail::DeviceRefraction<E, Device>>(device, host.optics);
        if constexpr (has_effect<E, LidShadow>)
            lids_ = std::make_unique<detail::DeviceLids<E, Device>>(device, host);
        if constexpr (has_effect<E, EyeOffset>)
            offset_ = std::make_unique<DeviceMlpColumn<Device, A>>(device, host.offset.mlp.shape);
    }

    Index count() const { return host_->position.cols(); }

    /// Takes what is not trained: the template's points and the neutral centres. Waits. `drivers`:
    /// where each frame's will lie in device memory, at those places; `face`: its Gaussians.
    void set_fixed(const CudaQueue& queue, const detail::DriverPlaces<E>& at, const float* drivers,
                   [[maybe_unused]] Index face) {
        camera_ = drivers + at.camera;
        if constexpr (has_effect<E, LidShadow>) lids_->set_fixed(queue, face);
        if constexpr (has_effect<E, Glint>) highlights_->set_fixed(queue);
        if constexpr (has_effect<E, CornealRefraction>) refraction_->set_fixed(queue, count());
        const auto put = [&](DeviceBuffer<float>& to, const Columns<float>& a) {
            to.reserve(queue, static_cast<std::size_t>(a.size()) + 1);
            device_.send(queue, to.data(), a.data(),
                         static_cast<std::size_t>(a.size()) * sizeof(float));
        };
        require(host_->centre.rows() == 3 && host_->centre.cols() == 2, "DeviceEyeStream",
                "centre is ", host_->centre.rows(), " x ", host_->centre.cols(),
                ", expected 3 x 2");
        put(position_, host_->position);
        put(centre_, host_->centre);
        if constexpr (has_effect<E, Pupil>) {
            put(moved_, host_->position);
            pupils_ = {{nullptr, nullptr}, position_.data(), moved_.data(), {}};
            for_eyes([&]<std::size_t eye>() {
                if constexpr (!pupil_moves<E, eye>) return;
                pupils_.ratio[eye] = drivers + at.pupil[eye];
                pupils_.iris[eye] = iris_of(*host_, static_cast<Index>(eye));
            });
        }
        const std::size_t inputs =
            static_cast<std::size_t>(codes_.pose - codes_.expression) +
            static_cast<std::size_t>(detail::encoded_size(6, config_.pose_frequencies));
        numbers_.reserve(queue, 12 + 2 * std::size_t(detail::EyeSums<E, 0>::room) + inputs);
        if constexpr (detail::axes_are_trained<E>) g_axis_.reserve(queue, 6);
        appearance_.set_fixed(queue, {host_->position, host_->points_of(0)});
    }

    /// Takes the networks, and the frame's codes and state.
    template <class Of>
    void set(const CudaQueue& queue, const Of& of, [[maybe_unused]] const float* codes,
             const detail::DeviceFrameState* frame) {
        frame_.gazes = {frame, {eye_turns<E, 0>, eye_turns<E, 1>}};
        frame_.reads_pose = has_effect<E, ReadsHeadPose>;
        if constexpr (has_effect<E, ReadsExpression>) frame_.expression = codes + codes_.expression;
        appearance_.set(queue, of, frame_);
        if constexpr (detail::own_turn<E>) mechanism_->set(queue, of);
        if constexpr (has_effect<E, EyeOffset>)
            offset_->set(queue, device_parameters(host_->offset.mlp, of),
                         codes + codes_.expression);
    }

    /// The frame's codes and state have changed, and nothing else.
    template <class Of>
    void set_frame(const CudaQueue& queue, const Of& of) {
        appearance_.set_frame(queue, of, frame_);
    }

    /// Places the eyes and puts their Gaussians into `to`, in the world: P columns. `keep`: what a
    /// vjp reads.
    template <class Of>
    void drive_into(const CudaQueue& queue, const Of& of, detail::DeviceFrameState* frame,
                    const DeviceGaussians<float>& to, bool keep) {
        if constexpr (has_effect<E, EyeOffset>) offset_->forward_into(queue);
        regaze_into(queue, of, frame, to, keep);
    }
    /// The same with the offset of the last drive_into, which no gaze changes. All of an eye may
    /// follow from its gaze, and its features from a network that reads it: both are done whole.
    template <class Of>
    void regaze_into(const CudaQueue& queue, const Of& of, detail::DeviceFrameState* frame,
                     const DeviceGaussians<float>& to, bool keep = false) {
        detail::PlaceEyesKernel<E> place{centre_.data(), offset(), frame};
        if constexpr (detail::own_turn<E>) {
            mechanism_->turn_into(queue, frame_);
            place.turns = mechanism_->turns();
        }
        device_.launch(queue, 1, place);
        if constexpr (has_effect<E, CornealRefraction>)
            refraction_->see_into(queue, of, camera_, frame, points(), pupils_);
        launch_each(device_, queue, count(),
                    detail::DriveBothEyes<E>{
                        {{arrays_at(of), seen_points(), to, &frame->eye[0]}, &frame->head},
                        host_->points_of(0),
                        pupils_});
        appearance_.features_into(queue, of, frame_, to.feature, keep);
        if (!waits_for_face()) add_highlights_into(queue, of, frame, to);
    }
    /// Returns true if features are complete only by light_into, after the face: lids shade them.
    bool waits_for_face() const { return host_->has_lid_shadow(); }
    /// Adds highlights and shadows, if the eyes wait for the face: means in the world, positions at
    /// rest, 3 x N.
    template <class Of>
    void light_into([[maybe_unused]] const CudaQueue& queue, [[maybe_unused]] const Of& of,
                    [[maybe_unused]] const detail::DeviceFrameState* frame,
                    [[maybe_unused]] const float* mean, [[maybe_unused]] const float* rest,
                    [[maybe_unused]] const DeviceGaussians<float>& to, [[maybe_unused]] bool keep) {
        if constexpr (has_effect<E, LidShadow>) {
            if (!waits_for_face()) return;
            add_highlights_into(queue, of, frame, to);
            lids_->shade_into(queue, of, mean, rest, frame, moved_points(), to.feature, keep);
        }
    }
    /// Takes the cotangent of the features, C x P, to that before the shadows, which vjp_into
    /// reads. Returns the lids' points and their cotangents, none without shadows.
    template <class Of, class To>
    detail::DeviceLidPoints shadow_vjp_into([[maybe_unused]] const CudaQueue& queue,
                                            [[maybe_unused]] const Of& of,
                                            [[maybe_unused]] const To& to,
                                            [[maybe_unused]] const DeviceColumns<float>& g) {
        if constexpr (has_effect<E, LidShadow>) {
            lids_->vjp_into(queue, of, to, moved_points(), g);
            return lids_->points();
        }
        return {};
    }

    /// Adds the gradients of the last drive_into to arrays that `to` gives, but for what
    /// codes_vjp_into adds.
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of& of, const To& to,
                  const detail::DeviceFrameState* frame,
                  const detail::DeviceEyeCotangent& cotangent) {
        DeviceEyeFrame parts = frame_;
        parts.g_pose = cotangent.g_pose;
        if constexpr (detail::axes_are_trained<E>)
            if (host_->kappa.size() > 0) {
                parts.g_axis = g_axis_.data();
                device_.fill(queue, g_axis_.data(), 0, g_axis_.bytes());
            }
        DeviceColumns<float> g_feature = cotangent.g.feature;
        if constexpr (has_effect<E, LidShadow>)
            if (waits_for_face()) g_feature = lids_->g_plain();
        appearance_.vjp_into(queue, of, to, parts, g_feature);
        points_vjp<0>(queue, {arrays_at(of), arrays_at(to)}, frame, cotangent);
        points_vjp<1>(queue, {arrays_at(of), arrays_at(to)}, frame, cotangent);
        detail::DeviceEyePoints seen = points();
        if constexpr (has_effect<E, CornealRefraction>)
            seen.g_seen = refraction_->into_eyes(queue, frame, seen, cotangent.g.mean.data);
        if constexpr (has_effect<E, Glint>)
            highlights_->vjp_into(queue, of, to, camera_, frame, seen, g_feature,
                                  const_cast<float*>(sums(0)));
        if constexpr (has_effect<E, CornealRefraction>)
            refraction_->vjp_into(queue, of, to, camera_, frame, seen, const_cast<float*>(sums(0)));
        if constexpr (has_effect<E, LidShadow>)
            lids_->add_places_into(queue, const_cast<float*>(sums(0)));
        if constexpr (detail::own_turn<E>)
            mechanism_->vjp_into(queue, to, parts, {turn_sums<0>(), turn_sums<1>()});
        if constexpr (has_effect<E, EyeOffset>) {
            launch_each(device_, queue, 6, detail::EyeOffsetVjp<E>{sums(0), offset(), g_offset()});
            offset_->vjp_into(queue, g_offset(), device_parameters(host_->offset.mlp, to),
                              g_input());
        }
    }
    /// Reads and adds to the cotangents of the codes, after the face: the offset network's
    /// cotangent of the pose's code, the gradients of kappa and of delta_gaze (`g_delta_gaze`, 4 x
    /// frames or null).
    template <class To>
    void codes_vjp_into([[maybe_unused]] const CudaQueue& queue, [[maybe_unused]] const To& to,
                        [[maybe_unused]] const detail::DeviceFrameNumbers& frame,
                        [[maybe_unused]] float* g_codes, [[maybe_unused]] float* g_delta_gaze) {
        if constexpr (has_effect<E, Kappa>)
            if (host_->kappa.size() > 0) {
                detail::KappaVjpKernel<E> kappa{frame,
                                                sums(0),
                                                codes_,
                                                g_codes,
                                                config_.gaze_frequencies,
                                                {to(host_->kappa).data, g_delta_gaze},
                                                detail::DriverPlaces<E>(config_).column};
                if constexpr (detail::axes_are_trained<E>) kappa.g_axis = g_axis_.data();
                device_.launch(queue, 1, kappa);
            }
        if constexpr (has_effect<E, EyeOffset>) {
            const Index before = codes_.pose - codes_.expression;
            launch_each(device_, queue, offset_->shape().inputs() - before,
                        detail::AddNumbers{g_input() + before, g_codes + codes_.pose});
        }
    }
    /// Sums over an eye's points, the head's first (EyeSums).
    const float* sums(int eye) const {
        return numbers_.data() + 12 + eye * detail::EyeSums<E, 0>::room;
    }

    /// Memory that is held [bytes].
    std::size_t bytes() const {
        std::size_t sum = position_.bytes() + centre_.bytes() + numbers_.bytes() + sums_.bytes() +
                          appearance_.bytes();
        if constexpr (detail::own_turn<E>) sum += mechanism_->bytes();
        if constexpr (has_effect<E, Glint>) sum += highlights_->bytes();
        if constexpr (has_effect<E, CornealRefraction>) sum += refraction_->bytes();
        if constexpr (has_effect<E, LidShadow>) sum += lids_->bytes();
        if constexpr (detail::axes_are_trained<E>) sum += g_axis_.bytes();
        if constexpr (has_effect<E, EyeOffset>) sum += offset_->bytes();
        if constexpr (has_effect<E, Pupil>) sum += moved_.bytes();
        return sum;
    }

  private:
    struct BothArrays {
        detail::EyeArrays<float> raw, gradient;
    };
    template <class Of>
    detail::EyeArrays<float> arrays_at(const Of& of) const {
        return {of(host_->log_scale).data, of(host_->rotation).data, of(host_->opacity_logit).data};
    }
    detail::DeviceEyeOffset offset() const {
        const float* output = nullptr;
        if constexpr (has_effect<E, EyeOffset>) output = offset_->outputs();
        return {output, numbers_.data(), static_cast<float>(config_.deform_scale)};
    }
    template <int eye>
    const float* turn_sums() const {
        using Places = detail::EyeSums<E, eye>;
        return Places::turn ? sums(eye) + Places::turn_at : nullptr;
    }
    /// Both eyes' points as the pupils of the last frame move them.
    const float* moved_points() const {
        if constexpr (has_effect<E, Pupil>) return moved_.data();
        return position_.data();
    }
    /// The same as the camera of the last frame sees them.
    const float* seen_points() const {
        if constexpr (has_effect<E, CornealRefraction>)
            if (host_->optics.refracts()) return refraction_->seen();
        return moved_points();
    }
    detail::DeviceEyePoints points() const {
        return {moved_points(), count(), host_->points_of(0), seen_points(), nullptr};
    }
    template <class Of>
    void add_highlights_into([[maybe_unused]] const CudaQueue& queue, [[maybe_unused]] const Of& of,
                             [[maybe_unused]] const detail::DeviceFrameState* frame,
                             [[maybe_unused]] const DeviceGaussians<float>& to) {
        if constexpr (has_effect<E, Glint>)
            highlights_->add_into(queue, of, camera_, frame, points(), to.feature);
    }
    float* g_offset() const { return numbers_.data() + 6; }
    float* g_input() const { return numbers_.data() + 12 + 2 * detail::EyeSums<E, 0>::room; }

    template <int eye>
    void points_vjp(const CudaQueue& queue, const BothArrays& all,
                    const detail::DeviceFrameState* frame,
                    const detail::DeviceEyeCotangent& cotangent) {
        const Index first = host_->first_point(eye), n = host_->points_of(eye);
        sums_.launch(
            queue, n,
            detail::EyePointVjp<float, E, eye>{
                all.raw.from(first), all.gradient.from(first), seen_points() + 3 * first,
                detail::columns_from(cotangent.world, {first, n}),
                detail::columns_from(cotangent.g, {first, n}), &frame->head, &frame->turn[eye]},
            {const_cast<float*>(sums(eye))});
    }

    Device device_;
    AvatarConfig config_;
    const EyeStream<float, E>* host_;
    detail::CodePlaces<E> codes_;
    DeviceSums<Device> sums_;
    Appearance appearance_;
    DeviceEyeFrame frame_{};
    const float* camera_ = nullptr; ///< of the frame, in the world, 3
    [[no_unique_address]] detail::Slot<E, Glint,
                                       std::unique_ptr<detail::DeviceHighlights<E, Device>>, 1>
        highlights_;
    [[no_unique_address]] detail::Slot<E, CornealRefraction,
                                       std::unique_ptr<detail::DeviceRefraction<E, Device>>, 1>
        refraction_;
    [[no_unique_address]] detail::Slot<E, LidShadow, std::unique_ptr<detail::DeviceLids<E, Device>>,
                                       1>
        lids_;
    [[no_unique_address]] detail::PresentIf<
        detail::own_turn<E>, detail::NoOwnTurn,
        std::unique_ptr<DeviceGazeMechanism<GazeMechanismOf<E>, Device>>>
        mechanism_;
    [[no_unique_address]] detail::PresentIf<detail::axes_are_trained<E>, detail::NoTrainedAxes,
                                            DeviceBuffer<float>>
        g_axis_;
    [[no_unique_address]] detail::Slot<E, EyeOffset, std::unique_ptr<DeviceMlpColumn<Device, A>>>
        offset_;
    [[no_unique_address]] detail::Slot<E, Pupil, DeviceBuffer<float>> moved_;
    [[no_unique_address]] detail::Slot<E, Pupil, detail::DevicePupils, 1> pupils_;
    DeviceBuffer<float> position_, centre_;
    DeviceBuffer<float> numbers_; ///< squashed offsets, their cotangents, sums, of the inputs
};

} // namespace rye
