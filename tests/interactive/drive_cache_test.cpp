// SPDX-License-Identifier: Apache-2.0
// Driven Gaussians kept from frame to frame, of every kind of avatar that a cache takes.
#include <rye/interactive/drive_cache.hpp>

#include <algorithm>
#include <vector>

#include <doctest/doctest.h>

#include <rye/avatar/trained.hpp>
#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>
#include <rye/core/thread_pool.hpp>
#include <rye/rig/gaze_features.hpp>
#include <rye/rig/gaze_mechanisms.hpp>

#include "../support/effect_sets.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using WithKappa = More<PaperEffects, Kappa>;
using WithDrivenEyes = More<PaperEffects, EyesBy<DrivenFeatures>>;
using WithLight = More<PaperEffects, HeadShading>;
using OfFeatures = More<PaperEffects, GazeBy<FixedEye>, EyesBy<RotatedFeatures>>;
using Talk = Less<PaperEffects, PoseResidual>;
using Look = Effects<HeadPose, LeftGaze, RightGaze, Periocular, CornealBulge>;
using OneEye = Effects<Expression, RightGaze, Kappa, EyesBy<DrivenFeatures>>;

using WithHighlights = More<PaperEffects, Glint>;
using WithLids = More<PaperEffects, LidShadow>;
using WithRefraction = More<PaperEffects, CornealRefraction>;
using RefractedPupil = Effects<HeadPose, EyeOffset, RightGaze, Pupil, CornealRefraction, LidShadow>;
using LidsAlone = Effects<HeadPose, Expression, EyeOffset, Pupil, LeftGaze, LidShadow>;

static_assert(KeptFromFrameToFrame<PaperEffects> && KeptFromFrameToFrame<TrainedEffects> &&
              KeptFromFrameToFrame<Effects<>> && KeptFromFrameToFrame<WithHighlights>);
static_assert(KeptFromFrameToFrame<WithRefraction>);

inline AvatarConfig eyes_apart_config() {
    AvatarConfig c = tiny_config(); // skin that follows each gaze alone
    c.gaze_near = 0.02;
    c.gaze_far = 0.06;
    return c;
}

/// An avatar and what drives it.
template <class T, EffectSet E>
struct Puppet {
    AvatarConfig config = eyes_apart_config();
    LandmarkRoles roles = tiny_roles();
    TwoStream<T, E> avatar;
    Drivers<T> drivers = tiny_drivers<T>();
    Pinhole<double> camera = tiny_camera(8, 8);
    std::array<T, 2> pupil{T(1), T(1)};

    explicit Puppet(const TwoStream<double, E>& a) : avatar(lifted<T>(a)) {}
    Drivers<T, E> own() const {
        return with_pupils(seen_from(restricted<E>(drivers), camera), pupil);
    }
};

/// A puppet with the parts of E, none of them neutral.
template <class T, EffectSet E>
Puppet<T, E> puppet() {
    return Puppet<T, E>(avatar_with_parts<E>());
}

/// A puppet with fewer effects than the paper's, the others held.
template <class T, EffectSet E>
Puppet<T, E> held_puppet() {
    return Puppet<T, E>(held<E>(ScalarBackend<>{}, restricted<PaperEffects>(avatar_of_all()),
                                eyes_apart_config(), tiny_roles(), tiny_drivers<double>()));
}

/// The bits of drive(); columns that changed are listed.
template <class B, class T, class E>
void check(const B& backend, DriveCache<B, T, E>& cache, const Puppet<T, E>& p) {
    const Gaussians<T> before = cache.gaussians();
    TwoStreamTrace<T, E> trace;
    drive(backend, p.avatar, {p.config, p.roles, p.own()}, trace);
    const Gaussians<T>& kept = cache.update(p.own());
    std::vector<bool> listed(static_cast<std::size_t>(kept.count()), false);
    for (const Index i : cache.changed()) listed[static_cast<std::size_t>(i)] = true;
    CHECK(std::is_sorted(cache.changed().begin(), cache.changed().end()));
    Gaussians<T>::fields(
        [&](const std::string& name, const auto& a, const auto& b, const auto& old) {
            INFO(name);
            CHECK(same_bits(a, b));
            if (old.size() != a.size()) return;
            for (Index i = 0; i < a.cols(); ++i)
                if (!listed[static_cast<std::size_t>(i)])
                    CHECK(same_bits(Columns<T>(a.col(i)), Columns<T>(old.col(i))));
        },
        kept, trace.gaussians, before);
}

/// Changes any of the drivers or the camera, alone or together, or nothing.
template <class T, class E>
void change(Puppet<T, E>& p, int step) {
    Drivers<T>& d = p.drivers;
    const Random random{static_cast<std::uint64_t>(step) + 90, 3};
    std::uint64_t k = 0;
    const auto chance = [&](double share) { return random.uniform(k++) < share; };
    const auto any = [&] { return static_cast<T>(random.uniform(k++) - 0.5); };
    const bool all = chance(0.1);
    for (std::size_t e = 0; e < 2; ++e)
        if (all || chance(0.4)) d.gaze[e] = Vec3<T>(any(), any(), T(1)).normalized();
    if (all || chance(0.25)) d.expression[1] += any();
    if (all || chance(0.2)) d.pose[static_cast<Index>(random.below(k++, 3))] += T(0.3) * any();
    if (all || chance(0.1)) d.pose[3 + static_cast<Index>(random.below(k++, 3))] += T(0.2) * any();
    if (all || chance(0.1)) d.scale = T(1) + T(0.2) * any();
    if (all || chance(0.2))
        p.camera.camera_from_world.translation[0] += 0.3 * static_cast<double>(any());
    for (T& pupil : p.pupil)
        if (all || chance(0.3)) pupil = chance(0.3) ? T(1) : T(1.2) + any();
}

template <class B, class T, class E>
void follow(const B& backend, Puppet<T, E> p, int steps) {
    DriveCache<B, T, E> cache(backend, p.avatar, p.config, p.roles);
    check(backend, cache, p);
    for (int step = 0; step < steps; ++step) {
        INFO(step);
        change(p, step);
        check(backend, cache, p);
    }
    cache.reset();
    check(backend, cache, p);
    CHECK(cache.bytes() > 0);
}

} // namespace

TEST_CASE_TEMPLATE("drive cache: the bits of drive() over random drivers, whatever is on", E,
                   PaperEffects, WithKappa, WithDrivenEyes, WithLight, OfFeatures, WithHighlights,
                   WithLids, LidsAlone, WithRefraction, RefractedPupil, TrainedEffects) {
    follow(XsimdBackend<>{}, puppet<float, E>(), 40);
}

TEST_CASE_TEMPLATE("drive cache: the bits of drive() of avatars with fewer effects", E, Talk, Look,
                   Effects<HeadPose>, Effects<>) {
    follow(XsimdBackend<>{}, held_puppet<float, E>(), 20);
}

TEST_CASE("drive cache: the bits of drive() with one eye, in double, on one thread and two") {
    follow(ScalarBackend<>{}, puppet<double, OneEye>(), 20);
    follow(ScalarBackend<>{}, puppet<double, TrainedEffects>(), 20);
    for (const int threads : {1, 2}) {
        ThreadPool pool(threads);
        follow(XsimdBackend{pool.threads()}, puppet<float, TrainedEffects>(), 15);
    }
}

TEST_CASE("drive cache: eyes whose features alone change with the expression are listed") {
    Puppet<float, TrainedEffects> p = puppet<float, TrainedEffects>();
    p.avatar.eyes.offset.mlp.weight.back().setZero();
    p.avatar.eyes.offset.mlp.bias.back().setZero();
    DriveCache<XsimdBackend<>, float, TrainedEffects> cache({}, p.avatar, p.config, p.roles);
    check(XsimdBackend<>{}, cache, p);
    p.drivers.expression[0] += 0.25F;
    check(XsimdBackend<>{}, cache, p);
    CHECK(cache.work().eyes == 0);
    CHECK(cache.changed().back() == cache.gaussians().count() - 1);
}

TEST_CASE("drive cache: of a trained avatar is done what its parts read of what changed") {
    Puppet<float, TrainedEffects> p = puppet<float, TrainedEffects>();
    p.avatar.eyes.lid_shadow = p.avatar.eyes.lid_line = {};
    p.avatar.eyes.optics.index = {};
    p.avatar.view_color = {};
    DriveCache<XsimdBackend<>, float, TrainedEffects> cache({}, p.avatar, p.config, p.roles);
    const auto update = [&] {
        cache.update(p.own());
        return cache.work();
    };
    const Index face = p.avatar.face.position.cols();
    const auto points = [&](std::size_t driver) {
        return static_cast<Index>(cache.rest().moved[driver].points.size());
    };
    const Index left = p.avatar.eyes.points_of(0), eyes = p.avatar.eyes.position.cols();
    DriveWork w = update();
    CHECK(w.networks == 13);
    CHECK(w.eyes == 2);
    CHECK(w.lit == face + 2);
    w = update();
    CHECK(w.networks == 0);
    CHECK(cache.changed().empty());

    p.drivers.gaze[0] = Vec3<float>(0.1F, 0.2F, 0.9F).normalized();
    w = update();
    REQUIRE(points(2) > 0);
    CHECK(w.networks == 3);
    CHECK(w.points == 2 * points(2) + left);
    CHECK(w.summed == points(2));
    CHECK(w.eyes == 1);
    CHECK(w.lit == 0);
    CHECK(static_cast<Index>(cache.changed().size()) == points(2) + left);

    p.drivers.expression[2] += 0.5F;
    w = update();
    CHECK(w.networks == 6);
    CHECK(w.points == 3 * points(0) + 1 + eyes);
    CHECK(w.lit == 0);

    p.drivers.pose[4] += 0.1F; // a translation: no other light
    w = update();
    CHECK(w.networks == 6);
    CHECK(w.lit == 0);
    CHECK(static_cast<Index>(cache.changed().size()) == face + eyes);
    p.drivers.pose[1] += 0.1F;
    w = update();
    CHECK(w.networks == 6);
    CHECK(w.lit == face + 2);

    p.camera.camera_from_world.translation[0] += 0.1; // highlights alone
    w = update();
    CHECK(w.networks == 0);
    CHECK(w.eyes == 0);
    CHECK(static_cast<Index>(cache.changed().size()) == eyes);

    p.drivers.scale = 1.25F;
    w = update();
    CHECK(w.networks == 0);
    CHECK(w.lit == 0);
    CHECK(static_cast<Index>(cache.changed().size()) == face + eyes);

    for (const float ratio : {1.4F, 1.0F}) { // one pupil: its eyeball alone
        p.pupil[1] = ratio;
        w = update();
        CHECK(w.networks == 0);
        CHECK(w.summed == 0);
        CHECK(w.eyes == 1);
        CHECK(static_cast<Index>(cache.changed().size()) == eyes - left);
        CHECK(cache.changed().front() == face + left);
    }
    p.pupil[1] = 3;
    CHECK_THROWS_AS(update(), Error);
    p.pupil[1] = 1;
    CHECK(update().eyes == 2); // all anew after the fault
}

TEST_CASE("drive cache: a camera that moves takes the refracted eyes along, without networks") {
    Puppet<float, WithRefraction> p = puppet<float, WithRefraction>();
    DriveCache<XsimdBackend<>, float, WithRefraction> cache({}, p.avatar, p.config, p.roles);
    check(XsimdBackend<>{}, cache, p);
    const Gaussians<float> before = cache.gaussians();
    p.camera.camera_from_world.translation[0] += 0.5;
    check(XsimdBackend<>{}, cache, p);
    CHECK(cache.work().networks == 0);
    CHECK(cache.work().summed == 0);
    CHECK(cache.work().eyes == 2);
    CHECK(static_cast<Index>(cache.changed().size()) == p.avatar.eyes.position.cols());
    CHECK(!(cache.gaussians().mean == before.mean));
    cache.update(p.own());
    CHECK(cache.changed().empty());
    p.avatar.eyes.optics.index = {};
    cache.reset();
    cache.update(p.own());
    p.camera.camera_from_world.translation[0] += 0.5;
    cache.update(p.own());
    CHECK(cache.changed().empty());
}

TEST_CASE("drive cache: a lid that moves changes the colours of its eye alone, without networks") {
    using E = Effects<HeadPose, Expression, LeftGaze, RightGaze, LidShadow>;
    Puppet<float, E> p = puppet<float, E>();
    p.config.exp_far = 0.6; // expressions move both lids
    DriveCache<XsimdBackend<>, float, E> cache({}, p.avatar, p.config, p.roles);
    check(XsimdBackend<>{}, cache, p);
    const Index face = p.avatar.face.position.cols(), left = p.avatar.eyes.points_of(0);
    const auto all_of = [&](const std::vector<Index>& changed, Index eye) {
        const Index from = face + (eye == 0 ? 0 : left);
        Index n = 0;
        for (const Index i : changed) n += i >= from && i < from + p.avatar.eyes.points_of(eye);
        return n == p.avatar.eyes.points_of(eye);
    };
    p.drivers.expression[0] += 0.25F;
    check(XsimdBackend<>{}, cache, p);
    CHECK(cache.work().networks == 3);
    CHECK(cache.work().eyes == 0);
    CHECK(all_of(cache.changed(), 0));
    CHECK(all_of(cache.changed(), 1));
    p.drivers.gaze[1] = Vec3<float>(0.1F, 0.2F, 0.9F).normalized();
    check(XsimdBackend<>{}, cache, p);
    CHECK(cache.work().networks == 0);
    CHECK(cache.work().eyes == 1);
    CHECK_FALSE(all_of(cache.changed(), 0));
    CHECK(all_of(cache.changed(), 1));
}

TEST_CASE("drive cache: another view changes all colours by the view, without networks") {
    using E = More<PaperEffects, HeadShading, ViewColor>;
    Puppet<float, E> p = puppet<float, E>();
    DriveCache<XsimdBackend<>, float, E> cache({}, p.avatar, p.config, p.roles);
    check(XsimdBackend<>{}, cache, p);
    const Gaussians<float> before = cache.gaussians();
    p.camera.camera_from_world.translation[0] += 0.5;
    check(XsimdBackend<>{}, cache, p);
    CHECK(cache.work().networks == 0);
    CHECK(cache.work().eyes == 0);
    CHECK(Index(cache.changed().size()) == before.count());
    CHECK(cache.gaussians().mean == before.mean);
    CHECK(cache.gaussians().feature != before.feature);
    p.drivers.gaze[1] = Vec3<float>(0.1F, 0.2F, 0.9F).normalized();
    check(XsimdBackend<>{}, cache, p);
    CHECK(Index(cache.changed().size()) < before.count());
    cache.update(p.own());
    CHECK(cache.changed().empty());
}

TEST_CASE("drive cache: what has no parameters takes no work") {
    Puppet<float, TrainedEffects> p = puppet<float, TrainedEffects>();
    p.avatar.eyes.kappa = {};
    p.avatar.shading = {};
    p.avatar.view_color = {};
    p.avatar.eyes.networks = {};
    p.avatar.eyes.optics = {};
    p.avatar.eyes.lid_shadow = p.avatar.eyes.lid_line = {};
    const TwoStream<float> paper = restricted<PaperEffects>(p.avatar);
    DriveCache<XsimdBackend<>, float, TrainedEffects> cache({}, p.avatar, p.config, p.roles);
    DriveCache<XsimdBackend<>, float> papers({}, paper, p.config, p.roles);
    for (int step = 0; step < 30; ++step) {
        INFO(step);
        cache.update(p.own());
        papers.update(p.drivers);
        CHECK(cache.work().networks == papers.work().networks);
        CHECK(cache.work().points == papers.work().points);
        CHECK(cache.work().summed == papers.work().summed);
        CHECK(cache.work().eyes == papers.work().eyes);
        CHECK(cache.work().lit == 0);
        CHECK(cache.changed() == papers.changed());
        change(p, step);
        p.camera = tiny_camera(8, 8);
        p.pupil = {1, 1};
    }
    CHECK(cache.bytes() == papers.bytes());
}
