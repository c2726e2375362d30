// SPDX-License-Identifier: Apache-2.0
/// data/flaw_draws.hpp: kinds of errors that `rye flaw` puts into a capture, with their sizes,
/// random numbers and sums. Each kind has its own stream, keyed by its name: no kind changes the
/// numbers of another. A size is the standard deviation of a normal distribution; in percent, that
/// of a logarithm.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <string_view>

#include <rye/io/bytes.hpp>
#include <rye/core/checksum.hpp>
#include <rye/core/random.hpp>

namespace rye::trainer {

enum class Flaw {
    gaze_common,       ///< yaw and pitch of a frame, both eyes alike
    gaze_single,       ///< yaw and pitch of each eye
    centres,           ///< each coordinate of an eyeball's centre
    expression,        ///< a coefficient
    pose_rotation,     ///< each component of a rotation vector
    pose_position,     ///< each coordinate of the head
    landmarks,         ///< each coordinate of a landmark or vertex
    camera_rotation,   ///< each component of a camera's rotation vector
    camera_position,   ///< each coordinate of a camera's centre
    focal,             ///< focal lengths of a camera, both alike
    gain,              ///< light of a camera
    white_balance,     ///< light of each channel of a camera
    exposure,          ///< light of a frame, all cameras alike
    vignetting,        ///< light lost in the corners of a camera's pictures
    blur,              ///< blur of pictures
    noise,             ///< noise of a channel of a pixel
    jpeg,              ///< quality of pictures
    soft_masks,        ///< blur of masks
    wrong_masks,       ///< each coordinate of a mask's displacement
    eye_mask_dilation, ///< distance by which eye masks grow
    drop_views,        ///< share of the views that are dropped
};
inline constexpr std::size_t flaw_count = 21;

/// Name of a kind in files and on the command line, and its units.
struct FlawKind {
    const char* name;
    const char* unit;
    const char* rms_unit; ///< unit of the measured sum; null for a count alone
};
inline constexpr std::array<FlawKind, flaw_count> flaw_kinds{{
    {"gaze-common", "degrees", "degrees"},
    {"gaze-single", "degrees", "degrees"},
    {"centres", "mm", "mm"},
    {"expression", "of 1", "of 1"},
    {"pose-rotation", "degrees", "degrees"},
    {"pose-position", "mm", "mm"},
    {"landmarks", "mm", "mm"},
    {"camera-rotation", "degrees", "degrees"},
    {"camera-position", "mm", "mm"},
    {"focal", "percent", "percent"},
    {"gain", "percent", "percent"},
    {"white-balance", "percent", "percent"},
    {"exposure", "percent", "percent"},
    {"vignetting", "percent", "percent"},
    {"blur", "px", "of 255"},
    {"noise", "of 255", "of 255"},
    {"jpeg", "quality", "of 255"},
    {"soft-masks", "px", "of 255"},
    {"wrong-masks", "px", "px"},
    {"eye-mask-dilation", "px", nullptr},
    {"drop-views", "of 1", nullptr},
}};
constexpr const FlawKind& kind_of(Flaw flaw) { return flaw_kinds[static_cast<std::size_t>(flaw)]; }

/// A T for each kind.
template <class T>
struct OfFlaws {
    std::array<T, flaw_count> values{};
    T& operator[](Flaw flaw) { return values[static_cast<std::size_t>(flaw)]; }
    const T& operator[](Flaw flaw) const { return values[static_cast<std::size_t>(flaw)]; }
};

/// Sizes in the kinds' units; 0 for none.
using FlawSizes = OfFlaws<double>;

/// Sum of the errors of a kind, in rms_unit, or a count of pixels or views.
struct FlawSum {
    double squares = 0;
    std::int64_t count = 0; ///< numbers drawn, or pixels or views changed

    void add(double x) {
        squares += x * x;
        ++count;
    }
    void add(const FlawSum& other) {
        squares += other.squares;
        count += other.count;
    }
    double rms() const { return count == 0 ? 0 : std::sqrt(squares / static_cast<double>(count)); }
};
using FlawSums = OfFlaws<FlawSum>;

/// Random numbers of one kind, and of one of its frames or cameras by index.
struct FlawDraws {
    std::uint64_t seed = 0;

    Random of(Flaw flaw) const {
        return Random{seed}.fork(crc32(as_bytes(std::string_view(kind_of(flaw).name))));
    }
    Random of(Flaw flaw, std::size_t first) const { return of(flaw).fork(first); }
    Random of(Flaw flaw, std::size_t first, std::size_t second) const {
        return of(flaw).fork(first).fork(second);
    }
};

/// Returns a normal number of standard deviation `size`, and adds it to the sum.
inline double drawn(const Random& random, std::uint64_t index, double size, FlawSum& sum) {
    const double x = size * random.normal(index);
    sum.add(x);
    return x;
}

} // namespace rye::trainer
