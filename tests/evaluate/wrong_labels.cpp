// SPDX-License-Identifier: Apache-2.0
// wrong_labels compare CAPTURE OTHER [RUN]: how far the labels of OTHER's training frames are from
// those of CAPTURE; with the cameras that a run has corrected. Of cameras also what is left beside
// the one motion and zoom of the head that explains most of it: what they share.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include <Eigen/Cholesky>

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

/// A landmark that two cameras show.
struct Shown {
    Pinhole<double> right, other;
    Vec3<double> at;
};

/// A motion and a zoom of the head about a point [world unit].
struct Similarity {
    Vec3<double> about = Vec3<double>::Zero();
    Vec<double, 7> x = Vec<double, 7>::Zero(); ///< rotation, translation, logarithm of the zoom

    Vec3<double> moved(const Vec3<double>& at) const {
        const Vec3<double> turn = x.head<3>(), shift = x.segment<3>(3);
        return std::exp(x[6]) * (so3_exp(turn) * (at - about)) + about + shift;
    }
    Vec2<double> apart(const Shown& s) const {
        return (s.right.project_point(moved(s.at)) - s.other.project_point(s.at)).head<2>();
    }
};

/// Returns what right cameras show most nearly as the others show the head.
Similarity shared_by(const std::vector<Shown>& all) {
    Similarity found;
    for (const Shown& s : all) found.about += s.at / static_cast<double>(all.size());
    for (int step = 0; step < 3; ++step) {
        Mat<double, 7, 7> matrix = 1e-9 * Mat<double, 7, 7>::Identity();
        Vec<double, 7> gradient = Vec<double, 7>::Zero();
        for (const Shown& s : all) {
            const Vec2<double> off = found.apart(s);
            Mat<double, 2, 7> d;
            for (Index k = 0; k < 7; ++k) {
                constexpr double small = 1e-6;
                Similarity by = found;
                by.x[k] += small;
                d.col(k) = (by.apart(s) - off) / small;
            }
            matrix += d.transpose() * d;
            gradient += d.transpose() * off;
        }
        found.x -= matrix.ldlt().solve(gradient);
    }
    return found;
}

void compare(const std::string& right, const std::string& other, const std::string& run) {
    const Capture a = read_valid_capture(right);
    Capture b = read_valid_capture(other);
    if (!run.empty()) take_corrected(b, load_corrected_cameras(run));
    require(a.frame_count() == b.frame_count(), other, "has other frames");
    Errors gaze, rotation, translation, expression, cameras, own;
    std::vector<Shown> shown;
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
                shown.push_back({a.camera(f, c), b.camera(f, c), p.landmarks.col(l)});
                cameras.add(Similarity{}.apart(shown.back()).norm());
            }
        }
    }
    const Similarity shared = shared_by(shown);
    for (const Shown& s : shown) own.add(shared.apart(s).norm());
    std::printf(
        "gaze %.2f deg (rms %.2f), head %.3f deg and %.2f mm, expression rms %.4f, "
        "cameras %.3f px, %.3f px beside what they share: %.3f deg, %.2f %.2f %.2f mm, "
        "zoom %.3f %%: %s\n",
        gaze.mean(), gaze.rms(), rotation.mean(), translation.mean(), expression.rms(),
        cameras.mean(), own.mean(), shared.x.head<3>().norm() / degree, 100 * shared.x[3],
        100 * shared.x[4], 100 * shared.x[5], 100 * shared.x[6], other.c_str());
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
