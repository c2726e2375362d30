// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/avatar_trainer.hpp: stage 2 on a device: the steps of train/avatar_trainer.hpp,
/// with avatar, optimiser and pictures in device memory.
///     DeviceAvatarTrainer<E, CudaDevice> trainer(device, queue, {avatar, adam}, training, loss);
///     for (...) trainer.add(queue, view, drivers);
///     const DeviceStepsReport r = trainer.run(queue, draws);  // waits once
///     trainer.fetch(queue, avatar, adam);                     // as checkpoints have them
/// If the device has graphs, steps of one camera are one graph. Sums have a fixed order: the same
/// build gives the same bits for any division of the steps into runs.
#pragma once

#include <memory>
#include <string>
#include <tuple>
#include <vector>

#include <rye/avatar/cuda/two_stream.hpp>
#include <rye/backend/cuda/branches.hpp>
#include <rye/backend/cuda/graphs.hpp>
#include <rye/nn/cuda/upsampler.hpp>
#include <rye/splat/cuda/rasterizer.hpp>
#include <rye/train/avatar_trainer.hpp>
#include <rye/train/cuda/centring.hpp>
#include <rye/train/cuda/image_losses.hpp>
#include <rye/train/cuda/smoothness_terms.hpp>
#include <rye/train/cuda/step_images.hpp>
#include <rye/train/cuda/step_rows.hpp>
#include <rye/train/cuda/step_sums.hpp>
#include <rye/train/cuda/trainer_policy.hpp>

namespace rye {

/// Avatar and optimiser on the host.
template <EffectSet E>
struct AvatarAndAdam {
    const TwoStream<float, E>& avatar;
    const Adam<TwoStream<float, E>>& adam;
};

/// Training of an avatar whose parameters and moments stay on the device until they are fetched.
template <DeviceEffects E, class Device, class Policy = DeviceTrainerPolicy<>,
          class Perceptual = DevicePyramidLoss<Device>>
class DeviceAvatarTrainer {
    using Host = TwoStream<float, E>;

  public:
    /// Copies its arguments to the device; waits. Ignores the parts of `training` that a device
    /// computes by Policy and Perceptual (accuracy, perceptual term). Throws an Error for sizes
    /// that do not fit.
    template <class A, class P, class Rates>
    DeviceAvatarTrainer(const Device& device, const CudaQueue& queue, const AvatarAndAdam<E>& from,
                        const AvatarTraining<A, P, Rates>& training, Perceptual& perceptual)
        : device_(device),
          weights_(training.objective.weights),
          avatar_(device, queue, {from.avatar, training.config, training.roles}),
          gradient_(device, queue, avatar_.layout()),
          adam_(device, queue, avatar_.layout(), from.adam.config),
          upsampler_(device, from.avatar.upsampler.shape),
          views_(device, 1 << from.avatar.upsampler.shape.doublings),
          losses_(device, weights_, perceptual),
          smoothness_(device),
          channels_(from.avatar.upsampler.shape.in_channels),
          centring_(device, queue, from.avatar, training),
          sums_(device),
          rows_(device) {
        upsampler_.keep_planes = true;
        for (auto& f : frame_) f = std::make_unique<DeviceFrame<Device>>(device);
        adam_.send(queue, from.adam);
        adam_.set_rates(queue, training.rates);
        const auto put = [&](DeviceBuffer<float>& to, const Columns<float>& a) {
            to.reserve(queue, static_cast<std::size_t>(a.size()));
            device.send(queue, to.data(), a.data(), to.bytes());
        };
        put(white_, Columns<float>::Ones(channels_, 1));
        smoothness_.set(queue, from.avatar, weights_, training.face_neighbours);
        const auto& bounds = training.bounds;
        if (bounds.growth > 0)
            put(most_, detail::scale_bounds(from.avatar.eyes, float(bounds.growth),
                                            float(bounds.thickness)));
        state_.reserve(queue, 1);
        numbers_.reserve(queue, 1);
        send_state(queue);
    }
    DeviceAvatarTrainer(const DeviceAvatarTrainer&) = delete;
    DeviceAvatarTrainer& operator=(const DeviceAvatarTrainer&) = delete;

    /// Adds a view, whose pictures stay on the device; returns its number; waits. Throws an Error
    /// for sizes that differ from the first view's, and for drivers that the avatar does not
    /// accept.
    Index add(const CudaQueue& queue, const TrainingView& view, const Drivers<float, E>& drivers) {
        require(view.frame >= -1 && view.frame < avatar_.frames(), "DeviceAvatarTrainer", "view ",
                views_.count(), ": frame is ", view.frame, ", expected -1 to ",
                avatar_.frames() - 1);
        return views_.add(queue, view, avatar_.packed(seen_from(drivers, view.camera), view.frame,
                                                view.view));
    }

    /// Shares steps, before the first one: each takes group.share.count draws of run(), and its
    /// losses and gradient are means over group.share.all pictures of all ranks.
    void share_steps(const CudaQueue& queue, const DeviceStepGroup& group) {
        group_ = group;
        if (!group.single()) sums_.set(queue, group, avatar_.layout().size());
    }

    /// Takes the steps of these draws in order; waits once for all of them, and again only if
    /// memory must grow. Every rank calls it for as many steps. ask: true to ask all ranks to
    /// stop. Throws an Error for a view that does not exist, or if another rank has ended.
    DeviceStepsReport run(const CudaQueue& queue, const std::vector<StepDraw>& draws,
                          bool ask = false) {
        if (draws.empty()) return report();
        const auto pictures = static_cast<std::size_t>(group_.share.count);
        if (rows_.send(queue, draws, pictures, views_)) graphs_.forget(); // of the old addresses
        here_.begin(ask);
        for (Index waited = 0;; ++waited) {
            here_.forget_room();
            send_state(queue);
            std::size_t i = static_cast<std::size_t>(here_.taken) * pictures;
            rows_.fetch(queue, views_, i);
            for (; i < draws.size(); ++i) {
                const bool fetched = views_.on_host(draws[i].view);
                if (fetched) views_.ring().await(queue);
                launch(queue, draws[i], static_cast<Index>(draws.size()));
                if (fetched) views_.ring().used(queue);
                if (group_.single()) continue;
                sums_.add_into(queue, gradient_.data(), losses_.report(), state_.data());
                if ((i + 1) % pictures == 0) step_end(queue);
            }
            device_.fetch(queue, &here_, state_.data(), sizeof here_);
            if (group_.ranks != nullptr) group_.ranks->check();
            if (here_.control.stop == 0) break;
            require(waited < most_waits, "DeviceAvatarTrainer", "made room for lists ", most_waits,
                    " times for one run of steps, expected fewer");
            make_room();
        }
        steps_ += here_.taken;
        return report();
    }

    /// Copies the avatar and its optimiser to the host; waits.
    void fetch(const CudaQueue& queue, Host& avatar, Adam<Host>& adam) const {
        avatar_.download(queue, avatar);
        adam_.fetch(queue, adam);
    }

    /// Returns the views, for a later trainer of an avatar with the same drivers to take().
    DeviceViews<Device>& views() { return views_; }
    /// Returns the memory of a render (all, the face alone, the eyes alone), which a caller that
    /// knows the need may reserve before the first step.
    DeviceFrame<Device>& frame(std::size_t render) { return *frame_[render]; }
    /// Makes room for so many points that each driver moves, for the same caller.
    void make_room(const std::vector<std::uint32_t>& listed) { avatar_.make_room(listed); }
    /// Returns the memory held, without the perceptual term's.
    DeviceStepsMemory memory() const {
        DeviceStepsMemory r;
        const std::size_t own = avatar_.parameters().bytes(), shown = views_.resident_bytes();
        r.parameters = own + gradient_.bytes() + adam_.bytes() + sums_.bytes() + most_.bytes() +
                       centring_.bytes() + state_.bytes() + numbers_.bytes() + rows_.bytes();
        r.pictures = shown;
        r.networks = avatar_.bytes() - own;
        r.renders = views_.bytes() - shown + images_.bytes() + part_[0].bytes() +
                    part_[1].bytes() + colours_.bytes() + white_.bytes();
        for (const auto& f : frame_) r.renders += f->bytes();
        r.upsampler = upsampler_.bytes() + trace_[0].bytes() + trace_[1].bytes();
        r.losses = smoothness_.bytes() + losses_.bytes();
        return r;
    }
    /// Returns the number of graphs held.
    std::size_t graphs() const { return graphs_.size(); }

  private:
    static constexpr int most_waits = 64;
    using Kind = std::tuple<bool, bool>;
    /// Values that the kernels of a step are launched with.
    using Key = std::tuple<bool, bool, Index, std::vector<float>>;

    DeviceStepsReport report() const {
        DeviceStepsReport r;
        r.losses = avatar_losses(here_.losses);
        r.steps = steps_;
        r.asked = here_.asked != 0;
        r.refused_in_a_row = static_cast<Index>(here_.refused);
        if (here_.refused > 0)
            r.bad_field = avatar_.layout().slices()[static_cast<std::size_t>(here_.bad)].name;
        return r;
    }

    void send_state(const CudaQueue& queue) {
        device_.send(queue, state_.data(), &here_, sizeof here_);
    }
    void make_room() {
        avatar_.make_room({here_.listed, here_.listed + avatar_.rooms().lists});
        for (std::size_t k = 0; k < step_renders; ++k)
            frame_[k]->make_room(here_.entries[k], here_.groups[k]);
        graphs_.forget();
    }

    void launch(const CudaQueue& queue, const StepDraw& d, Index rows) {
        graphs_.run(queue, Kind{d.eyes_high, d.scaled}, key_of(d, rows),
                    [&] { put(queue, d, rows); });
    }
    Key key_of(const StepDraw& d, Index rows) const {
        return {d.eyes_high, d.scaled, rows, views_.camera_numbers(d.view)};
    }

    /// Enqueues the work of a picture, and a step's end if it has no other picture.
    void put(const CudaQueue& queue, const StepDraw& d, Index rows) {
        const Host& host = avatar_.shapes();
        detail::DeviceStepNumbers* const numbers = numbers_.data();
        const auto places = static_cast<int>(avatar_.driver_places().size);
        device_.launch(
            queue, 1,
            detail::BeginStepKernel{rows_.data(), rows, group_.share.count, rows_.places(),
                                    state_.data(), numbers, avatar_.drivers(), places});
        const detail::DeviceStepPictures* truth = nullptr;
        const detail::DeviceStepImages p = images_.of(queue, views_, channels_, d.eyes_high);
        end_part(queue, "draw");
        branches_.run(queue, 2, [&](std::size_t k, const CudaQueue& q) {
            if (k == 0) return avatar_.drive_into(q);
            truth = &views_.into(q, &numbers->view);
            upsampler_.set(q, device_upsampler(avatar_.parameters(), host.upsampler));
            gradient_.clear(q);
        });
        end_part(queue, "drive");
        const Renders r = renders(queue, d, p, numbers->blank);
        draw(queue, d, r);
        end_part(queue, "renders");

        if (d.scaled)
            resize_into(device_, queue,
                        detail::ResizeKernel<float>{p.final.pixels, &numbers->scale, 1,
                                                    p.scaled.pixels.data});
        upsampler_.forward_into(queue, d.scaled ? p.scaled : p.final, p.high, trace_[0]);
        if (d.eyes_high) upsampler_.forward_into(queue, p.eyes, p.eyes_high, trace_[1]);
        end_part(queue, "super-resolution");

        compare(queue, d, p, *truth);
        end_part(queue, "losses");
        back(queue, d, p, r);
        look_at_room(queue);
        if (group_.single()) step_end(queue);
    }
    void end_part(const CudaQueue& queue, const char* name) const {
        if constexpr (ProbedDevice<Device>) device_.probe(queue, name);
    }

    /// A render: its Gaussians, background, camera, memory, and destination of gradients.
    struct Render {
        DeviceGaussians<float> shown, gradient;
        const float* background;
        DevicePicture<float> feature, g_feature;
        float* alpha;
    };
    struct Renders {
        Render of[step_renders]; ///< all, the face alone, the eyes alone
    };
    Renders renders(const CudaQueue& queue, const StepDraw& d, const detail::DeviceStepImages& p,
                    const float* blank) {
        const DeviceGaussians<float>& cloud = avatar_.cloud();
        const Index n = avatar_.face_count(), e = avatar_.eye_count(), C = channels_;
        const Index of_eyes = d.eyes_high ? C : 3;
        colours_.reserve(queue, static_cast<std::size_t>(3 * (n + e)) + 1);
        float* const eye_colours = colours_.data() + 3 * n;
        part_[0].reserve(queue, n, 3);
        part_[1].reserve(queue, e, C);
        DeviceGaussians<float> face = detail::columns_from(cloud, {0, n}),
                               eyes = avatar_.eye_gaussians();
        face.feature = {colours_.data(), 3, n};
        if (!d.eyes_high) eyes.feature = {eye_colours, 3, e};
        launch_each(device_, queue, n + e,
                    detail::ShownColours{cloud.feature.data, C, n, colours_.data(),
                                         d.eyes_high ? nullptr : eye_colours});
        DeviceGaussians<float> g_face = detail::columns_from(part_[0].view(), {0, n});
        DeviceGaussians<float> g_eyes = part_[1].view();
        g_eyes.feature.rows = of_eyes;
        return {{{cloud, avatar_.g_cloud(queue), white_.data(), p.final, p.g_final, p.alpha[0]},
                 {face, g_face, blank, p.face, p.g_face, p.alpha[1]},
                 {eyes, g_eyes, white_.data(), p.eyes, p.g_eyes, p.alpha[2]}}};
    }
    void draw(const CudaQueue& queue, const StepDraw& d, const Renders& r) {
        branches_.run(queue, step_renders, [&](std::size_t k, const CudaQueue& q) {
            const Render& own = r.of[k];
            rasterizer_.forward_into(q, own.shown, views_.camera(d.view), own.background,
                                     {own.feature.pixels, {own.alpha, 1, own.feature.pixels.cols}},
                                     *frame_[k]);
        });
    }
    /// Computes values and cotangents of all terms.
    void compare(const CudaQueue& queue, const StepDraw& d, const detail::DeviceStepImages& p,
                 const detail::DeviceStepPictures& truth) {
        const auto picture = [](const float* data, const DevicePicture<float>& like) {
            return DevicePicture<const float>{{data, 3, like.pixels.cols}, like.width, like.height};
        };
        DeviceAvatarImages<float> images{picture(truth.truth, p.high),
                                         picture(truth.truth_small, p.final),
                                         truth.visible,
                                         truth.visible_small,
                                         truth.eyes,
                                         truth.eyes_small,
                                         truth.mask_small};
        images.eyes_high = d.eyes_high;
        images.scale = d.scaled ? &numbers_.data()->scale : nullptr;
        images.background = white_.data();
        images.blank = numbers_.data()->blank;
        losses_.into(
            queue, images,
            {p.final.pixels, p.face.pixels, p.eyes.pixels, p.high, p.eyes_high},
            {p.g_final.pixels, p.g_face.pixels, p.g_eyes.pixels, p.g_high, p.g_eyes_high});
        smoothness_.into(queue, avatar_, gradient_, losses_);
    }
    /// Adds the gradient of all terms to gradient_.
    void back(const CudaQueue& queue, const StepDraw& d, const detail::DeviceStepImages& p,
              const Renders& r) {
        const DeviceUpsamplerParameters to =
            device_upsampler(gradient_, avatar_.shapes().upsampler);
        const auto add = [&](const DevicePicture<float>& g) {
            launch_each(device_, queue, g.pixels.size(),
                        detail::AddNumbers{p.g_feature.pixels.data, g.pixels.data});
        };
        upsampler_.vjp_into(queue, trace_[0], p.g_high.pixels, {to, p.g_feature.pixels});
        if (d.scaled)
            resize_vjp_into(device_, queue,
                            detail::ResizeVjpKernel{p.g_feature.pixels, &numbers_.data()->scale,
                                                    p.g_final.pixels.data});
        else
            add(p.g_final);
        if (d.eyes_high) {
            upsampler_.vjp_into(queue, trace_[1], p.g_eyes_high.pixels, {to, p.g_feature.pixels});
            add(p.g_eyes);
        }
        end_part(queue, "super-resolution, back");
        branches_.run(queue, step_renders + 1, [&](std::size_t k, const CudaQueue& q) {
            if (k == step_renders) return losses_.report_into(q); // report of all terms
            const Render& own = r.of[k];
            rasterizer_.vjp_into(q, own.shown, views_.camera(d.view), own.background,
                                 {own.g_feature.pixels}, own.gradient, *frame_[k]);
        });
        launch_each(device_, queue, avatar_.face_count() + avatar_.eye_count(),
                    detail::JoinGradients{r.of[0].gradient, r.of[1].gradient, r.of[2].gradient,
                                          avatar_.face_count()});
        const auto g_eyes = detail::columns_from(avatar_.g_cloud(queue),
                                                 {avatar_.face_count(), avatar_.eye_count()});
        smoothness_.add_into(queue, g_eyes.feature);
        end_part(queue, "renders, back");
        avatar_.vjp_into(queue, gradient_);
        end_part(queue, "drive, back");
    }
    /// Enqueues the stop of a step whose lists had no room.
    void look_at_room(const CudaQueue& queue) {
        detail::RoomKernel room{{}, avatar_.rooms(), state_.data()};
        for (std::size_t k = 0; k < step_renders; ++k)
            room.render[k] = {frame_[k]->m.report, frame_[k]->m.entries, frame_[k]->m.groups};
        device_.launch(queue, 1, room);
    }
    /// Enqueues a step's sums, the optimiser's step, the centring of corrections, bounds, counts.
    void step_end(const CudaQueue& queue) {
        const detail::DeviceAdamControl* const control = &state_.data()->control;
        const float* const gradient =
            group_.single() ? gradient_.data() : sums_.close_into(queue, state_.data());
        adam_.step_into(queue, avatar_.parameters(), gradient, control);
        const Host& host = avatar_.shapes();
        centring_.into(queue, adam_.state(), host, avatar_.parameters());
        if (most_.size() > 0) {
            const DeviceColumns<float> scales = avatar_.parameters().of(host.eyes.log_scale);
            launch_each(device_, queue, scales.size(),
                        detail::BoundNumbers{control, most_.data(), scales.data});
        }
        const LossReport* const losses = group_.single() ? losses_.report() : sums_.losses();
        device_.launch(queue, 1, detail::EndStepKernel{adam_.state(), losses, state_.data()});
        end_part(queue, "optimiser");
    }

    Device device_;
    DeviceBranches<Device> branches_;
    AvatarLossConfig weights_;
    DeviceTwoStream<E, Device, typename Policy::Networks> avatar_;
    typename DeviceTwoStream<E, Device, typename Policy::Networks>::Parameters gradient_;
    DeviceAdam<Host, Device> adam_;
    DeviceUpsampler<Device, Policy::upsampler_planes> upsampler_;
    DeviceUpsamplerTrace trace_[2];
    DeviceRasterizer<typename Policy::Accuracy, Device, typename Policy::Channels> rasterizer_;
    std::unique_ptr<DeviceFrame<Device>> frame_[step_renders];
    DeviceViews<Device> views_;
    DeviceImageLosses<Device, Perceptual> losses_;
    DeviceSmoothnessTerms<E, Device> smoothness_;
    Index channels_; ///< channels of a render
    detail::DeviceCentring<E, Device> centring_;
    DeviceStepGroup group_;
    detail::DeviceStepSums<Device> sums_; ///< of steps of several pictures or ranks
    detail::DeviceCloudBuffer part_[2];   ///< gradients of the face's and of the eyes' render
    detail::DeviceStepImageMemory images_;
    DeviceBuffer<float> colours_, white_, most_;
    DeviceBuffer<detail::DeviceStepState> state_;
    DeviceBuffer<detail::DeviceStepNumbers> numbers_;
    detail::DeviceStepRows<Device> rows_;
    detail::DeviceStepState here_{}; ///< host copy of state_
    Index steps_ = 0;
    detail::KeptGraphs<Device, Kind, Key> graphs_;
};

} // namespace rye
