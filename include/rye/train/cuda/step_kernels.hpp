// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/step_kernels.hpp: kernels that begin and end a training step on a device and join
/// the gradients of its three renders. A step reads its draw from a table in device memory, so that
/// nothing comes from the host between steps. If memory for lists is too small, neither that step
/// nor the following ones change anything until the host has made room.
#pragma once

#include <cstdint>

#include <rye/avatar/cuda/face_points.hpp>
#include <rye/loss/cuda/terms.hpp>
#include <rye/nn/cuda/adam.hpp>
#include <rye/splat/cuda/gaussians.hpp>
#include <rye/splat/cuda/records.hpp>
#include <rye/train/augment.hpp>
#include <rye/train/cuda/views.hpp>

namespace rye {

/// Number of renders of a step: all, the face alone, the eyes alone.
inline constexpr int step_renders = 3;

namespace detail {

/// State of a run's steps, in device memory.
struct DeviceStepState {
    DeviceAdamControl control; ///< of the current step; stop: memory was too small
    std::int64_t taken = 0;    ///< steps taken: rows of the table
    std::uint32_t refused = 0; ///< refused in a row, for a gradient that is not finite
    std::uint32_t bad = DeviceAdamState::none_bad; ///< field of the last refusal
    std::int64_t entries[step_renders] = {};       ///< most entries of each render
    std::uint32_t groups[step_renders] = {};
    std::uint32_t listed[4] = {};
    LossReport losses; ///< of the last step taken
    std::int64_t picture = 0;         ///< pictures of the current step so far
    std::uint32_t ask = 0, asked = 0; ///< 1 if this rank asks to stop; if any rank did

    void begin(bool asks) { taken = 0, picture = 0, ask = asks ? 1 : 0; }
    void forget_room() {
        control.stop = 0;
        for (auto& e : entries) e = 0;
        for (auto& g : groups) g = 0;
        for (auto& l : listed) l = 0;
    }
};

/// Draw of the current step, in device memory.
struct DeviceStepNumbers {
    DeviceViewPlace view;
    detail::Resizing scale;
    float blank[3];
};
/// Row of the table of draws.
struct DeviceStepRow {
    std::int64_t view;
    double rate;
    detail::Resizing scale;
    float blank[3];
};

/// Reads the next row.
struct BeginStepKernel {
    static constexpr const char* name = "draw of a step";
    static constexpr int threads = 128, blocks = 1;
    struct Shared {};
    const DeviceStepRow* row;
    Index rows, pictures; ///< rows of the table; rows of a step
    const DeviceViewPlace* view;
    DeviceStepState* state;
    DeviceStepNumbers* numbers;
    float* drivers;
    int driver_numbers;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            // A step that waits for memory may be past the last row: it changes nothing.
            const Index at = rye::min(Index(state->taken * pictures + state->picture), rows - 1);
            const DeviceStepRow& own = row[at];
            const DeviceViewPlace& place = view[own.view];
            for (int k = t; k < driver_numbers; k += threads) drivers[k] = place.drivers[k];
            if (t != 0) return;
            numbers->view = place;
            numbers->scale = own.scale;
            for (int c = 0; c < 3; ++c) numbers->blank[c] = own.blank[c];
            state->control.rate = own.rate;
        });
    }
};

/// Writes the colours of the face's and the eyes' renders: the first three features.
struct ShownColours {
    static constexpr const char* name = "colours of the streams";
    const float* feature; ///< of all Gaussians
    Index channels, face; ///< channels of a Gaussian; Gaussians of the face, which come first
    float* of_face; ///< 3 x face
    float* of_eyes; ///< 3 x eyes; may be null

    RYE_DEVICE void operator()(Index i) const {
        const float* const from = feature + i * channels;
        for (int c = 0; c < 3; ++c) {
            if (i < face)
                of_face[3 * i + c] = from[c];
            else if (of_eyes != nullptr)
                of_eyes[3 * (i - face) + c] = from[c];
        }
    }
};

/// Adds the gradients of the face's and of the eyes' render to those of the joint one.
struct JoinGradients {
    static constexpr const char* name = "gradients of the three renders";
    DeviceGaussians<float> sum;              ///< of the joint render
    DeviceGaussians<const float> face, eyes; ///< with as many channels as their renders
    Index faces;                             ///< number of Gaussians of the face

    RYE_DEVICE void operator()(Index i) const {
        if (i < faces)
            add(face, i, i);
        else
            add(eyes, i - faces, i);
    }

  private:
    RYE_DEVICE static void add(const DeviceColumns<const float>& from, Index i,
                               const DeviceColumns<float>& to, Index at) {
        for (Index k = 0; k < from.rows; ++k)
            to.data[at * to.rows + k] += from.data[i * from.rows + k];
    }
    RYE_DEVICE void add(const DeviceGaussians<const float>& from, Index i, Index at) const {
        add(from.mean, i, sum.mean, at), add(from.rotation, i, sum.rotation, at);
        add(from.scale, i, sum.scale, at), add(from.opacity, i, sum.opacity, at);
        add(from.feature, i, sum.feature, at);
    }
};

/// Memory of a render and the report of its need.
struct RenderRoom {
    const FrameReport* report;
    std::uint32_t entries, groups; ///< capacity
};

/// Stops the step if a list did not fit; records the largest lengths.
struct RoomKernel {
    static constexpr const char* name = "room of lists";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {};
    RenderRoom render[step_renders];
    DeviceRooms lists;
    DeviceStepState* state;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (t != 0) return;
            bool fits = !lists.exceeded();
            for (int k = 0; k < lists.lists; ++k)
                state->listed[k] = rye::max(state->listed[k], lists.count[k]);
            for (int k = 0; k < step_renders; ++k) {
                const FrameReport& r = *render[k].report;
                const std::int64_t entries =
                    static_cast<std::int64_t>(std::uint64_t(r.entries_high) << 32U | r.entries_low);
                fits = fits && r.overflow == 0 && r.groups <= render[k].groups;
                state->entries[k] = rye::max(state->entries[k], entries);
                state->groups[k] = rye::max(state->groups[k], r.groups);
            }
            if (!fits) state->control.stop = 1;
        });
    }
};

/// Clamps numbers to upper bounds.
struct BoundNumbers {
    static constexpr const char* name = "bounds of scales";
    const DeviceAdamControl* control;
    const float* most;
    float* number;

    RYE_DEVICE void operator()(Index i) const {
        if (control->stop == 0) number[i] = rye::min(number[i], most[i]);
    }
};

/// Counts the step unless it was stopped.
struct EndStepKernel {
    static constexpr const char* name = "end of a step";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {};
    const DeviceAdamState* adam;
    const LossReport* losses;
    DeviceStepState* state;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (t != 0 || state->control.stop != 0) return;
            ++state->taken;
            state->losses = *losses;
            const bool bad = adam->last_bad != DeviceAdamState::none_bad;
            state->refused = bad ? state->refused + 1 : 0;
            if (bad) state->bad = adam->last_bad;
        });
    }
};

} // namespace detail

} // namespace rye
