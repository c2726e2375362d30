// SPDX-License-Identifier: Apache-2.0
// landmarks_of_expressions CAPTURE: how far the regression of stage 1's mixed frames, of the
// training frames, is from the landmarks of the training and of the test frames, by what it knows
// of expressions, as a table in Markdown; and how far lids follow the gaze by it, by labels as they
// are and as training corrects them. docs/results/experiments.md and evaluation.md have some.
#include <cmath>
#include <cstdio>
#include <exception>
#include <tuple>
#include <vector>

#include "corrections/expression_regions.hpp"
#include "corrections/labels.hpp"
#include "model/types.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

/// Root mean square distance of a landmark [mm], mean of the frames.
double error(const LandmarkRegression& r, const Columns<float>& neutral,
             const std::vector<MeshSample<float>>& frames) {
    double sum = 0;
    for (const MeshSample<float>& f : frames) {
        const Columns<float> got = neutral + r.displacement<float>(landmark_regressors(f.drivers));
        sum += std::sqrt(static_cast<double>((got - f.landmarks).squaredNorm()) /
                         static_cast<double>(neutral.cols()));
    }
    return 100 * sum / static_cast<double>(frames.size());
}

void print_row(const char* name, const LandmarkRegression& r, const Columns<float>& neutral,
               const std::vector<MeshSample<float>>& train,
               const std::vector<MeshSample<float>>& test) {
    std::printf("| %s | %.2f | %.2f |\n", name, error(r, neutral, train), error(r, neutral, test));
}

std::vector<MeshSample<float>> samples_of(const Capture& capture, const Subject& subject,
                                          const TrainConfig& config,
                                          const std::vector<int>& frames) {
    std::vector<MeshSample<float>> all;
    for (const int f : frames) all.push_back(mesh_sample(capture, subject, config, f, {}));
    return all;
}

/// Returns the root mean square of the derivatives by pitch, the means of those upward and
/// downward, of both eyes together, over the landmarks within 22 mm of an eyeball's centre, by the
/// regression of training [mm / rad].
double lids_follow(const Capture& capture, const TrainConfig& config) {
    const Subject subject = describe_subject(capture, config);
    const Columns<float> neutral = subject.neutral.cast<float>();
    const auto frames = samples_of(capture, subject, config, capture.train);
    const InfluenceInput<float> input{config.avatar, neutral, neutral};
    RegressionConfig prior = expression_prior(capture, subject, config.mesh);
    prior.noise = landmark_noise<float, MeshEffects>(train_backend(), input, subject.roles, frames,
                                                     prior);
    const LandmarkRegression r = landmark_regression<float, MeshEffects>(
        train_backend(), input, subject.roles, frames, prior);
    const Index k = r.coefficient.rows();
    double sum = 0, near = 0;
    for (Index l = 0; l < neutral.cols(); ++l) {
        const Vec3<double> at = subject.neutral.col(l);
        if (std::min((at - subject.eye_centre[0]).norm(), (at - subject.eye_centre[1]).norm()) >=
            0.22)
            continue;
        ++near;
        for (const Index pitch : // of the left, of the right eye
             {k - 2 * rye::detail::gaze_regressors, k - rye::detail::gaze_regressors})
            sum += r.coefficient.row(pitch).segment<3>(3 * l).squaredNorm();
    }
    return 100 * std::sqrt(sum / near);
}

} // namespace

int main(int count, char** words) try {
    if (count != 2) {
        std::fprintf(stderr, "usage: landmarks_of_expressions CAPTURE\n");
        return 2;
    }
    const Capture capture = read_capture(words[1]);
    TrainConfig config = preset("cpu");
    config.avatar.expression = capture.expression_width();
    const Subject subject = describe_subject(capture, config);
    const Columns<float> neutral = subject.neutral.cast<float>();
    const auto train = samples_of(capture, subject, config, capture.train),
               test = samples_of(capture, subject, config, capture.test);
    std::printf(
        "| the regression knows | training frames [mm] | test frames [mm] |\n"
        "|---|---|---|\n");
    LandmarkRegression none;
    none.coefficient = Columns<double>::Zero(
        static_cast<Index>(landmark_regressors(train.front().drivers).size()), 3 * neutral.cols());
    none.coefficient.row(0) = [&] {
        Columns<double> mean = Columns<double>::Zero(3, neutral.cols());
        for (const auto& f : train)
            mean += (f.landmarks - neutral).cast<double>() / static_cast<double>(train.size());
        return Eigen::RowVectorXd(Eigen::Map<const Eigen::RowVectorXd>(mean.data(), mean.size()));
    }();
    print_row("nothing: the mean of the training frames", none, neutral, train, test);
    for (const auto& [name, regions, shapes] :
         {std::tuple("the training frames", false, false),
          std::tuple("... where named coefficients act (`fit_regions`)", true, false),
          std::tuple("... the shapes of the face model (`fit_shapes`)", true, true)}) {
        config.mesh.fit_regions = regions;
        config.mesh.fit_shapes = shapes;
        RegressionConfig prior = expression_prior(capture, subject, config.mesh);
        if (shapes && prior.expression_shapes.size() == 0) {
            std::printf("| %s | no expression_shapes.npz | |\n", name);
            continue;
        }
        const auto fitted = [&] {
            return landmark_regression<float, MeshEffects>(
                train_backend(), {config.avatar, neutral, neutral}, subject.roles, train, prior);
        };
        print_row(name, fitted(), neutral, train, test);
        prior.noise = landmark_noise<float, MeshEffects>(
            train_backend(), {config.avatar, neutral, neutral}, subject.roles, train, prior);
        char knows[80];
        std::snprintf(knows, sizeof knows, "... and of noise, %.2f mm", 100 * prior.noise);
        if (prior.noise > 0) print_row(knows, fitted(), neutral, train, test);
    }
    Capture corrected = read_capture(words[1]);
    correct_labels(corrected, config);
    std::printf("lids follow the pitch by %.1f mm a radian, where labels are corrected by %.1f\n",
                lids_follow(capture, config), lids_follow(corrected, config));
    return 0;
} catch (const std::exception& e) {
    std::fprintf(stderr, "landmarks_of_expressions: %s\n", e.what());
    return 1;
}
