// SPDX-License-Identifier: Apache-2.0
// wrong_labels compare CAPTURE OTHER [RUN]: how far the labels of OTHER's training frames are from
// those of CAPTURE; with the cameras that a run has corrected.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <string>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/corrected_cameras.hpp"
#include "data/validate.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

constexpr double degree = 0.017453292519943295;

/// Sum and sum of squares of errors.
struct Errors {
    double sum = 0, squares = 0;
    int count = 0;
    void add(double x) { sum += x, squares += x * x, ++count; }
    double mean() const { return sum / count; }
    double rms() const { return std::sqrt(squares / count); }
};

void compare(const std::string& right, const std::string& other, const std::string& run) {
    const Capture a = read_valid_capture(right);
    Capture b = read_valid_capture(other);
    if (!run.empty()) take_corrected(b, load_corrected_cameras(run));
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
        if (argc < 4 || argc > 5 || std::string(argv[1]) != "compare")
            throw Error("wrong_labels: expected compare CAPTURE OTHER [RUN]");
        compare(argv[2], argv[3], argc == 5 ? argv[4] : "");
    } catch (const std::exception& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
    return 0;
}
