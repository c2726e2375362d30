// SPDX-License-Identifier: Apache-2.0
/// rye/rig/idle_eyes.hpp: what the eyes of a person at rest do by themselves: they look at a point,
/// glance aside and back, drift while they fixate, and blink, and their pupils are never still. A
/// function of settings, seed and time: the same bits for the same ones, in any order of times.
/// Angles [rad], times [s]. Both eyes turn together, so vergence stays, and so do both pupils.
/// Source: rig/eye_dynamics.hpp; amplitudes of glances: Lee, Badler, Badler, "Eyes alive", 2002;
/// the rate of blinks: Bentivoglio et al., "Analysis of blink rate patterns in normal subjects",
/// 1997 (17 a minute at rest); lids: Becker, Fuchs, "Lid-eye coordination during vertical gaze
/// changes in man and monkey", 1988; slow waves of the pupil: Stark, Campbell, Atwood, "Pupil
/// unrest: an example of noise in a biological servomechanism", 1958. Their size, times between
/// glances and what is near are choices.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/core/random.hpp>
#include <rye/rig/eye_dynamics.hpp>

namespace rye {

/// Settings of IdleEyes. A part that is off leaves exactly nothing.
struct IdleSettings {
    bool saccades = true; ///< glances aside and back
    bool drift = true;    ///< slow motion within a fixation
    bool blinks = true;   ///< closures of both lids
    bool lid_lag = true;  ///< the upper lid behind a vertical saccade
    bool pupils = true;   ///< unrest of the pupils

    double glance_share = 0.3;      ///< saccades that lead away from the point, 0 to 1
    double mean_glance = 0.12043;   ///< of their exponentially distributed amplitudes (6.9 degrees)
    double farthest = 0.26180;      ///< from the point (15 degrees)
    double near = 0.014;            ///< deviation of fixations of the point itself (0.8 degrees)
    double least_fixation = 0.2;    ///< duration; to it is added
    double mean_more = 1.0;         ///< the mean of an exponentially distributed rest
    double drift_speed = 0.007;     ///< deviation on each axis [rad/s] (0.4 degrees/s)
    double blinks_a_minute = 17;    ///< on average
    double least_blink_pause = 0.4; ///< from the end of a blink to the next
    double lid_delay = 0.005;       ///< of the lid's saccade behind the eye's
    double lid_up_slowness = 1.25;  ///< of lids in saccades upward; downward they are as fast
    double pupil_unrest = 0.03;     ///< deviation of the pupils' radii over their mean
    BlinkPhases<double> blink;
    MainSequence<double> main_sequence;
};

/// The eyes at a time.
struct IdleMoment {
    Vec2<double> turn{0.0, 0.0}; ///< (pitch, yaw) to add to both gazes
    double closed = 0;           ///< lids: 0 open, 1 closed
    double lid_behind = 0;       ///< pitch of the upper lid minus that which the gaze gives it
    double pupil = 1;            ///< to multiply both pupils' radii by
};

/// A saccade: from onset on, both eyes turn by `turn`.
struct IdleSaccade {
    double onset;
    Vec2<double> turn; ///< (pitch, yaw)
};

/// The eyes of a person at rest from time 0 to `seconds`.
class IdleEyes {
  public:
    /// Throws Error("IdleEyes: ...") with the name and value of a setting out of its range.
    IdleEyes(const IdleSettings& settings, std::uint64_t seed, double seconds)
        : settings_(settings) {
        check(seconds);
        const Random random{seed, 0};
        plan_fixations(random.fork(1), seconds);
        if (settings_.blinks) plan_blinks(random.fork(2), seconds);
        if (settings_.pupils) plan_pupils(random.fork(3));
    }

    /// Returns the eyes t [s] after the beginning; before it nothing has happened.
    IdleMoment at(double t) const {
        IdleMoment m;
        for (const IdleSaccade& s : saccades_) {
            if (s.onset > t + 1) break;
            const double share = travelled(s, t, 0, 1);
            m.turn[0] += share * s.turn[0];
            m.turn[1] += share * s.turn[1];
            if (settings_.lid_lag && s.turn[0] != 0)
                m.lid_behind += (travelled(s, t, settings_.lid_delay,
                                           s.turn[0] > 0 ? settings_.lid_up_slowness : 1) -
                                 share) *
                                s.turn[0];
        }
        const Vec2<double> d = drifted(t);
        m.turn[0] += d[0];
        m.turn[1] += d[1];
        for (const double begin : blinks_)
            m.closed = std::max(m.closed, detail::blink_closure(t - begin, settings_.blink));
        for (const Wave& w : waves_)
            m.pupil += settings_.pupil_unrest * std::sqrt(2.0 / pupil_waves) *
                       std::sin(two_pi * (w.frequency * t + w.phase));
        return m;
    }

    const std::vector<IdleSaccade>& saccades() const { return saccades_; }
    /// Returns the beginnings of blinks [s].
    const std::vector<double>& blinks() const { return blinks_; }

  private:
    static constexpr double two_pi = 6.283185307179586476925;
    static constexpr int pupil_waves = 6;
    /// A wave of the pupils: [Hz], [turns].
    struct Wave {
        double frequency, phase;
    };
    /// A fixation's drift, from `begin` on.
    struct Drift {
        double begin;
        Vec2<double> before, speed; ///< what has drifted until then; [rad/s]
    };

    void check(double seconds) const {
        const auto between = [](const char* name, double x, double least, double most) {
            require(x >= least && x <= most, "IdleEyes", "'", name, "': got ", x,
                    ", expected a number from ", least, " to ", most);
        };
        const IdleSettings& s = settings_;
        between("seconds", seconds, 0, 86400);
        between("glance_share", s.glance_share, 0, 1);
        between("mean_glance", s.mean_glance, 0, 1);
        between("farthest", s.farthest, 0, gaze_range);
        between("near", s.near, 0, 0.2);
        between("least_fixation", s.least_fixation, 0.05, 3600);
        between("mean_more", s.mean_more, 0, 3600);
        between("drift_speed", s.drift_speed, 0, 1);
        between("blinks_a_minute", s.blinks_a_minute, 0, 120);
        between("least_blink_pause", s.least_blink_pause, 0, 3600);
        between("lid_delay", s.lid_delay, 0, 0.2);
        between("lid_up_slowness", s.lid_up_slowness, 0.5, 4);
        between("pupil_unrest", s.pupil_unrest, 0, 0.2);
        between("blink.closing", s.blink.closing, 0.01, 10);
        between("blink.closed", s.blink.closed, 0, 10);
        between("blink.opening", s.blink.opening, 0.01, 10);
        between("main_sequence.fastest", s.main_sequence.fastest, 0.1, 100);
        between("main_sequence.bend", s.main_sequence.bend, 1e-3, 1);
    }

    static double exponential(const Random& random, std::uint64_t index) {
        return -std::log(random.uniform(index));
    }

    /// Returns where the fixation number i is, relative to the point.
    Vec2<double> fixation(const Random& random, std::uint64_t i) const {
        const std::uint64_t k = 8 * i;
        if (random.uniform(k) >= settings_.glance_share)
            return {settings_.near * random.normal(k + 1), settings_.near * random.normal(k + 2)};
        const double far =
            std::min(settings_.farthest, settings_.mean_glance * exponential(random, k + 3));
        const double angle = two_pi * random.uniform(k + 4);
        return {far * std::sin(angle), far * std::cos(angle)};
    }

    void plan_fixations(const Random& random, double seconds) {
        Vec2<double> turned(0.0, 0.0); // by saccades
        double t = 0;
        for (std::uint64_t i = 0; t <= seconds; ++i) {
            const Vec2<double> slip = drifted(t);
            if (settings_.saccades && i > 0) {
                const Vec2<double> to = fixation(random, i);
                const Vec2<double> by(to[0] - turned[0] - slip[0], to[1] - turned[1] - slip[1]);
                saccades_.push_back({t, by});
                turned = Vec2<double>(turned[0] + by[0], turned[1] + by[1]);
            }
            const double lasts =
                settings_.least_fixation + settings_.mean_more * exponential(random, 8 * i + 7);
            if (settings_.drift) {
                // Without saccades, what has drifted away drifts back.
                const double back = settings_.saccades ? 0 : 1 / std::max(1.0, lasts),
                             v = settings_.drift_speed;
                drifts_.push_back({t,
                                   slip,
                                   {v * random.normal(8 * i + 5) - back * slip[0],
                                    v * random.normal(8 * i + 6) - back * slip[1]}});
            }
            t += lasts;
        }
    }

    void plan_blinks(const Random& random, double seconds) {
        if (settings_.blinks_a_minute == 0) return;
        const double least = settings_.blink.duration() + settings_.least_blink_pause;
        const double more = std::max(0.0, 60 / settings_.blinks_a_minute - least);
        double t = more * exponential(random, 0);
        for (std::uint64_t i = 1; t <= seconds; ++i) {
            blinks_.push_back(t);
            t += least + more * exponential(random, i);
        }
    }

    /// Waves of equal size, their frequencies spread over 0.05 to 0.5 Hz by equal ratios.
    void plan_pupils(const Random& random) {
        for (std::uint64_t k = 0; k < std::uint64_t(pupil_waves); ++k) {
            const double decade = (static_cast<double>(k) + random.uniform(2 * k)) / pupil_waves;
            waves_.push_back({0.05 * std::pow(10.0, decade), random.uniform(2 * k + 1)});
        }
    }

    /// Returns the share of a saccade that is done at t, of an eye or of a lid: its middle is
    /// `delay` later, and half the time by which the saccade of a lid `slowness` times as slow
    /// takes longer.
    double travelled(const IdleSaccade& s, double t, double delay, double slowness) const {
        const double amplitude = std::hypot(s.turn[0], s.turn[1]);
        if (amplitude == 0) return 0;
        MainSequence<double> m = settings_.main_sequence;
        const double middle = s.onset + 0.5 * saccade_duration(amplitude, m) + delay +
                              0.5 * (slowness - 1) * amplitude / m.fastest;
        m.fastest /= slowness;
        const double done = amplitude / m.bend / 2 + 20; // then rounding alone is left
        const double x = (t - middle) * m.fastest / m.bend;
        if (x > done) return 1;
        if (x < -done) return 0;
        return detail::saccade_travel(amplitude, t - middle, m) / amplitude;
    }

    Vec2<double> drifted(double t) const {
        const auto next = std::upper_bound(drifts_.begin(), drifts_.end(), t,
                                           [](double x, const Drift& d) { return x < d.begin; });
        if (next == drifts_.begin()) return {0.0, 0.0};
        const Drift& d = *std::prev(next);
        const double since = t - d.begin;
        return {d.before[0] + since * d.speed[0], d.before[1] + since * d.speed[1]};
    }

    IdleSettings settings_;
    std::vector<IdleSaccade> saccades_;
    std::vector<Drift> drifts_;
    std::vector<double> blinks_;
    std::vector<Wave> waves_;
};

} // namespace rye
