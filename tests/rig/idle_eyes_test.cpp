// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/idle_eyes.hpp>

#include <doctest/doctest.h>

#include <numbers>
#include <vector>

#include <rye/autodiff/dual.hpp>

using namespace rye;

namespace {

constexpr double idle_degree = std::numbers::pi / 180;

bool same_moment(const IdleMoment& a, const IdleMoment& b) {
    return a.turn == b.turn && a.closed == b.closed && a.lid_behind == b.lid_behind &&
           a.pupil == b.pupil;
}

IdleSettings only(bool IdleSettings::*part) {
    IdleSettings s;
    s.saccades = s.drift = s.blinks = s.lid_lag = s.pupils = false;
    if (part != nullptr) s.*part = true;
    return s;
}

} // namespace

TEST_CASE("saccades: their measured peak speed is the main sequence's, and people's") {
    double worst = 0;
    for (const double degrees : {0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0}) {
        const double a = degrees * idle_degree, end = 2 * saccade_duration(a);
        double peak = 0;
        for (double t = -end; t < end; t += 1e-4)
            peak = std::max(
                peak,
                (detail::saccade_travel(a, t + 5e-5) - detail::saccade_travel(a, t - 5e-5)) / 1e-4);
        worst = std::max(worst, std::abs(peak / saccade_peak_speed(a) - 1));
    }
    MESSAGE("peak speed, measured by differences, is the formula's to ", worst);
    CHECK(worst < 1e-3);
    // Hopf et al. 2018: means of 100 people [degrees, degrees/s], and their least deviation.
    for (const auto& [degrees, speed, deviation] : {std::tuple{5, 213, 29},
                                                    {15, 352, 50},
                                                    {30, 455, 67},
                                                    {5, 208, 36},
                                                    {10, 303, 50},
                                                    {20, 391, 71}})
        CHECK(std::abs(saccade_peak_speed(degrees * idle_degree) / idle_degree - speed) <
              deviation);
}

TEST_CASE("saccades: from 0 to the amplitude, within the duration, by duals too") {
    for (const double degrees : {0.0, 0.3, 4.0, 25.0}) {
        const double a = degrees * idle_degree, d = saccade_duration(a),
                     c = MainSequence<double>{}.bend;
        CHECK(std::abs(detail::saccade_travel(a, -d / 2)) <= c / 1600);
        CHECK(std::abs(detail::saccade_travel(a, d / 2) - a) <= c / 1600);
        CHECK(detail::saccade_travel(a, 0.0) == doctest::Approx(a / 2));
        CHECK(detail::saccade_travel(a, 2.0) == doctest::Approx(a));
        CHECK(std::abs(detail::saccade_travel(a, -2.0)) < 1e-90);
    }
    using D = Dual<double, 1>;
    const double a = 10 * idle_degree;
    CHECK(detail::saccade_travel(D(a), D::variable(0.0, 0)).d[0] ==
          doctest::Approx(saccade_peak_speed(a)));
    CHECK(saccade_peak_speed(10 * float(idle_degree)) ==
          doctest::Approx(saccade_peak_speed(a)).epsilon(1e-6));
}

TEST_CASE("blinks: 0.1 to 0.5 s, closed once, faster down than up") {
    const BlinkPhases<double> p;
    CHECK(p.duration() >= 0.1);
    CHECK(p.duration() <= 0.5);
    CHECK(detail::blink_closure(0.0) == 0);
    CHECK(detail::blink_closure(-1.0) == 0);
    CHECK(detail::blink_closure(p.closing) == 1);
    CHECK(std::abs(detail::blink_closure(p.duration())) <= 1e-15);
    CHECK(std::abs(detail::blink_closure(5.0)) <= 1e-15);
    double down = 0, up = 0, above_half = 0;
    for (double t = 0; t < p.duration(); t += 1e-4) {
        const double speed =
            (detail::blink_closure(t + 5e-5) - detail::blink_closure(t - 5e-5)) / 1e-4;
        down = std::max(down, speed);
        up = std::max(up, -speed);
        above_half += detail::blink_closure(t) > 0.5 ? 1e-4 : 0;
    }
    CHECK(down > 1.4 * up); // Sforza et al. 2008: 40 to 47 percent
    CHECK(above_half == doctest::Approx(p.closed + (p.closing + p.opening) / 2).epsilon(0.01));
}

TEST_CASE("the vestibulo-ocular reflex keeps the gaze in the world") {
    const Mat3<double> before = so3_exp(Vec3<double>(0.1, -0.2, 0.05)),
                       now = so3_exp(Vec3<double>(-0.15, 0.3, 0.1));
    const Vec3<double> gaze = gaze_vector(0.1, -0.2);
    const Vec3<double> kept = steadied_gaze(before, now, gaze);
    CHECK((now * kept - before * gaze).norm() <= 1e-14);
    CHECK(steadied_gaze(before, now, gaze, 0.0) == gaze);
    const double whole = angular_error(kept, gaze),
                 half = angular_error(steadied_gaze(before, now, gaze, 0.5), gaze);
    CHECK(half < whole);
    CHECK(half > 0.3 * whole);
}

TEST_CASE("idle eyes: the same seed gives the same bits, in any order of times; another does not") {
    const IdleEyes a({}, 7, 30), b({}, 7, 30), longer({}, 7, 60), other({}, 8, 30);
    int differ = 0;
    for (int i = 300; i >= 0; --i) {
        const double t = 0.1 * i;
        CHECK(same_moment(a.at(t), b.at(t)));
        if (t < 29) CHECK(same_moment(a.at(t), longer.at(t)));
        differ += same_moment(a.at(t), other.at(t)) ? 0 : 1;
    }
    CHECK(differ > 250);
}

TEST_CASE("idle eyes: what is off is nothing, to the bit") {
    const IdleEyes none(only(nullptr), 7, 60);
    const IdleEyes all({}, 7, 60);
    const IdleEyes no_lag(
        [] {
            IdleSettings s;
            s.lid_lag = false;
            return s;
        }(),
        7, 60);
    const IdleEyes lids(only(&IdleSettings::blinks), 7, 60);
    for (double t = 0; t < 60; t += 0.013) {
        CHECK(same_moment(none.at(t), IdleMoment{}));
        const IdleMoment m = all.at(t), n = no_lag.at(t), l = lids.at(t);
        CHECK(n.turn == m.turn);
        CHECK(n.closed == m.closed);
        CHECK(n.lid_behind == 0);
        CHECK(l.closed == m.closed);
        CHECK(l.turn == Vec2<double>(0.0, 0.0));
    }
}

TEST_CASE("idle eyes: saccades keep the main sequence, fixations their range") {
    IdleSettings s = only(&IdleSettings::saccades);
    const IdleEyes eyes(s, 3, 200);
    REQUIRE(eyes.saccades().size() > 100);
    double least = 1e9, most = 0;
    for (const IdleSaccade& saccade : eyes.saccades()) {
        const double a = std::hypot(saccade.turn[0], saccade.turn[1]);
        if (a < 0.5 * idle_degree || saccade.onset > 199) continue;
        double peak = 0;
        for (double t = saccade.onset; t < saccade.onset + saccade_duration(a); t += 2e-4) {
            const Vec2<double> d = eyes.at(t + 5e-5).turn - eyes.at(t - 5e-5).turn;
            peak = std::max(peak, d.norm() / 1e-4);
        }
        least = std::min(least, peak / saccade_peak_speed(a));
        most = std::max(most, peak / saccade_peak_speed(a));
    }
    MESSAGE("measured peak speed / main sequence: ", least, " to ", most);
    CHECK(least > 0.995);
    CHECK(most < 1.005);
    s.drift = true;
    const IdleEyes drifting(s, 3, 200);
    double wide = 0;
    for (double t = 0; t < 200; t += 0.05) wide = std::max(wide, drifting.at(t).turn.norm());
    CHECK(wide > 8 * idle_degree);
    CHECK(wide < 19 * idle_degree);
    const IdleEyes still(only(&IdleSettings::drift), 3, 600);
    double slow = 0, away = 0;
    for (double t = 0; t < 600; t += 0.05) {
        slow = std::max(slow, (still.at(t + 1e-3).turn - still.at(t).turn).norm() / 1e-3);
        away = std::max(away, still.at(t).turn.norm());
    }
    CHECK(slow < 7 * idle_degree); // [rad/s], far from a saccade's
    CHECK(away < 6 * idle_degree);
}

TEST_CASE("idle eyes: blinks by the minute, never in one another") {
    const IdleEyes eyes(only(&IdleSettings::blinks), 5, 3600);
    const auto& begins = eyes.blinks();
    const double a_minute = static_cast<double>(begins.size()) / 60;
    MESSAGE(a_minute, " blinks a minute");
    CHECK(a_minute > 15);
    CHECK(a_minute < 19);
    for (std::size_t i = 1; i < begins.size(); ++i)
        CHECK(begins[i] - begins[i - 1] > BlinkPhases<double>{}.duration());
    CHECK(eyes.at(begins[3] + BlinkPhases<double>{}.closing).closed == 1);
    CHECK(eyes.at(begins[3] - 1e-9).closed == 0);
}

TEST_CASE("idle eyes: the lid is behind in a vertical saccade, more so upward, and arrives") {
    IdleSettings s;
    s.drift = s.blinks = false;
    const IdleEyes eyes(s, 11, 300);
    double up = 0, down = 0;
    for (const IdleSaccade& saccade : eyes.saccades()) {
        if (std::abs(saccade.turn[0]) < 3 * idle_degree || saccade.onset > 299) continue;
        double most = 0;
        for (double t = saccade.onset; t < saccade.onset + 0.15; t += 1e-3) {
            const double behind = eyes.at(t).lid_behind / saccade.turn[0];
            CHECK(behind < 0.01); // never ahead of the eye
            most = std::max(most, -behind);
        }
        // The time by which the lid is late where the eye is fastest.
        const double a = std::hypot(saccade.turn[0], saccade.turn[1]);
        double& late = saccade.turn[0] > 0 ? up : down;
        late = std::max(late, most * a / saccade_peak_speed(a));
        CHECK(std::abs(eyes.at(saccade.onset + 0.199).lid_behind) < 0.2 * idle_degree);
    }
    CHECK(down > 0.0045);
    CHECK(down < 0.0055);
    CHECK(up > 0.007);
    CHECK(up < 0.015);
}

TEST_CASE("idle eyes: pupils swing slowly about their mean, by the deviation that is set") {
    IdleSettings s = only(&IdleSettings::pupils);
    for (const double unrest : {0.0, 0.03, 0.06}) {
        s.pupil_unrest = unrest;
        const IdleEyes eyes(s, 5, 2000);
        double sum = 0, squares = 0, steepest = 0;
        constexpr int count = 20000;
        for (int i = 0; i < count; ++i) {
            const double x = eyes.at(0.1 * i).pupil - 1;
            sum += x;
            squares += x * x;
            steepest = std::max(steepest, std::abs(eyes.at(0.1 * i + 0.01).pupil - 1 - x) / 0.01);
            CHECK(std::abs(x) <= 3.5 * unrest);
        }
        CHECK(std::abs(sum / count) <= 0.05 * unrest);
        CHECK(std::sqrt(squares / count) == doctest::Approx(unrest).epsilon(0.05));
        // Waves of at most 0.5 Hz, six of them at most in step.
        CHECK(steepest <= 3.5 * unrest * 2 * std::numbers::pi * 0.5);
        CHECK(steepest >= unrest);
    }
}

TEST_CASE("idle eyes: settings out of range are named") {
    const auto fault = [](auto change, double seconds = 1) {
        IdleSettings s;
        change(s);
        try {
            const IdleEyes eyes(s, 1, seconds);
        } catch (const Error& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    CHECK(fault([](IdleSettings&) {}).empty());
    CHECK(fault([](IdleSettings&) {}, std::nan("")).find("IdleEyes: 'seconds': got") == 0);
    CHECK(fault([](IdleSettings& s) { s.least_fixation = 0; }) ==
          "IdleEyes: 'least_fixation': got 0, expected a number from 0.05 to 3600");
    CHECK(fault([](IdleSettings& s) { s.pupil_unrest = 0.3; }) ==
          "IdleEyes: 'pupil_unrest': got 0.3, expected a number from 0 to 0.2");
    CHECK(fault([](IdleSettings& s) { s.blink.opening = -1; }).find("'blink.opening'") !=
          std::string::npos);
}
