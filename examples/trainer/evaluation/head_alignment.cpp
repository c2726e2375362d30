// SPDX-License-Identifier: Apache-2.0
#include "evaluation/head_alignment.hpp"

#include <cmath>

#include <rye/math/rotation.hpp>
#include <rye/train/landmark_losses.hpp>

#include "corrections/centre_errors.hpp"
#include "data/degrees.hpp"
#include "data/fit_rigid.hpp"
#include "model/types.hpp"

namespace rye::trainer {
namespace {

double rms_mm(const Columns<double>& difference) {
    return mm_per_unit * std::sqrt(difference.colwise().squaredNorm().mean());
}

} // namespace

double HeadAlignment::turn_degrees() const {
    return degrees * so3_log(capture_from_run.rotation).norm();
}
double HeadAlignment::shift_mm() const { return mm_per_unit * capture_from_run.translation.norm(); }

nlohmann::ordered_json HeadAlignment::json() const {
    return {{"degrees", turn_degrees()},
            {"mm", shift_mm()},
            {"landmarks_mm_before", before_mm},
            {"landmarks_mm", after_mm}};
}

HeadAlignment head_alignment(const TrainState& state, const Capture& capture,
                             const std::vector<int>& frames) {
    const TrainConfig& c = state.config;
    const Mesh& mesh = state.mesh;
    const TrainBackend backend = train_backend();
    const LandmarkStage stage{c.avatar, state.subject.roles, c.mesh.landmarks_follow_gaze};
    LandmarkTrace<float, MeshEffects> trace;
    place_landmarks<float, MeshEffects>(backend, mesh, stage, trace.geometry, trace);

    const Index each = mesh.landmarks.cols(), all = each * static_cast<Index>(frames.size());
    Columns<double> run(3, all), measured(3, all);
    for (std::size_t i = 0; i < frames.size(); ++i) {
        const int f = frames[i];
        const CaptureFrame& frame = capture.frames[static_cast<std::size_t>(f)];
        const auto code = frame_code(
            c.avatar, OpticalDrivers<float, MeshEffects>(frame_drivers(capture, f, c.gaze_axis)));
        deform_landmarks<float, MeshEffects>(backend, {mesh.networks, stage, trace, code}, trace);
        const Index at = each * static_cast<Index>(i);
        run.middleCols(at, each) = trace.deformed.cast<double>();
        measured.middleCols(at, each) = to_canonical(frame, frame_landmarks(capture, f));
    }
    HeadAlignment a;
    a.capture_from_run = fit_rigid(run, measured);
    a.before_mm = rms_mm(measured - run);
    a.after_mm = rms_mm(measured - ((a.capture_from_run.rotation * run).colwise() +
                                    a.capture_from_run.translation));
    return a;
}

void take_head_frame(Capture& capture, const Rigid<double>& capture_from_run) {
    for (CaptureFrame& f : capture.frames) {
        const Mat3<double> turn = so3_exp(Vec3<double>(f.pose.head<3>()));
        f.pose.tail<3>() += f.scale * turn * capture_from_run.translation;
        f.pose.head<3>() = so3_log(Mat3<double>(turn * capture_from_run.rotation));
        for (CaptureEye& eye : f.eyes) {
            eye.optical = capture_from_run.turn_back(eye.optical);
            if (eye.visual) eye.visual = capture_from_run.turn_back(*eye.visual);
        }
    }
}

} // namespace rye::trainer
