// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/face_rest.hpp: what of a face in device memory follows from its parameters and
/// not from a frame (avatar/rest_pose.hpp): codes of points, features, influences, and lists of the
/// points that each driver moves; with the vjp to points and features.
#pragma once

#include <vector>

#include <rye/avatar/cuda/gazed_face.hpp>
#include <rye/avatar/face_fields.hpp>
#include <rye/avatar/face_stream.hpp>
#include <rye/nn/cuda/encoding.hpp>
#include <rye/rig/cuda/influence.hpp>

namespace rye::detail {

/// True for the field of an eye's gaze.
template <class By>
inline constexpr bool of_gaze = !std::same_as<By, ExpressionField> && !std::same_as<By, PoseField>;

/// A face of an avatar at rest on a device; `of` as in DeviceFaceStream.
template <DeviceEffects E, class Device>
class DeviceFaceRest {
  public:
    /// Places of drivers that are on, in the order of for_face_fields.
    static constexpr int place(ExpressionField) { return 0; }
    static constexpr int place(PoseField) { return has_effect<E, Expression> ? 1 : 0; }
    template <std::size_t eye>
    static constexpr int place(GazeField<eye>) {
        return place(PoseField{}) + (has_effect<E, PoseResidual> ? 1 : 0) +
               (eye == 1 && skin_follows<E, 0> ? 1 : 0);
    }
    /// Number of those that are on, and of gazes among them.
    static constexpr int drivers = place(GazeField<1>{}) + (skin_follows<E, 1> ? 1 : 0);
    static constexpr std::size_t gazes =
        (skin_follows<E, 0> ? 1 : 0) + (skin_follows<E, 1> ? 1 : 0);

    /// `host` must stay where it is.
    DeviceFaceRest(const Device& device, const AvatarConfig& config,
                   const FaceStream<float, E>& host)
        : device_(device),
          config_(config),
          host_(&host),
          lists_(device) {}

    Index count() const { return host_->position.cols(); }

    /// Takes what is not trained: landmarks of each role, and where networks see the points. Waits.
    void set_fixed(const CudaQueue& queue, [[maybe_unused]] const LandmarkRoles& roles) {
        [[maybe_unused]] const auto put = [&](DeviceBuffer<float>& to, const Columns<float>& a) {
            to.reserve(queue, static_cast<std::size_t>(a.size()) + 1);
            device_.send(queue, to.data(), a.data(),
                         static_cast<std::size_t>(a.size()) * sizeof(float));
        };
        if constexpr (has_effect<E, FaceDrivers>) {
            const auto marks = [&](int k, const std::vector<Index>& role) {
                const Columns<float> picked = pick_columns(host_->landmarks, role);
                require(picked.allFinite(), "DeviceFaceRest", "a landmark is not finite");
                put(landmarks_[k], picked);
                landmark_count_[k] = static_cast<int>(picked.cols());
            };
            if constexpr (has_effect<E, ReadsFaceRamp>) marks(0, roles.expression);
            for_eyes([&]<std::size_t eye>() {
                if constexpr (skin_follows<E, eye>) marks(1 + int(eye), roles.eye[eye]);
            });
        }
        if constexpr (face_rests<E>)
            if (&host_->seen() != &host_->position) put(anchor_, host_->anchor);
    }

    /// All that no frame changes: codes, features, influences, lists.
    template <class Of>
    void place_into(const CudaQueue& queue, const Of& of) {
        if constexpr (has_effect<E, FaceDrivers>) {
            const Index n = count(), feature = host_->feature.rows();
            const float* const seen = seen_at(of);
            code_.reserve(queue, numbers(encoded_size(3, config_.frequencies)));
            feature_.reserve(queue, numbers(feature));
            lambda_.reserve(queue, numbers(drivers));
            nearest_.reserve(queue, numbers(3));
            launch_each(device_, queue, 3 * n,
                        EncodeNumber{seen, 3, config_.frequencies, code_.data()});
            launch_each(device_, queue, feature * n,
                        TanhNumber{of(host_->feature).data, feature_.data()});
            if constexpr (has_effect<E, ReadsFaceRamp>)
                detail::with_metric<ExpressionInfluenceOf<E>>(config_, [&](const auto& metric) {
                    detail::with_metric<PoseInfluenceOf<E>>(config_, [&](const auto& rest) {
                        launch_each(device_, queue, n,
                                    InfluenceOfPoint{ramp(seen, 0), metric, rest,
                                                     lambda_of(ExpressionField{}),
                                                     lambda_of(PoseField{}), nearest(0)});
                    });
                });
            for_eyes([&]<std::size_t eye>() {
                if constexpr (skin_follows<E, eye>)
                    detail::with_metric<GazeInfluenceOf<E>>(config_, [&](const auto& metric) {
                        launch_each(
                            device_, queue, n,
                            InfluenceOfPoint{ramp(seen, 1 + int(eye)), metric, metric,
                                             lambda_of(GazeField<eye>{}),
                                             static_cast<float*>(nullptr), nearest(1 + int(eye))});
                    });
            });
            Array<const float*, DeviceListArrays::most> arrays{};
            for (int k = 0; k < drivers; ++k) arrays[std::size_t(k)] = lambda_.data() + k * n;
            lists_.make(queue, arrays, drivers, n);
        }
    }
    /// Waits for place_into. Whether its lists had room; where they had none they have now.
    bool finish(const CudaQueue& queue) { return make_room(listed(queue)); }
    /// Room for lists of those lengths, from the next frame on. Whether there was.
    bool make_room(const std::vector<std::uint32_t>& lengths) {
        bool fits = true;
        int k = 0;
        for (const Index need : lengths) {
            Index& room = room_[k++];
            if (need <= room) continue;
            fits = false;
            room = rye::min(count(), need + need / 4 + 64);
        }
        return fits;
    }
    /// Lengths of the lists on the device, and the room that there is for them.
    DeviceRooms rooms() const {
        DeviceRooms r{};
        if constexpr (has_effect<E, FaceDrivers>) {
            r.count = lists_.count(0);
            r.lists = drivers;
            for (int k = 0; k < drivers; ++k) r.room[k] = static_cast<std::uint32_t>(room_[k]);
        }
        return r;
    }
    /// Points that each driver that is on moves, in the order of for_face_fields. Waits.
    std::vector<std::uint32_t> listed(const CudaQueue& queue) const {
        std::vector<std::uint32_t> found(static_cast<std::size_t>(drivers));
        if constexpr (drivers > 0) lists_.fetch_counts(queue, found.data());
        return found;
    }

    /// Points that a driver moves, and their influence.
    template <class By>
    DeviceInfluenced set_of(By by) const {
        const int k = place(by);
        return {{lists_.list(k), lists_.count(k)}, room_[k], lambda_of(by)};
    }
    /// The points that gazes move.
    GazedPoints gazed() const {
        GazedPoints points{};
        [[maybe_unused]] int k = 0;
        for_eyes([&]<std::size_t eye>() {
            if constexpr (skin_follows<E, eye>) points.of[k++] = set_of(GazeField<eye>{});
        });
        return points;
    }
    /// Inputs of networks at all points: features after tanh, codes of places.
    DeviceColumns<float> features() const {
        return {feature_.data(), host_->feature.rows(), count()};
    }
    DeviceColumns<float> codes() const {
        return {code_.data(), encoded_size(3, config_.frequencies), count()};
    }
    /// The row of a driver that is on among rows of all of them; null of another.
    template <class By>
    float* row_of(const DeviceBuffer<float>& all, By by) const {
        constexpr bool on = std::same_as<By, ExpressionField> ? has_effect<E, Expression>
                            : std::same_as<By, PoseField>     ? has_effect<E, PoseResidual>
                                                              : true;
        return on ? all.data() + place(by) * count() : nullptr;
    }

    /// Adds the gradients of points and features, given the cotangents of codes and features, and
    /// of influences, a row a driver.
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of& of, const To& to, const float* g_code,
                  const float* g_feature, const DeviceBuffer<float>& g_lambda) {
        if (anchor_.size() == 0) { // an anchor is fixed
            float* const position = to(host_->position).data;
            launch_each(device_, queue, 3 * count(),
                        EncodeNumberVjp{code_.data(), g_code, 3, config_.frequencies, position});
            influences_vjp(queue, of(host_->position).data, g_lambda, position);
        }
        launch_each(device_, queue, features().size(),
                    TanhNumberVjp{feature_.data(), g_feature, to(host_->feature).data});
    }

    /// Memory that is held [bytes].
    std::size_t bytes() const {
        std::size_t sum = lists_.bytes() + code_.bytes() + feature_.bytes() + lambda_.bytes() +
                          nearest_.bytes() + anchor_.bytes();
        for (const auto& l : landmarks_) sum += l.bytes();
        return sum;
    }

  private:
    std::size_t numbers(Index rows) const { return static_cast<std::size_t>(rows * count()) + 1; }
    template <class Of>
    const float* seen_at(const Of& of) const {
        return anchor_.size() > 0 ? anchor_.data() : of(host_->position).data;
    }
    template <class By>
    float* lambda_of(By by) const {
        return row_of(lambda_, by);
    }
    int* nearest(int role) const { return nearest_.data() + role * count(); }
    DeviceLandmarks ramp(const float* seen, int role) const {
        const double near = role == 0 ? config_.exp_near : config_.gaze_near,
                     far = role == 0 ? config_.exp_far : config_.gaze_far;
        return {seen, landmarks_[role].data(), landmark_count_[role],
                checked_ramp(static_cast<float>(near), static_cast<float>(far))};
    }
    void influences_vjp(const CudaQueue& queue, const float* seen,
                        const DeviceBuffer<float>& g_lambda, float* g_points) {
        const auto pull = [&](const auto& metric, int role, const float* g, const float* g_rest) {
            launch_each(
                device_, queue, count(),
                InfluencePull{ramp(seen, role), metric, nearest(role), g, g_rest, g_points});
        };
        if constexpr (has_effect<E, ReadsFaceRamp>) {
            const float* const g = row_of(g_lambda, ExpressionField{});
            const float* const g_rest = row_of(g_lambda, PoseField{});
            detail::with_metric<ExpressionInfluenceOf<E>>(config_, [&](const auto& metric) {
                pull(metric, 0, g, one_face_metric<E> ? g_rest : nullptr);
            });
            if constexpr (!one_face_metric<E>)
                detail::with_metric<PoseInfluenceOf<E>>(
                    config_, [&](const auto& metric) { pull(metric, 0, nullptr, g_rest); });
        }
        for_eyes([&]<std::size_t eye>() {
            if constexpr (skin_follows<E, eye>)
                detail::with_metric<GazeInfluenceOf<E>>(config_, [&](const auto& metric) {
                    pull(metric, 1 + int(eye), row_of(g_lambda, GazeField<eye>{}), nullptr);
                });
        });
    }

    Device device_;
    AvatarConfig config_;
    const FaceStream<float, E>* host_;
    DeviceLists<Device> lists_;
    Index room_[DeviceListArrays::most] = {};
    DeviceBuffer<float> landmarks_[3], anchor_; ///< of the expression, of each eye
    int landmark_count_[3] = {};
    DeviceBuffer<int> nearest_;
    DeviceBuffer<float> code_, feature_, lambda_;
};

} // namespace rye::detail
