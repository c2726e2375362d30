// SPDX-License-Identifier: Apache-2.0
// Heads that a tracker has elsewhere, with its mesh: what their skin tells, against where they are.
#include "corrections/skin_poses.hpp"

#include <cmath>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>
#include <rye/math/rotation.hpp>

#include "corrections/labels.hpp"
#include "data/changed_labels.hpp"
#include "data/samples.hpp"
#include "data/threads.hpp"
#include "right_capture.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

const RightCapture& right() { return right_capture(); }

/// Moves all that a tracker says of a frame by a turn about the head's middle and a shift, both in
/// the head's frame.
void displace(CaptureFrame& f, const Vec3<double>& head, const Vec<double, 6>& by) {
    const Mat3<double> r = so3_exp(Vec3<double>(f.pose.head<3>())),
                       turned = r * so3_exp(Vec3<double>(by.head<3>())) * r.transpose();
    const Vec3<double> middle = f.scale * (r * head) + f.pose.tail<3>(),
                       shift = f.scale * (r * Vec3<double>(by.tail<3>()));
    const auto moved = [&](const Vec3<double>& x) {
        return Vec3<double>(turned * (x - middle) + middle + shift);
    };
    for (Index l = 0; l < f.landmarks.cols(); ++l) f.landmarks.col(l) = moved(f.landmarks.col(l));
    for (Index l = 0; l < f.vertices.cols(); ++l) f.vertices.col(l) = moved(f.vertices.col(l));
    for (CaptureEye& e : f.eyes)
        if (e.centre) e.centre = moved(*e.centre);
    f.pose.tail<3>() = moved(f.pose.tail<3>());
    f.pose.head<3>() = so3_log(Mat3<double>(turned * r));
}

/// Root mean square distance of the eyeballs of training frames from the right ones, beside what
/// all frames share in the head's frame [mm].
double eyes_off(const Capture& c) {
    double sum = 0;
    for (std::size_t e = 0; e < 2; ++e) {
        std::vector<Vec3<double>> off;
        Vec3<double> mean = Vec3<double>::Zero();
        for (const int f : c.train) {
            const CaptureFrame &got = c.frames[static_cast<std::size_t>(f)],
                               &is = right().capture.frames[static_cast<std::size_t>(f)];
            off.push_back(so3_exp(Vec3<double>(is.pose.head<3>())).transpose() *
                          (*got.eyes[e].centre - *is.eyes[e].centre));
            mean += off.back() / static_cast<double>(c.train.size());
        }
        for (const Vec3<double>& x : off)
            sum += (x - mean).squaredNorm() / (2 * static_cast<double>(off.size()));
    }
    return 100 * std::sqrt(sum);
}

/// Labels of a tracker whose mesh is off by 1.2 mm and a degree a frame.
Capture tracked() {
    Capture c = read_capture(right().path);
    const Vec3<double> head = describe_subject(c, preset("cpu")).head_centre;
    const Random random{7};
    for (const int f : c.train) {
        Vec<double, 6> by;
        for (Index k = 0; k < 6; ++k)
            by[k] = (k < 3 ? 0.010 : 0.007) * random.normal(static_cast<std::uint64_t>(6 * f) +
                                                            static_cast<std::uint64_t>(k));
        displace(c.frames[static_cast<std::size_t>(f)], head, by);
    }
    return c;
}

} // namespace

TEST_CASE("skin poses: heads come to where their skin is, and gazes with them") {
    Capture c = tracked();
    const double before = eyes_off(c);
    const std::vector<CaptureFrame> labels = c.frames;
    const LabelFindings found = correct_labels(c, preset("cpu"));
    const double after = eyes_off(c);
    MESSAGE("eyeballs ", before, " mm off, then ", after);
    CHECK(before > 1);
    CHECK(after < 0.6 * before);
    REQUIRE(found.moved.size() == c.train.size());
    CHECK(found.poses);

    const TemporaryFolder folder;
    std::vector<LabelChange> changes;
    for (std::size_t i = 0; i < c.train.size(); ++i) {
        const auto f = static_cast<std::size_t>(c.train[i]);
        changes.push_back(change_between(labels[f], c.frames[f]));
        changes.back().points = found.moved[i];
    }
    write_changed_capture(right().path, folder.path / "out", changes, HeadPoints::kept);
    const Capture written = read_capture(folder.path / "out");
    const auto f = static_cast<std::size_t>(c.train[1]);
    const Vec3<double> was = right().capture.frames[f].landmarks.col(3);
    CHECK((written.frames[f].landmarks.col(3) - found.moved[1].apply(was)).norm() < 1e-5);
    CHECK((written.frames[f].vertices.col(40) -
           found.moved[1].apply(Vec3<double>(right().capture.frames[f].vertices.col(40))))
              .norm() < 1e-5);
}

TEST_CASE("skin poses: labels that are right stay, to the bit") {
    Capture c = read_capture(right().path);
    const LabelFindings found = correct_labels(c, preset("cpu"));
    CHECK(found.moved.empty());
    for (const int f : c.train)
        CHECK(c.frames[static_cast<std::size_t>(f)].pose ==
              right().capture.frames[static_cast<std::size_t>(f)].pose);
}

TEST_CASE(
    "skin poses: nothing without dense vertices, and the same bits on any number of threads") {
    Capture c = tracked();
    const Vec3<double> head = describe_subject(c, preset("cpu")).head_centre;
    set_threads(1);
    const SkinPoses a = skin_poses(c, c.train, head);
    set_threads(3);
    const SkinPoses b = skin_poses(c, c.train, head);
    set_threads(0);
    REQUIRE(a.moved.size() == c.train.size());
    CHECK(a.after < a.before);
    for (std::size_t i = 0; i < a.moved.size(); ++i) CHECK(a.moved[i] == b.moved[i]);
    for (CaptureFrame& f : c.frames) f.vertices.resize(3, 0);
    CHECK(skin_poses(c, c.train, head).moved.empty());
}
