// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/fit_deformation.hpp: the fit of train/fit_deformation.hpp on a device: networks
/// and optimiser stay there, while the host draws the frames of later steps. Where the device
/// has graphs, a step is one graph. Sums have a fixed order: the same build gives the same bits.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include <rye/avatar/cuda/field.hpp>
#include <rye/backend/cuda/branches.hpp>
#include <rye/backend/cuda/graphs.hpp>
#include <rye/backend/cuda/resident.hpp>
#include <rye/nn/cuda/adam.hpp>
#include <rye/train/fit_deformation.hpp>

namespace rye {

namespace detail {

/// The networks that deform by expression and by gaze.
template <EffectSet E>
struct DeformationNetworks {
    using Network = NetworkOf<float, E>;
    [[no_unique_address]] Slot<E, Expression, Network, 1> exp_deform;
    [[no_unique_address]] SkinSlot<E, Network> gaze_deform;

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        if constexpr (has_effect<E, Expression>)
            nested_fields<Network>("exp_deform_mlp", f, p.exp_deform...);
        if constexpr (skin_follows<E, 0>)
            nested_fields<Network>("leftgaze_deform_mlp", f, of_eye<0>(p.gaze_deform)...);
        if constexpr (skin_follows<E, 1>)
            nested_fields<Network>("rightgaze_deform_mlp", f, of_eye<1>(p.gaze_deform)...);
    }
};

/// Calls f(ExpressionField{}), f(GazeField<0>{}), ... for those networks.
template <EffectSet E, class F>
void for_deformations(F&& f) {
    for_face_fields<E>([&](auto by) {
        if constexpr (!std::is_same_v<decltype(by), PoseField>) f(by);
    });
}

/// Takes a step's numbers from the host: those of its frames, and last its share of the learning
/// rate.
struct TakeFitStep {
    static constexpr const char* name = "fit, step";
    const float* draws;        ///< `size` numbers of each step
    const std::uint32_t* step; ///< number of the step among those sent
    Index size;
    float* to;
    DeviceAdamControl* control;

    RYE_DEVICE void operator()(Index i) const {
        const float x = draws[Index(*step) * size + i];
        to[i] = x;
        if (i + 1 == size) control->rate = double(x);
    }
};

/// Number i of the deformed landmarks: its cotangent, and its square error, summed.
struct FitLandmark {
    static constexpr const char* name = "fit, landmarks";
    static constexpr int sums = 1;
    const float *deformed, *observed;
    const float* of_landmark; ///< its weight, relative to the others
    float weight;             ///< twice the weight of a square in the loss
    float* g;

    template <class Sum>
    RYE_DEVICE void operator()(Index i, Sum& sum) const {
        const float off = deformed[i] - observed[i];
        g[i] = weight * of_landmark[i / 3] * off;
        sum[0] += off * off;
    }
};

/// Adds number i of the frames' gradients; keeps the frames' errors and counts the step.
struct EndFitStep {
    static constexpr const char* name = "fit, sum of frames";
    const float* each; ///< `size` numbers of each frame
    Index size;
    int frames;
    float* gradient;
    const float* squares; ///< of each frame
    float* kept;          ///< `frames` numbers of each step
    std::uint32_t* step;

    RYE_DEVICE void operator()(Index i) const {
        float sum = 0;
        for (int f = 0; f < frames; ++f) sum += each[f * size + i];
        gradient[i] = sum;
        if (i > 0) return;
        for (int f = 0; f < frames; ++f) kept[Index(*step) * frames + f] = squares[f];
        ++*step;
    }
};

} // namespace detail

/// The fit on a device.
template <EffectSet E, class Device, class Tiles>
class DeviceDeformationFit {
    using Mesh = GuidanceMesh<float, E>;
    using Networks = detail::DeformationNetworks<E>;
    using Frame = detail::FittedFrame<float, E>;
    using OneField = detail::DeviceField<Device, Tiles, typename detail::NetworksOf<E>::Activation>;

  public:
    /// Returns true if the networks fit the tiles.
    static bool fits(const Mesh& mesh) {
        bool all = true;
        detail::for_deformations<E>([&](auto by) {
            all = all && DeviceMlp<Device, Tiles>::fits(by.deform(mesh.networks).shape);
        });
        return all;
    }

    /// Keeps references to all arguments but the backend. Throws an Error unless the networks fit.
    template <Backend B>
    DeviceDeformationFit(const Device& device, const CudaQueue& queue, const B& backend,
                         const Mesh& mesh, const LandmarkStage& stage, const DeformationFit& fit)
        : device_(device),
          queue_(queue),
          stage_(stage),
          fit_(fit),
          landmarks_(mesh.landmarks.cols()),
          networks_(deformations_of(mesh)),
          layout_(networks_),
          parameters_(device, queue, layout_),
          gradient_(device, queue, layout_),
          adam_(device, queue, layout_) {
        GeometryTrace<float> geometry;
        detail::LandmarkPlaces<float, E> places;
        place_landmarks(backend, mesh, stage, geometry, places);
        code_rows_ = places.code.rows();
        send(places.shifted, shifted_);
        send(places.code, code_);
        send(detail::fit_weights(mesh.landmarks, stage.roles, fit), of_landmark_);
        numbers_of_frame_ = 3 * landmarks_;
        for_active([&](auto by) {
            if constexpr (std::is_same_v<decltype(by), ExpressionField>)
                set_influence(backend, places.ones, by.deform(influenced_));
            else
                set_influence(backend, by.influence(places.weights), by.deform(influenced_));
            by.deform(influenced_).code = numbers_of_frame_;
            numbers_of_frame_ += by.deform(networks_).shape.frame_inputs;
        });
        numbers_of_step_ = fit.batch * numbers_of_frame_ + 1;
        const auto reserve = [&](auto& buffer, Index n) {
            buffer.reserve(queue, static_cast<std::size_t>(n));
        };
        reserve(draws_, steps_at_once * numbers_of_step_);
        reserve(now_, numbers_of_step_);
        reserve(each_, fit.batch * layout_.size());
        reserve(squares_, fit.batch);
        reserve(kept_, Index(steps_at_once) * fit.batch);
        reserve(step_, 1);
        reserve(control_, 1);
        const detail::DeviceAdamControl whole{};
        device.send(queue, control_.data(), &whole, sizeof whole);
        for (int f = 0; f < fit.batch; ++f)
            lanes_.push_back(std::make_unique<Lane>(device, *this, f));
        parameters_.send(queue, networks_);
        adam_.send(queue, Adam<Networks>(networks_));
        adam_.set_rates(queue, [&](const std::string&) { return fit.rate; });
    }
    DeviceDeformationFit(const DeviceDeformationFit&) = delete;
    DeviceDeformationFit& operator=(const DeviceDeformationFit&) = delete;

    static constexpr int steps_at_once = 32; ///< whose frames are sent together

    /// Begins steps [begin, begin + count), at most steps_at_once, of fit.batch frames each.
    void begin(int begin, int count, const std::vector<Frame>& frames) {
        std::vector<float> numbers(static_cast<std::size_t>(count * numbers_of_step_));
        float* at = numbers.data();
        for (int i = 0; i < count; ++i) {
            for (int f = 0; f < fit_.batch; ++f)
                at = pack(frames[static_cast<std::size_t>(i * fit_.batch + f)], at);
            *at++ = static_cast<float>(detail::fit_rate_share(fit_, begin + i));
        }
        device_.send(queue_, draws_.data(), numbers.data(), numbers.size() * sizeof(float));
        device_.fill(queue_, step_.data(), 0, sizeof(std::uint32_t));
        for (int i = 0; i < count; ++i) graphs_.run(queue_, 0, 0, [&] { step(); });
    }
    /// Returns the sum of the squared errors of the landmarks' coordinates of each frame of the
    /// steps that were begun. Waits.
    std::vector<float> errors(int count) const {
        std::vector<float> all(static_cast<std::size_t>(count * fit_.batch));
        device_.fetch(queue_, all.data(), kept_.data(), all.size() * sizeof(float));
        return all;
    }
    /// Takes the networks as they are now into a mesh. Waits.
    void fetch(Mesh& mesh) {
        parameters_.fetch(queue_, networks_);
        detail::for_deformations<E>(
            [&](auto by) { by.deform(mesh.networks) = by.deform(networks_); });
    }

  private:
    /// Landmarks that a driver moves, and where its code begins in a frame's numbers.
    struct Influenced {
        DeviceBuffer<std::uint32_t> which;
        DeviceBuffer<float> lambda;
        Index count = 0, code = 0;

        detail::DeviceInfluenced set() const {
            return {{which.data(), nullptr}, count, lambda.data()};
        }
    };
    /// A frame of a step.
    struct Lane {
        Lane(const Device& device, const DeviceDeformationFit& fit, int number) : sums(device) {
            const auto gain = static_cast<float>(fit.stage_.config.deform_scale);
            fit.for_active([&](auto by) {
                if (by.deform(fit.influenced_).count > 0)
                    by.deform(fields) = std::make_unique<OneField>(
                        device, by.deform(fit.networks_).shape, Squash::tanh, gain, scratch);
            });
            for (auto* const b : {&deformed, &g})
                b->reserve(fit.queue_, static_cast<std::size_t>(3 * fit.landmarks_));
            g_lambda.reserve(fit.queue_, static_cast<std::size_t>(fit.landmarks_));
            device.fill(fit.queue_, g_lambda.data(), 0, g_lambda.bytes());
            numbers = fit.now_.data() + number * fit.numbers_of_frame_;
            gradient = fit.each_.data() + number * fit.layout_.size();
            square = fit.squares_.data() + number;
        }
        detail::DeviceFieldScratch scratch;
        detail::FaceFields<std::unique_ptr<OneField>, E> fields;
        DeviceBuffer<float> deformed, g;
        DeviceBuffer<float> g_lambda; ///< written by the fields, not read
        DeviceSums<Device> sums;
        const float* numbers;
        float *gradient, *square;
    };

    static Networks deformations_of(const Mesh& mesh) {
        Networks n;
        detail::for_deformations<E>([&](auto by) { by.deform(n) = by.deform(mesh.networks); });
        return n;
    }
    /// Calls f for the drivers that move landmarks.
    template <class F>
    void for_active(const F& f) const {
        detail::for_deformations<E>([&](auto by) {
            if (std::is_same_v<decltype(by), ExpressionField> || stage_.landmarks_follow_gaze)
                f(by);
        });
    }
    void send(const Columns<float>& from, DeviceBuffer<float>& to) {
        to.reserve(queue_, static_cast<std::size_t>(from.size()) + 4);
        device_.send(queue_, to.data(), from.data(),
                     static_cast<std::size_t>(from.size()) * sizeof(float));
    }
    template <Backend B>
    void set_influence(const B& backend, const Columns<float>& lambda, Influenced& to) {
        send(lambda, to.lambda);
        const std::vector<Index> set = detail::influenced(backend, lambda);
        const std::vector<std::uint32_t> which(set.begin(), set.end());
        to.count = static_cast<Index>(which.size());
        to.which.reserve(queue_, which.size() + 1);
        device_.send(queue_, to.which.data(), which.data(), which.size() * sizeof(std::uint32_t));
    }
    float* pack(const Frame& frame, float* to) const {
        const Columns<float>& seen = frame.shown().landmarks;
        to = std::copy_n(seen.data(), seen.size(), to);
        for_active([&](auto by) {
            const VecX<float>& code = by.code(frame.code);
            to = std::copy_n(code.data(), code.size(), to);
        });
        return to;
    }

    /// Puts a step on the stream.
    void step() {
        launch_each(device_, queue_, numbers_of_step_,
                    detail::TakeFitStep{draws_.data(), step_.data(), numbers_of_step_, now_.data(),
                                        control_.data()});
        branches_.run(queue_, lanes_.size(),
                      [&](std::size_t f, const CudaQueue& queue) { frame(*lanes_[f], queue); });
        launch_each(device_, queue_, layout_.size(),
                    detail::EndFitStep{each_.data(), layout_.size(), fit_.batch, gradient_.data(),
                                       squares_.data(), kept_.data(), step_.data()});
        adam_.step_into(queue_, parameters_, gradient_, control_.data());
    }
    void frame(Lane& lane, const CudaQueue& queue) {
        const Index numbers = 3 * landmarks_;
        const DeviceColumns<float> deformed{lane.deformed.data(), 3, landmarks_},
            g{lane.g.data(), 3, landmarks_};
        const auto with = [&](float* base) {
            return [this, base](const Columns<float>& a) {
                const auto& s = layout_.of(a);
                return DeviceColumns<float>{base + s.offset, s.rows, s.cols};
            };
        };
        const auto each = [&](const auto& f) {
            for_active([&](auto by) {
                if (auto& field = by.deform(lane.fields)) f(by, *field);
            });
        };
        device_.fill(queue, lane.gradient, 0,
                     static_cast<std::size_t>(layout_.size()) * sizeof(float));
        launch_each(device_, queue, numbers, detail::CopyNumbers{shifted_.data(), deformed.data});
        each([&](auto by, OneField& field) {
            const auto& moved = by.deform(influenced_);
            field.set(queue, device_parameters(by.deform(networks_), with(parameters_.data())),
                      lane.numbers + moved.code);
            field.add_into(queue, {code_.data(), code_rows_, landmarks_}, moved.set(), deformed,
                           true);
        });
        const auto weight = static_cast<float>(2.0 / fit_.batch / static_cast<double>(numbers));
        lane.sums.launch(
            queue, numbers,
            detail::FitLandmark{deformed.data, lane.numbers, of_landmark_.data(), weight, g.data},
            {lane.square});
        each([&](auto by, OneField& field) {
            field.vjp_into(queue, g,
                           {device_parameters(by.deform(networks_), with(lane.gradient)),
                            {},
                            lane.g_lambda.data(),
                            nullptr});
        });
    }

    Device device_;
    CudaQueue queue_;
    const LandmarkStage& stage_;
    const DeformationFit& fit_;
    Index landmarks_, code_rows_ = 0;
    Index numbers_of_frame_ = 0; ///< landmarks, and codes of the drivers
    Index numbers_of_step_ = 0;  ///< of its frames, and its share of the learning rate
    Networks networks_;
    ResidentLayout<Networks> layout_;
    Resident<Networks, Device> parameters_, gradient_;
    DeviceAdam<Networks, Device> adam_;
    DeviceBuffer<float> shifted_, code_, of_landmark_;
    detail::FaceFields<Influenced, E> influenced_;
    DeviceBuffer<float> draws_, now_, each_, squares_, kept_;
    DeviceBuffer<std::uint32_t> step_;
    DeviceBuffer<detail::DeviceAdamControl> control_;
    DeviceBranches<Device> branches_; // frames have memory that goes back through them
    std::vector<std::unique_ptr<Lane>> lanes_;
    detail::KeptGraphs<Device, int, int> graphs_;
};

/// Does what fit_deformation does with networks and optimiser on a device. Throws an Error unless
/// DeviceDeformationFit::fits(mesh).
template <class Tiles, class Device, EffectSet E, Backend B>
double fit_deformation_on(const Device& device, const CudaQueue& queue, const B& backend,
                          GuidanceMesh<float, E>& mesh, const LandmarkStage& stage,
                          const std::vector<MeshSample<float, E>>& frames,
                          const DeformationFit& fit) {
    using On = DeviceDeformationFit<E, Device, Tiles>;
    const detail::FittedFrames<float, E> drawn(backend, mesh.landmarks, stage, frames, fit);
    std::vector<detail::FittedFrame<float, E>> now(
        static_cast<std::size_t>(On::steps_at_once * fit.batch));
    auto next = now;
    const auto draw = [&](int begin, auto& to) {
        const int count = std::clamp(fit.steps - begin, 0, On::steps_at_once);
        backend.threads.run(Index(count) * fit.batch, [&](Index i) {
            drawn.draw(begin + static_cast<int>(i / fit.batch), i % fit.batch,
                       to[static_cast<std::size_t>(i)]);
        });
        return count;
    };
    On on(device, queue, backend, mesh, stage, fit);
    double squares = 0, seen = 0;
    int count = draw(0, now);
    for (int begin = 0; begin < fit.steps; begin += On::steps_at_once) {
        on.begin(begin, count, now);
        const int later = draw(begin + On::steps_at_once, next); // meanwhile
        const std::vector<float> errors = on.errors(count);
        for (std::size_t i = 0; i < errors.size(); ++i)
            if (!now[i].mixed() && drawn.reported(begin + static_cast<int>(i) / fit.batch)) {
                squares += static_cast<double>(errors[i]);
                ++seen;
            }
        now.swap(next);
        count = later;
    }
    on.fetch(mesh);
    const auto numbers = static_cast<double>(mesh.landmarks.size());
    return seen > 0 ? std::sqrt(squares / (seen * numbers)) : 0.0;
}

} // namespace rye
