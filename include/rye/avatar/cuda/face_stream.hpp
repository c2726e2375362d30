// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/face_stream.hpp: the driven face (avatar/face_stream.hpp) in device memory:
/// networks over the points that each driver moves, and what every point does after them; with its
/// vjp to all parameters and to the frame's codes.
#pragma once

#include <memory>

#include <rye/avatar/cuda/eye_lids.hpp>
#include <rye/avatar/cuda/face_rest.hpp>
#include <rye/avatar/two_stream.hpp>
#include <rye/backend/cuda/branches.hpp>

namespace rye {

namespace detail {

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
    DeviceLidPoints lids = {}; ///< of the eyes' lids, with their cotangents
};

} // namespace detail

/// The face of an avatar on a device. Parameters lie elsewhere: `of` gives where each array of the
/// host's struct, which must stay where it is, lies in device memory, as Resident::of does.
template <DeviceEffects E, class Device, class Networks = DeviceNetworks<1>>
class DeviceFaceStream {
    using A = typename detail::NetworksOf<E>::Activation;
    using FeatureField = detail::DeviceField<Device, typename Networks::OfFeatures, A>;
    using PositionField = detail::DeviceField<Device, typename Networks::OfPositions, A>;

  public:
    /// Throws an Error for networks that do not fit the tiles.
    DeviceFaceStream(const Device& device, const AvatarConfig& config,
                     const FaceStream<float, E>& host, detail::DeviceFieldScratch& scratch)
        : device_(device),
          config_(config),
          host_(&host),
          codes_(config),
          rest_(device, config, host),
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
    /// All that follows from the parameters and not from a frame.
    detail::DeviceFaceRest<E, Device>& rest() { return rest_; }
    const detail::DeviceFaceRest<E, Device>& rest() const { return rest_; }

    /// Takes the networks' weights and the frame's codes, and makes what follows from the
    /// parameters and not from a frame: codes of points, features, influences, lists.
    template <class Of>
    void set(const CudaQueue& queue, const Of& of, const float* codes) {
        branches_.run(queue, kinds + 1, [&](std::size_t k, const CudaQueue& q) {
            if (k == kinds) return rest_.place_into(q, of);
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

    /// Puts the driven face into `to`, in the world: N columns. place_into has been.
    template <class Of>
    void drive_into(const CudaQueue& queue, const Of& of, const detail::DeviceFaceFrame& frame,
                    const DeviceGaussians<float>& to, bool keep) {
        const Index n = count();
        if constexpr (has_effect<E, ReadsFaceRamp>) steps_.reserve(queue, numbers(8));
        branches_.run(queue, kinds, [&](std::size_t k, const CudaQueue& q) {
            DeviceColumns<float> sum = to.mean;
            if (k == of_colours) {
                sum = to.feature;
                if constexpr (face_rests<E>)
                    launch_each(device_, q, sum.size(),
                                detail::CopyNumbers{of(host_->rest_color).data, sum.data});
                else
                    device_.fill(q, sum.data, 0, bytes_of(sum.size()));
            } else if (k == of_places) {
                launch_each(device_, q, 3 * n,
                            detail::CopyNumbers{of(host_->position).data, sum.data});
            } else if constexpr (has_effect<E, ReadsFaceRamp>) {
                sum = {steps_.data(), 8, n};
                device_.fill(q, sum.data, 0, bytes_of(sum.size()));
            }
            for_fields_of(k, [&](auto by, auto& field, const auto&) {
                field.add_into(q, k == of_places ? rest_.codes() : rest_.features(),
                               rest_.set_of(by), sum, keep);
            });
        });
        launch_each(device_, queue, n,
                    detail::FinishFacePoint<E>{arrays_at(of), steps_.data(), to, frame.state});
    }

    /// Redoes what gazes move of the face in `to`, after a drive_into of the same parameters, and
    /// of the same frame but for the gazes: runs their networks, and sums means and features of
    /// the points on their lists. Not for a vjp.
    template <class Of>
    void regaze_into([[maybe_unused]] const CudaQueue& queue, [[maybe_unused]] const Of& of,
                     [[maybe_unused]] const detail::DeviceFrameState* frame,
                     [[maybe_unused]] const DeviceGaussians<float>& to) {
        if constexpr (gazes > 0) {
            branches_.run(queue, 2 * gazes, [&](std::size_t k, const CudaQueue& q) {
                const std::size_t kind = k / gazes;
                std::size_t gaze = 0;
                for_fields_of(
                    kind, [&]<class By>([[maybe_unused]] By by, auto& field, const auto&) {
                        if constexpr (detail::of_gaze<By>)
                            if (gaze++ == k % gazes) {
                                field.set_frame(q);
                                field.evaluate_into(
                                    q, kind == of_places ? rest_.codes() : rest_.features(),
                                    rest_.set_of(by), false);
                            }
                    });
            });
            const detail::GazedPoints points = rest_.gazed();
            branches_.run(queue, 2, [&](std::size_t kind, const CudaQueue& q) {
                if (kind == of_places)
                    return launch_each(
                        device_, q, points.count(),
                        detail::GazedMean<E, drivers>{points, fields_sum(kind, of(host_->position)),
                                                      to.mean.data, frame});
                DeviceColumns<const float> before{nullptr, to.feature.rows, count()};
                if constexpr (face_rests<E>) before = of(host_->rest_color);
                launch_each(device_, q, points.count() * before.rows,
                            detail::GazedFeature<drivers>{points, fields_sum(kind, before),
                                                          to.feature.data});
            });
        }
    }

    /// Adds the gradients of the last drive_into, which kept what is read here, to arrays that
    /// `to` gives as `of` gives the parameters'. Consumes the cotangents.
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of& of, const To& to,
                  const detail::DeviceFaceFrame& frame,
                  const detail::DeviceFaceCotangent& cotangent) {
        const Index n = count();
        const DeviceGaussians<float>& g = cotangent.g;
        if constexpr (has_effect<E, ReadsFaceRamp>) g_steps_.reserve(queue, numbers(8));
        sums_.launch(
            queue, n,
            detail::FacePointVjp<E>{arrays_at(of), arrays_at(to), steps_.data(), g_steps_.data(),
                                    cotangent.world, g, frame.state, rest_.rooms()},
            {cotangent.head});
        if (cotangent.lids.count > 0)
            launch_each(device_, queue, 2, detail::AddLidPoints{cotangent.lids, g.mean.data});
        if constexpr (face_rests<E>)
            launch_each(device_, queue, g.feature.size(),
                        detail::AddNumbers{g.feature.data, to(host_->rest_color).data});
        if constexpr (has_effect<E, FaceDrivers>) fields_vjp(queue, of, to, frame, g);
    }

    /// Memory that is held, without what is shared [bytes].
    std::size_t bytes() const {
        std::size_t sum = rest_.bytes() + sums_.bytes() + steps_.bytes() + g_steps_.bytes() +
                          g_code_.bytes() + g_feature_.bytes() + g_lambda_.bytes() +
                          g_beside_.bytes() + beside_scratch_.bytes();
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

    static constexpr int drivers = detail::DeviceFaceRest<E, Device>::drivers;
    static constexpr std::size_t gazes = detail::DeviceFaceRest<E, Device>::gazes;

    std::size_t numbers(Index rows) const { return static_cast<std::size_t>(rows * count()) + 1; }
    static std::size_t bytes_of(Index n) { return static_cast<std::size_t>(n) * sizeof(float); }
    template <class Of>
    detail::DeviceFaceArrays arrays_at(const Of& of) const {
        return {of(host_->position).data, of(host_->log_scale).data, of(host_->rotation).data,
                of(host_->opacity_logit).data};
    }
    /// The fields of a kind as regaze_into finds them: those of the gazes were evaluated, others
    /// added before.
    detail::FieldsSum<drivers> fields_sum(std::size_t kind,
                                          const DeviceColumns<const float>& before) {
        detail::FieldsSum<drivers> sum{before.data, before.rows, {}};
        int k = 0;
        for_fields_of(kind, [&]<class By>(By, auto& field, const auto&) {
            sum.of[k++] = detail::of_gaze<By> ? field.evaluated() : field.added();
        });
        return sum;
    }
    /// Returns the destination of the cotangent of a driver's code; null if it trains nothing.
    template <class By>
    float* g_code_of(const detail::DeviceFaceFrame& frame, By by) const {
        constexpr bool trained =
            std::same_as<By, PoseField> || (detail::of_gaze<By> && has_effect<E, Kappa>);
        return trained ? frame.g_codes + codes_.of(by) : nullptr;
    }

    template <class Of, class To>
    void fields_vjp(const CudaQueue& queue, const Of& of, const To& to,
                    const detail::DeviceFaceFrame& frame, const DeviceGaussians<float>& g) {
        const Index n = count();
        const auto zeroed = [&](DeviceBuffer<float>& b, Index rows) -> DeviceColumns<float> {
            b.reserve(queue, numbers(rows));
            device_.fill(queue, b.data(), 0, bytes_of(rows * n));
            return {b.data(), rows, n};
        };
        const DeviceColumns<float> g_feature = zeroed(g_feature_, host_->feature.rows()),
                                   g_code = zeroed(g_code_, rest_.codes().rows);
        zeroed(g_lambda_, drivers);
        // Displacements go beside the others, which share the features' cotangent, and have sums of
        // their own of what both add to.
        const Index lambdas = drivers * n;
        g_beside_.reserve(queue, numbers(drivers) + static_cast<std::size_t>(codes_.size));
        device_.fill(queue, g_beside_.data(), 0, bytes_of(lambdas + codes_.size));
        detail::DeviceFaceFrame beside = frame;
        beside.g_codes = g_beside_.data() + lambdas;
        branches_.run(queue, 2, [&](std::size_t k, const CudaQueue& q) {
            const auto pull = [&](std::size_t kind, const DeviceColumns<const float>& of_sum) {
                for_fields_of(kind, [&](auto by, auto& field, const Mlp<float, A>& host) {
                    field.vjp_into(q, of_sum,
                                   {device_parameters(host, to), k == 1 ? g_code : g_feature,
                                    rest_.row_of(k == 1 ? g_beside_ : g_lambda_, by),
                                    g_code_of(k == 1 ? beside : frame, by)});
                });
            };
            if (k == 1) return pull(of_places, g.mean);
            pull(of_colours, g.feature);
            pull(of_attributes, {g_steps_.data(), 8, n});
        });
        launch_each(device_, queue, lambdas,
                    detail::AddNumbers{g_beside_.data(), g_lambda_.data()});
        launch_each(device_, queue, codes_.size, detail::AddNumbers{beside.g_codes, frame.g_codes});
        rest_.vjp_into(queue, of, to, g_code_.data(), g_feature_.data(), g_lambda_);
    }

    Device device_;
    DeviceBranches<Device> branches_;
    AvatarConfig config_;
    const FaceStream<float, E>* host_;
    detail::CodePlaces<E> codes_;
    detail::FaceFields<std::unique_ptr<FeatureField>, E> color_;
    detail::FaceFields<std::unique_ptr<PositionField>, E> deform_;
    detail::AttributeFields<std::unique_ptr<FeatureField>, E> attribute_;
    detail::DeviceFaceRest<E, Device> rest_;
    DeviceSums<Device> sums_;
    DeviceBuffer<float> steps_, g_code_, g_feature_, g_lambda_, g_steps_;
    detail::DeviceFieldScratch beside_scratch_; ///< of displacements
    DeviceBuffer<float> g_beside_;      ///< what they add to influences and to codes
};

} // namespace rye
