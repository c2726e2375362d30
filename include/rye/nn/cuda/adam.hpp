// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/adam.hpp: Adam over parameters in device memory, by nn/adam.hpp's formula. Step
/// numbers are on the device, so that a step can be captured as a CUDA graph and replayed. A
/// gradient that is not finite cancels the whole step on the device before anything is changed;
/// `report`, which waits, names its field.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include <rye/backend/cuda/resident.hpp>
#include <rye/backend/cuda/unrolled.hpp>
#include <rye/nn/adam.hpp>

namespace rye {

namespace detail {

/// Adam's state of a field.
struct DeviceAdamField {
    double rate;        ///< 0: it keeps its values and moments, and its gradient is not read
    std::int64_t steps; ///< applied so far
    float size, root;   ///< factors of the step under way
    std::int64_t first; ///< the optimiser's steps before which its rate is 0

    /// True if it takes no part in the step that follows so many.
    RYE_HD bool rests(std::int64_t applied) const { return rate == 0 || applied < first; }
};
/// A range of one field, for a block.
struct DeviceAdamRange {
    Index begin;
    int count, field;
};

} // namespace detail

/// Counts of steps and of what stopped the last one, in device memory.
struct DeviceAdamState {
    std::uint32_t bad;      ///< the first field whose gradient is not finite, or none_bad
    std::uint32_t last_bad; ///< that of the last step
    std::int64_t steps;     ///< applied so far
    static constexpr std::uint32_t none_bad = 0xFFFFFFFF;
    static constexpr std::uint32_t stopped = 1; ///< `bad` of a step that a control has stopped
};

namespace detail {

/// Inputs of a step beside its gradient, in device memory.
struct DeviceAdamControl {
    double rate = 1;        ///< factor of all learning rates
    std::uint32_t stop = 0; ///< not 0: nothing is changed and nothing is counted
};

/// Numbers of a range.
inline constexpr int adam_range = 1024;

/// Looks for gradients that are not finite.
struct AdamCheckKernel {
    static constexpr const char* name = "Adam's finite check";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {
        std::uint32_t bad;
    };
    const DeviceAdamField* field;
    const DeviceAdamRange* range;
    const float* gradient;
    DeviceAdamState* state;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const DeviceAdamRange r = range[block.index()];
        if (field[r.field].rests(state->steps)) return;
        block.each_thread([&](int t) {
            if (t == 0) shared.bad = 0;
        });
        block.each_thread([&](int t) {
            float sum = 0; // 0 x is 0 for every finite x
            for (int k = t; k < r.count; k += threads) sum += gradient[r.begin + k] * 0.0F;
            if (!(sum == 0.0F)) Block::raise(&shared.bad, 1U);
        });
        block.each_thread([&](int t) {
            // The largest of complements: the first field.
            if (t == 0 && shared.bad != 0)
                Block::raise(&state->bad, DeviceAdamState::none_bad - std::uint32_t(r.field));
        });
    }
};

/// Counts the step, and what follows from its number.
struct AdamScheduleKernel {
    static constexpr const char* name = "Adam's schedule";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {};
    AdamConfig config;
    DeviceAdamField* field;
    int fields;
    DeviceAdamState* state;
    const DeviceAdamControl* control; ///< or null

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (state->bad != 0 || stopped()) return;
            const double share = control != nullptr ? control->rate : 1.0;
            for (int i = t; i < fields; i += threads) {
                DeviceAdamField& f = field[i];
                if (f.rests(state->steps)) continue;
                const AdamStep<float> now(config, share * f.rate, ++f.steps);
                f.size = now.size;
                f.root = now.root;
            }
        });
        block.each_thread([&](int t) {
            if (t != 0) return;
            if (stopped()) {
                state->bad = DeviceAdamState::stopped;
                return;
            }
            if (state->bad == 0) ++state->steps;
            state->last_bad = state->bad == 0 ? DeviceAdamState::none_bad
                                              : DeviceAdamState::none_bad - state->bad;
        });
    }

  private:
    RYE_DEVICE bool stopped() const { return control != nullptr && control->stop != 0; }
};

/// Applies a step, unless a gradient is not finite.
struct AdamStepKernel {
    static constexpr const char* name = "Adam";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {};
    AdamConfig config;
    const DeviceAdamField* field;
    const DeviceAdamRange* range;
    const DeviceAdamState* state;
    const float* gradient;
    float *parameter, *m, *v;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        if (state->bad != 0) return;
        const DeviceAdamRange r = range[block.index()];
        const DeviceAdamField f = field[r.field];
        if (f.rests(state->steps - 1)) return; // the schedule has counted this step
        const AdamFormula<float> formula(config);
        block.each_thread([&](int t) {
            // A few at a time: their loads are under way together.
            constexpr int at_once = 4;
            for (int k = t; k < r.count; k += at_once * threads) {
                float g[at_once] = {}, mean[at_once] = {}, square[at_once] = {}, x[at_once] = {};
                const auto each = [&](const auto& own) {
                    repeated<at_once>([&](auto e) {
                        if (k + e * threads < r.count) own(e, r.begin + k + e * threads);
                    });
                };
                each([&](auto e, Index i) {
                    g[e] = gradient[i], mean[e] = m[i], square[e] = v[i], x[e] = parameter[i];
                });
                each([&](auto e, Index i) {
                    mean[e] = formula.mean(mean[e], g[e]);
                    square[e] = formula.square(square[e], g[e]);
                    m[i] = mean[e];
                    v[i] = square[e];
                    parameter[i] = formula.moved(x[e], mean[e], square[e], f.size, f.root);
                });
            }
        });
    }
};

} // namespace detail

/// The optimiser: moments and step numbers in device memory.
template <class P, class Device>
class DeviceAdam {
  public:
    DeviceAdam(const Device& device, const CudaQueue& queue, const ResidentLayout<P>& layout,
               const AdamConfig& config = {})
        : m(device, queue, layout),
          v(device, queue, layout),
          device_(device),
          config_(config) {
        RYE_ASSERT(float(config.eps) > 0.0F, "DeviceAdam: eps is 0 in float");
        std::vector<detail::DeviceAdamRange> ranges;
        int field = 0;
        for (const auto& s : layout.slices()) {
            for (Index b = 0; b < s.size(); b += detail::adam_range)
                ranges.push_back(
                    {s.offset + b,
                     static_cast<int>(std::min<Index>(detail::adam_range, s.size() - b)), field});
            ++field;
        }
        fields_.assign(layout.slices().size(), detail::DeviceAdamField{0, 0, 0, 0, 0});
        range_.reserve(queue, ranges.size() + 1);
        field_.reserve(queue, fields_.size() + 1);
        state_.reserve(queue, 1);
        ranges_ = static_cast<Index>(ranges.size());
        device.send(queue, range_.data(), ranges.data(),
                    ranges.size() * sizeof(detail::DeviceAdamRange));
        device.fill(queue, state_.data(), 0, sizeof(DeviceAdamState));
    }

    /// Sets the learning rates, by a field's name, and the steps in which it rests at first, if
    /// `rate` says so; step numbers stay. Waits.
    template <class Rate>
    void set_rates(const CudaQueue& queue, const Rate& rate) {
        if (sent_)
            device_.fetch(queue, fields_.data(), field_.data(),
                          fields_.size() * sizeof(detail::DeviceAdamField));
        for (std::size_t i = 0; i < fields_.size(); ++i) {
            const std::string& name = m.layout().slices()[i].name;
            fields_[i].rate = rate(name);
            if constexpr (requires { rate.first_step(name); })
                fields_[i].first = rate.first_step(name);
        }
        device_.send(queue, field_.data(), fields_.data(),
                     fields_.size() * sizeof(detail::DeviceAdamField));
        sent_ = true;
    }

    /// Puts a step on the stream. `control`: in device memory, or null.
    void step_into(const CudaQueue& queue, const Resident<P, Device>& parameters,
                   const Resident<P, Device>& gradient,
                   const detail::DeviceAdamControl* control = nullptr) {
        RYE_ASSERT(&gradient.layout() == &m.layout(), "DeviceAdam: gradient of another layout");
        step_into(queue, parameters, gradient.data(), control);
    }
    /// Does the same by the numbers of a gradient of the same layout.
    void step_into(const CudaQueue& queue, const Resident<P, Device>& parameters,
                   const float* gradient, const detail::DeviceAdamControl* control = nullptr) {
        RYE_ASSERT(sent_, "DeviceAdam: rates were not set");
        RYE_ASSERT(&parameters.layout() == &m.layout(), "DeviceAdam: parameters of another layout");
        device_.fill(queue, state_.data(), 0, sizeof(std::uint32_t)); // `bad`
        device_.launch(
            queue, ranges_,
            detail::AdamCheckKernel{field_.data(), range_.data(), gradient, state_.data()});
        device_.launch(
            queue, 1,
            detail::AdamScheduleKernel{config_, field_.data(), static_cast<int>(fields_.size()),
                                       state_.data(), control});
        device_.launch(queue, ranges_,
                       detail::AdamStepKernel{config_, field_.data(), range_.data(), state_.data(),
                                              gradient, parameters.data(), m.data(), v.data()});
    }

    /// Returns the report of the last step. Waits.
    AdamReport report(const CudaQueue& queue) const {
        DeviceAdamState s{};
        device_.fetch(queue, &s, state_.data(), sizeof s);
        if (s.last_bad == DeviceAdamState::none_bad) return {};
        return {false, m.layout().slices()[s.last_bad].name};
    }

    /// The host's optimiser in the same state, as checkpoints have it. Waits.
    void fetch(const CudaQueue& queue, Adam<P>& to) const {
        m.fetch(queue, to.m);
        v.fetch(queue, to.v);
        DeviceAdamState s{};
        device_.fetch(queue, &s, state_.data(), sizeof s);
        to.step = s.steps;
        std::vector<detail::DeviceAdamField> fields = fields_;
        if (sent_)
            device_.fetch(queue, fields.data(), field_.data(),
                          fields.size() * sizeof(detail::DeviceAdamField));
        to.field_steps.clear();
        for (const detail::DeviceAdamField& f : fields) to.field_steps.push_back(f.steps);
        to.config = config_;
    }
    /// Goes on from the host's optimiser. Waits.
    void send(const CudaQueue& queue, const Adam<P>& from) {
        m.send(queue, from.m);
        v.send(queue, from.v);
        config_ = from.config;
        for (std::size_t i = 0; i < fields_.size(); ++i)
            fields_[i].steps = i < from.field_steps.size() ? from.field_steps[i] : from.step;
        const DeviceAdamState s{0, DeviceAdamState::none_bad, from.step};
        device_.send(queue, state_.data(), &s, sizeof s);
        device_.send(queue, field_.data(), fields_.data(),
                     fields_.size() * sizeof(detail::DeviceAdamField));
        sent_ = true;
    }

    /// Counts in device memory, for kernels that read what became of a step.
    const DeviceAdamState* state() const { return state_.data(); }
    /// Memory that is held [bytes].
    std::size_t bytes() const {
        return m.bytes() + v.bytes() + range_.bytes() + field_.bytes() + state_.bytes();
    }

    Resident<P, Device> m, v; ///< moments

  private:
    Device device_;
    AdamConfig config_;
    std::vector<detail::DeviceAdamField> fields_;
    DeviceBuffer<detail::DeviceAdamRange> range_;
    DeviceBuffer<detail::DeviceAdamField> field_;
    DeviceBuffer<DeviceAdamState> state_;
    Index ranges_ = 0;
    bool sent_ = false;
};

} // namespace rye
