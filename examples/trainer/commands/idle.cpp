// SPDX-License-Identifier: Apache-2.0
#include "commands/idle.hpp"

#include <algorithm>
#include <cmath>
#include <ostream>

#include <CLI/CLI.hpp>

#include <rye/core/memory.hpp>

#include "commands/options.hpp"
#include "data/degrees.hpp"
#include "data/memory_limit.hpp"

namespace rye::trainer {
namespace {

/// Largest weight of a blink below which a run has not seen a closed eye.
constexpr float half_closed = 0.5f;

const std::vector<std::string> idle_parts{"saccades", "drift",  "blinks",
                                          "lid-lag",  "pupils", "vor"};

Mat3<double> head_rotation(const Drivers<float>& d) {
    return so3_exp(Vec3<double>(d.pose.head<3>().cast<double>()));
}

/// Returns the gaze, or where an eye stops that goes no further than `range` [rad].
Vec3<double> within(const Vec3<double>& gaze, double range) {
    return angle_from_ahead(gaze) > range ? at_range(gaze, range) : gaze;
}

/// Turns the eyes of the frames to rest: at the point of --gaze-at, or where the first looks.
void rest_eyes(const IdleOptions& o, const GazeAtOptions& at, const TrainState& state,
               std::vector<DrawnFrame>& frames) {
    const bool follow = o.has("vor");
    if (at.given() && follow) {
        aim_frames(at, state, frames);
        return;
    }
    std::vector<DrawnFrame> first{frames.front()};
    if (at.given()) aim_frames(at, state, first);
    const Mat3<double> before = head_rotation(first.front().drivers);
    for (DrawnFrame& f : frames)
        for (std::size_t e = 0; e < 2; ++e) {
            f.drivers.gaze[e] = first.front().drivers.gaze[e];
            const Vec3<double> g = f.drivers.gaze[e].cast<double>();
            if (follow && f.drivers.pose != first.front().drivers.pose)
                f.drivers.gaze[e] = within(steadied_gaze(before, head_rotation(f.drivers), g),
                                           std::max(at.range_deg * degree, angle_from_ahead(g)))
                                        .cast<float>();
        }
}

/// Returns the names and largest weights of coefficients, for people.
std::string named(const std::vector<LidCoefficient<float>>& all, const Capture& capture) {
    std::string text;
    for (const LidCoefficient<float>& c : all)
        text += (text.empty() ? "" : ", ") +
                capture.expression_names[static_cast<std::size_t>(c.index)] + " to " +
                number_text(std::round(100 * c.most) / 100);
    return text;
}

} // namespace

bool IdleOptions::has(const std::string& part) const {
    return std::find(without.begin(), without.end(), part) == without.end();
}

void add_idle_options(CLI::App& command, IdleOptions& o) {
    CLI::Option* const idle =
        command
            .add_option("--idle", o.seconds,
                        "A video of so many seconds in which the eyes live by themselves: they "
                        "glance aside, drift, blink, keep their point while the head turns, and "
                        "their pupils are never still")
            ->check(from_to(0.01, 3600.0));
    command.add_option("--seed", o.seed, "Seed of --idle: the same one gives the same video")
        ->needs(idle)
        ->check(read_check(parsed_seed))
        ->capture_default_str();
    command
        .add_option("--without", o.without,
                    "Parts of --idle to leave out: saccades, drift, blinks, lid-lag, pupils, vor "
                    "(the eyes then turn with the head)")
        ->needs(idle)
        ->delimiter(',')
        ->check(CLI::IsMember(idle_parts));
}

LidCoefficients<float> lids_of(const Capture& capture) {
    const auto names = static_cast<Index>(capture.expression_names.size());
    VecX<float> most = VecX<float>::Constant(names, capture.frames.size() > 1 ? 0.0f : 1.0f);
    for (const CaptureFrame& f : capture.frames)
        for (Index k = 0; capture.frames.size() > 1 && k < names; ++k)
            if (k < static_cast<Index>(f.expression.size()))
                most[k] = std::max(most[k], f.expression[static_cast<std::size_t>(k)]);
    return rye::lid_coefficients(capture.expression_names, most);
}

std::vector<DrawnFrame> idle_frames(const IdleOptions& o, const GazeAtOptions& at,
                                    const FrameRate& fps, const TrainState& state,
                                    const Capture& capture, std::vector<DrawnFrame> frames,
                                    std::ostream& say) {
    const double rate = static_cast<double>(fps.pictures) / fps.seconds;
    const auto count = static_cast<std::size_t>(std::max(1LL, std::llround(o.seconds * rate)));
    const DrawnFrame first = frames.front();
    require_memory(
        count * (sizeof(DrawnFrame) +
                 sizeof(float) * static_cast<std::size_t>(first.drivers.expression.size())),
        memory_limit(), "--idle", "drivers of " + std::to_string(count) + " pictures");
    if (frames.size() == 1) frames.resize(count, first);
    require(frames.size() >= count, "--idle", "got ", o.seconds, " s, ", count, " pictures at ",
            rate, " a second, but --driving or --cameras has ", frames.size());
    frames.resize(count, first);
    rest_eyes(o, at, state, frames);

    IdleSettings settings;
    settings.saccades = o.has("saccades");
    settings.drift = o.has("drift");
    settings.blinks = o.has("blinks");
    settings.lid_lag = o.has("lid-lag");
    const auto dilates = [&](Index eye) {
        return iris_of(state.avatar.eyes, eye).limbus > 0;
    };
    settings.pupils = o.has("pupils") && dilates(0) && dilates(1);
    const LidCoefficients<float> lids = lids_of(capture);
    std::string words;
    if (settings.blinks && lids.blink.empty()) {
        settings.blinks = false;
        words = capture.expression_names.empty()
                    ? "blinks are left out: the coefficients of the expression have no names"
                    : "blinks are left out: no coefficient whose name has 'blink' in it varies";
    }
    const IdleEyes eyes(settings, parsed_seed(o.seed, "--seed"), o.seconds);
    for (std::size_t i = 0; i < count; ++i) {
        const IdleMoment moment = eyes.at(static_cast<double>(i) / rate);
        add_idle(moment, lids, at.range_deg * degree, frames[i].drivers);
        for (float& pupil : frames[i].pupil)
            pupil = std::clamp(pupil * static_cast<float>(moment.pupil),
                               static_cast<float>(least_pupil), static_cast<float>(most_pupil));
    }
    say << "idle: " << eyes.saccades().size() << " saccades, " << eyes.blinks().size() << " blinks";
    if (settings.blinks) say << " (" << named(lids.blink, capture) << ")";
    say << (words.empty() ? "" : "; ") << words << "\n";
    if (settings.blinks && std::all_of(lids.blink.begin(), lids.blink.end(),
                                       [](const auto& c) { return c.most < half_closed; }))
        say << "idle: the run's frames show no closed eye; blinks close the lids as far as these "
               "do\n";
    return frames;
}

} // namespace rye::trainer
