// SPDX-License-Identifier: Apache-2.0
// wrong_labels make CAPTURE OUT [SEED]: a copy whose training frames have the errors of trackers:
// gazes 4 degrees off (both eyes alike) and 2 more (each eye), head poses 0.6 degrees and 1 mm,
// half of the expression coefficients that differ between frames 0.06; normally distributed, their
// root mean squares as stated; a unit is taken as 100 mm.
// wrong_labels compare CAPTURE OTHER: how far the labels of OTHER's training frames are from those
// of CAPTURE.
#include <cmath>
#include <cstdio>
#include <exception>
#include <string>

#include <rye/core/random.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/changed_labels.hpp"
#include "data/validate.hpp"
#include "training/refine.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

constexpr double degree = 0.017453292519943295;

void make(const std::string& from, const std::string& out, std::uint64_t seed) {
    const Capture capture = read_valid_capture(from);
    const std::vector<Index> active = refined_coefficients(capture, RefinedExpression::active);
    const Random random{seed, 17};
    std::uint64_t drawn = 0;
    const auto normal = [&](double rms) { return rms * random.normal(drawn++); };
    std::vector<LabelChange> changes;
    for (const int f : capture.train) {
        LabelChange c;
        const CaptureFrame& frame = capture.frames[static_cast<std::size_t>(f)];
        c.frame = frame.id;
        const double both = 4 * degree / std::sqrt(2.0), each = 2 * degree / std::sqrt(2.0);
        const Vec2<double> alike(normal(both), normal(both));
        for (Vec2<double>& gaze : c.gaze) gaze = alike + Vec2<double>(normal(each), normal(each));
        for (Index i = 0; i < 3; ++i) c.pose[i] = normal(0.6 * degree / std::sqrt(3.0));
        for (Index i = 3; i < 6; ++i) c.pose[i] = normal(0.01 / std::sqrt(3.0));
        c.expression.assign(frame.expression.size(), 0);
        for (std::size_t k = 0; k < active.size(); k += 2)
            c.expression[static_cast<std::size_t>(active[k])] = normal(0.06);
        changes.push_back(c);
    }
    write_changed_capture(from, out, changes, HeadPoints::moved);
}

/// Sum and sum of squares of errors.
struct Errors {
    double sum = 0, squares = 0;
    int count = 0;
    void add(double x) { sum += x, squares += x * x, ++count; }
    double mean() const { return sum / count; }
    double rms() const { return std::sqrt(squares / count); }
};

void compare(const std::string& right, const std::string& other) {
    const Capture a = read_valid_capture(right), b = read_valid_capture(other);
    require(a.frame_count() == b.frame_count(), other, "has other frames");
    Errors gaze, rotation, translation, expression, cameras;
    for (const int f : a.train) {
        const CaptureFrame &p = a.frames[static_cast<std::size_t>(f)],
                           &q = b.frames[static_cast<std::size_t>(f)];
        for (std::size_t e = 0; e < 2; ++e)
            gaze.add(angular_error(p.eyes[e].optical, q.eyes[e].optical) / degree);
        const Mat3<double> turn = so3_exp(Vec3<double>(p.pose.head<3>())).transpose() *
                                  so3_exp(Vec3<double>(q.pose.head<3>()));
        rotation.add(std::acos(std::min(1.0, (turn.trace() - 1) / 2)) / degree);
        translation.add(100 * (p.pose - q.pose).tail<3>().norm());
        for (std::size_t k = 0; k < p.expression.size(); ++k)
            expression.add(static_cast<double>(p.expression[k] - q.expression[k]));
        for (int c = 0; c < std::min(a.camera_count(), b.camera_count()); ++c) {
            if (!a.view(f, c).present || !b.view(f, c).present) continue;
            for (Index l = 0; l < p.landmarks.cols(); ++l) { // where either camera shows them
                const Vec3<double> x = p.landmarks.col(l);
                cameras.add((a.camera(f, c).project_point(x) - b.camera(f, c).project_point(x))
                                .head<2>()
                                .norm());
            }
        }
    }
    std::printf("gaze %.2f deg (rms %.2f), head %.3f deg and %.2f mm, expression rms %.4f, "
                "cameras %.3f px: %s\n",
                gaze.mean(), gaze.rms(), rotation.mean(), translation.mean(), expression.rms(),
                cameras.mean(), other.c_str());
}

} // namespace

int main(int argc, char** argv) {
    try {
        const std::string what = argc > 1 ? argv[1] : "";
        if (what == "make" && (argc == 4 || argc == 5))
            make(argv[2], argv[3], argc == 5 ? std::stoull(argv[4]) : 1);
        else if (what == "compare" && argc == 4)
            compare(argv[2], argv[3]);
        else
            throw Error("wrong_labels: expected make CAPTURE OUT [SEED] or compare CAPTURE OTHER");
    } catch (const std::exception& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
    return 0;
}
