// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/face_stream.hpp: the driven face (avatar/face_stream.hpp) in device memory:
/// influences and lists of the points that each driver moves, networks over those points, and what
/// every point does after them; with its vjp to all parameters and to the frame's codes.
#pragma once

#include <memory>

#include <rye/avatar/cuda/face_points.hpp>
#include <rye/avatar/cuda/field.hpp>
#include <rye/avatar/two_stream.hpp>
#include <rye/backend/cuda/branches.hpp>
#include <rye/backend/cuda/lists.hpp>
#include <rye/nn/cuda/encoding.hpp>
#include <rye/rig/cuda/influence.hpp>

namespace rye {

/// A frame's numbers and the cotangents of its codes, as a face reads and adds to them.
struct DeviceFaceFrame {
    const float* codes;
    float* g_codes; ///< added to, or null
    const DeviceFrameState* state;
};

/// Cotangents of the driven face in the world, which the vjp consumes, and what it gives.
struct DeviceFaceCotangent {
    DeviceGaussians<float> world, g;
    float* head; ///< head_sums numbers, overwritten
};

/// The face of an avatar on a device. Parameters lie elsewhere: `of` gives where each array of the
/// host's struct, which must stay where it is, lies in device memory, as Resident::of does.
template <DeviceEffects E, class Device, class Networks = DeviceNetworks<1>>
class DeviceFaceStream {
    using A = typename NetworksOf<E>::Activation;
    using FeatureField = DeviceField<Device, typename Networks::OfFeatures, A>;
    using PositionField = DeviceField<Device, typename Networks::OfPositions, A>;

  public:
    /// Throws an Error for networks that do not fit the tiles.
    DeviceFaceStream(const Device& device, const AvatarConfig& config,
                     const FaceStream<float, E>& host, DeviceFieldScratch& scratch)
        : device_(device),
          config_(config),
          host_(&host),
          codes_(config),
          lists_(device),
          sums_(device) {
        for_face_fields<E>([&](auto by) {
            by.color(color_) = std::make_unique<FeatureField>(device, by.color(host.networks).shape,
                                                              Squash::none, 1.0F, scratch);
            by.deform(deform_) = std::make_unique<PositionField>(
                device, by.deform(host.networks).shape, Squash::tanh,
                static_cast<float>(config.deform_scale), beside_scratch_);
            if constexpr (by.attributes)
                by.attribute(attribute_) = std::make_unique<FeatureField>(
                    device, by.attribute(host).shape, Squash::none,
                    static_cast<float>(config.attribute_scale), scratch);
        });
    }

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
                require(picked.allFinite(), "DeviceFaceStream", "a landmark is not finite");
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

    /// Takes the networks' weights and the frame's codes, and makes what follows from the
    /// parameters and not from a frame: codes of points, features, influences, lists.
    template <class Of>
    void set(const CudaQueue& queue, const Of& of, const float* codes) {
        branches_.run(queue, kinds + 1, [&](std::size_t k, const CudaQueue& q) {
            if (k == kinds) return place_into(q, of);
            for_fields_of(k, [&](auto by, auto& field, const Mlp<float, A>& host) {
                field.set(q, device_parameters(host, of), codes + codes_.of(by));
            });
        });
    }
    /// The frame's codes have changed, and nothing else.
    void set_frame(const CudaQueue& queue) {
        for (std::size_t k = 0; k < kinds; ++k)
            for_fields_of(k, [&](auto, auto& field, const auto&) { field.set_frame(queue); });
    }

    /// What follows from the parameters and not from a frame: codes, features, influences, lists.
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

    /// Puts the driven face into `to`, in the world: N columns. place_into has been.
    template <class Of>
    void drive_into(const CudaQueue& queue, const Of& of, const DeviceFaceFrame& frame,
                    const DeviceGaussians<float>& to, bool keep) {
        const Index n = count();
        if constexpr (has_effect<E, ReadsFaceRamp>) steps_.reserve(queue, numbers(8));
        branches_.run(queue, kinds, [&](std::size_t k, const CudaQueue& q) {
            DeviceColumns<float> sum = to.mean;
            if (k == of_colours) {
                sum = to.feature;
                if constexpr (face_rests<E>)
                    launch_each(device_, q, sum.size(),
                                CopyNumbers{of(host_->rest_color).data, sum.data});
                else
                    device_.fill(q, sum.data, 0, bytes_of(sum.size()));
            } else if (k == of_places) {
                launch_each(device_, q, 3 * n, CopyNumbers{of(host_->position).data, sum.data});
            } else if constexpr (has_effect<E, ReadsFaceRamp>) {
                sum = {steps_.data(), 8, n};
                device_.fill(q, sum.data, 0, bytes_of(sum.size()));
            }
            for_fields_of(k, [&](auto by, auto& field, const auto&) {
                field.add_into(q, k == of_places ? codes() : features(), set_of(by), sum, keep);
            });
        });
        launch_each(device_, queue, n,
                    FinishFacePoint<E>{arrays_at(of), steps_.data(), to, frame.state});
    }

    /// Adds the gradients of the last drive_into, which kept what is read here, to arrays that
    /// `to` gives as `of` gives the parameters'. Consumes the cotangents.
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of& of, const To& to, const DeviceFaceFrame& frame,
                  const DeviceFaceCotangent& cotangent) {
        const Index n = count();
        const DeviceGaussians<float>& g = cotangent.g;
        if constexpr (has_effect<E, ReadsFaceRamp>) g_steps_.reserve(queue, numbers(8));
        sums_.launch(queue, n,
                     FacePointVjp<E>{arrays_at(of), arrays_at(to), steps_.data(), g_steps_.data(),
                                     cotangent.world, g, frame.state, rooms()},
                     {cotangent.head});
        if constexpr (face_rests<E>)
            launch_each(device_, queue, g.feature.size(),
                        AddNumbers{g.feature.data, to(host_->rest_color).data});
        if constexpr (has_effect<E, FaceDrivers>) fields_vjp(queue, of, to, frame, g);
    }

    /// Memory that is held, without what is shared [bytes].
    std::size_t bytes() const {
        std::size_t sum = lists_.bytes() + sums_.bytes() + code_.bytes() + feature_.bytes() +
                          lambda_.bytes() + nearest_.bytes() + steps_.bytes() + g_steps_.bytes() +
                          g_code_.bytes() + g_feature_.bytes() + g_lambda_.bytes() +
                          g_beside_.bytes() + beside_scratch_.bytes() + anchor_.bytes();
        for (const auto& l : landmarks_) sum += l.bytes();
        for_face_fields<E>([&](auto by) {
            sum += by.color(color_)->bytes() + by.deform(deform_)->bytes();
            if constexpr (by.attributes) sum += by.attribute(attribute_)->bytes();
        });
        return sum;
    }

  private:
    /// Kinds of fields: each adds to a sum of its own.
    static constexpr std::size_t of_colours = 0, of_places = 1, of_attributes = 2, kinds = 3;
    /// f(driver, field, the host's network) for all fields of a kind.
    template <class F>
    void for_fields_of(std::size_t kind, const F& f) {
        for_face_fields<E>([&](auto by) {
            if (kind == of_colours) f(by, *by.color(color_), by.color(host_->networks));
            if (kind == of_places) f(by, *by.deform(deform_), by.deform(host_->networks));
            if constexpr (by.attributes)
                if (kind == of_attributes) f(by, *by.attribute(attribute_), by.attribute(*host_));
        });
    }

    static constexpr int place(ExpressionField) { return 0; }
    static constexpr int place(PoseField) { return has_effect<E, Expression> ? 1 : 0; }
    template <std::size_t eye>
    static constexpr int place(GazeField<eye>) {
        return place(PoseField{}) + (has_effect<E, PoseResidual> ? 1 : 0) +
               (eye == 1 && skin_follows<E, 0> ? 1 : 0);
    }
    static constexpr int drivers = place(GazeField<1>{}) + (skin_follows<E, 1> ? 1 : 0);

    std::size_t numbers(Index rows) const { return static_cast<std::size_t>(rows * count()) + 1; }
    static std::size_t bytes_of(Index n) { return static_cast<std::size_t>(n) * sizeof(float); }
    template <class Of>
    const float* seen_at(const Of& of) const {
        return anchor_.size() > 0 ? anchor_.data() : of(host_->position).data;
    }
    template <class Of>
    DeviceFaceArrays arrays_at(const Of& of) const {
        return {of(host_->position).data, of(host_->log_scale).data, of(host_->rotation).data,
                of(host_->opacity_logit).data};
    }
    /// Of a driver that is on; null of another.
    template <class By>
    float* row_of(const DeviceBuffer<float>& all, By by) const {
        constexpr bool on = std::same_as<By, ExpressionField> ? has_effect<E, Expression>
                            : std::same_as<By, PoseField>     ? has_effect<E, PoseResidual>
                                                              : true;
        return on ? all.data() + place(by) * count() : nullptr;
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
    template <class By>
    DeviceInfluenced set_of(By by) const {
        const int k = place(by);
        return {{lists_.list(k), lists_.count(k)}, room_[k], lambda_of(by)};
    }
    DeviceColumns<float> features() const {
        return {feature_.data(), host_->feature.rows(), count()};
    }
    DeviceColumns<float> codes() const {
        return {code_.data(), encoded_size(3, config_.frequencies), count()};
    }
    /// Where the cotangent of a driver's code goes, if it leads to something that is trained.
    template <class By>
    float* g_code_of(const DeviceFaceFrame& frame, By by) const {
        constexpr bool trained = std::same_as<By, PoseField> ||
                                 (!std::same_as<By, ExpressionField> && has_effect<E, Kappa>);
        return trained ? frame.g_codes + codes_.of(by) : nullptr;
    }

    template <class Of, class To>
    void fields_vjp(const CudaQueue& queue, const Of& of, const To& to,
                    const DeviceFaceFrame& frame, const DeviceGaussians<float>& g) {
        const Index n = count();
        const auto zeroed = [&](DeviceBuffer<float>& b, Index rows) -> DeviceColumns<float> {
            b.reserve(queue, numbers(rows));
            device_.fill(queue, b.data(), 0, bytes_of(rows * n));
            return {b.data(), rows, n};
        };
        const DeviceColumns<float> g_feature = zeroed(g_feature_, host_->feature.rows()),
                                   g_code = zeroed(g_code_, codes().rows);
        zeroed(g_lambda_, drivers);
        // Displacements go beside the others, which share the features' cotangent, and have sums of
        // their own of what both add to.
        const Index lambdas = drivers * n;
        g_beside_.reserve(queue, numbers(drivers) + static_cast<std::size_t>(codes_.size));
        device_.fill(queue, g_beside_.data(), 0, bytes_of(lambdas + codes_.size));
        DeviceFaceFrame beside = frame;
        beside.g_codes = g_beside_.data() + lambdas;
        branches_.run(queue, 2, [&](std::size_t k, const CudaQueue& q) {
            const auto pull = [&](std::size_t kind, const DeviceColumns<const float>& of_sum) {
                for_fields_of(kind, [&](auto by, auto& field, const Mlp<float, A>& host) {
                    field.vjp_into(q, of_sum,
                                   {device_parameters(host, to), k == 1 ? g_code : g_feature,
                                    row_of(k == 1 ? g_beside_ : g_lambda_, by),
                                    g_code_of(k == 1 ? beside : frame, by)});
                });
            };
            if (k == 1) return pull(of_places, g.mean);
            pull(of_colours, g.feature);
            pull(of_attributes, {g_steps_.data(), 8, n});
        });
        launch_each(device_, queue, lambdas, AddNumbers{g_beside_.data(), g_lambda_.data()});
        launch_each(device_, queue, codes_.size, AddNumbers{beside.g_codes, frame.g_codes});
        if (anchor_.size() == 0) { // an anchor is fixed
            float* const position = to(host_->position).data;
            launch_each(
                device_, queue, 3 * n,
                EncodeNumberVjp{code_.data(), g_code_.data(), 3, config_.frequencies, position});
            influences_vjp(queue, of(host_->position).data, position);
        }
        launch_each(device_, queue, g_feature.size(),
                    TanhNumberVjp{feature_.data(), g_feature_.data(), to(host_->feature).data});
    }
    void influences_vjp(const CudaQueue& queue, const float* seen, float* g_points) {
        const auto pull = [&](const auto& metric, int role, const float* g, const float* g_rest) {
            launch_each(
                device_, queue, count(),
                InfluencePull{ramp(seen, role), metric, nearest(role), g, g_rest, g_points});
        };
        if constexpr (has_effect<E, ReadsFaceRamp>) {
            const float *const g = row_of(g_lambda_, ExpressionField{}), *const g_rest =
                                                                             row_of(g_lambda_,
                                                                                    PoseField{});
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
                    pull(metric, 1 + int(eye), row_of(g_lambda_, GazeField<eye>{}), nullptr);
                });
        });
    }

    Device device_;
    DeviceBranches<Device> branches_;
    AvatarConfig config_;
    const FaceStream<float, E>* host_;
    CodePlaces<E> codes_;
    FaceFields<std::unique_ptr<FeatureField>, E> color_;
    FaceFields<std::unique_ptr<PositionField>, E> deform_;
    AttributeFields<std::unique_ptr<FeatureField>, E> attribute_;
    DeviceLists<Device> lists_;
    DeviceSums<Device> sums_;
    Index room_[DeviceListArrays::most] = {};
    DeviceBuffer<float> landmarks_[3], anchor_; ///< of the expression, of each eye
    int landmark_count_[3] = {};
    DeviceBuffer<int> nearest_;
    DeviceBuffer<float> code_, feature_, lambda_, steps_;
    DeviceBuffer<float> g_code_, g_feature_, g_lambda_, g_steps_;
    DeviceFieldScratch beside_scratch_; ///< of displacements
    DeviceBuffer<float> g_beside_;      ///< what they add to influences and to codes
};

} // namespace rye
