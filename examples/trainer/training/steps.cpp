// SPDX-License-Identifier: Apache-2.0
#include "training/steps.hpp"

#include <algorithm>
#include <cmath>

#include <rye/avatar/hold.hpp>
#include <rye/loss/ssim.hpp>
#include <rye/train/checkpoint.hpp>
#include <rye/train/fit_deformation.hpp>
#include <rye/train/fit_lids.hpp>
#include <rye/train/lid_line.hpp>

#include "corrections/expression_regions.hpp"
#include "corrections/lights.hpp"
#include "data/panel.hpp"
#include "model/trained_parts.hpp"
#include "training/mesh_steps.hpp"

namespace rye::trainer {
namespace {

TrainEyeball eyeball_of(const Subject& s, const TrainConfig& config, std::size_t eye) {
    const bool bulge = config.gaussians.eyeball.bulge && !config.refraction;
    TrainEyeball shape =
        eyeball_shape(s.sizes(eye), bulge ? IrisSurface::bulge : IrisSurface::plane);
    // Points on the iris lie half as far apart as on the sclera: if a coarse sclera met a fine
    // iris, its large Gaussians would reach over the iris of an eye that looks aside. About 2500
    // points.
    shape.iris_rings = 12;
    shape.sclera_rings = 20;
    shape.back_rings = 8;
    const double share = std::sqrt(static_cast<double>(config.gaussians.eyeball.points) / 2500);
    const auto rings = [&](int n) { return std::max(3, static_cast<int>(std::lround(n * share))); };
    shape.iris_rings = rings(shape.iris_rings);
    shape.sclera_rings = rings(shape.sclera_rings);
    shape.back_rings = rings(shape.back_rings);
    return shape;
}

/// Returns what stage 2 begins with beside the guidance mesh.
AvatarInit<float> avatar_init(const TrainState& state, const TetGrid<float>& grid) {
    const TrainConfig& config = state.config;
    AvatarInit<float> init;
    init.grid = config.grid.subdivide ? subdivide(grid) : grid;
    init.mouth_points = config.gaussians.mouth_points;
    init.spacing = static_cast<float>(config.gaussians.spacing);
    init.spacing_slope = static_cast<float>(config.gaussians.spacing_slope);
    init.lid_margin = static_cast<float>(config.gaussians.lid_margin);
    init.opacity = static_cast<float>(config.gaussians.opacity);
    init.thickness = static_cast<float>(config.gaussians.thickness);
    init.eye_opacity = static_cast<float>(config.gaussians.eyeball.opacity);
    init.eye_thickness = static_cast<float>(config.gaussians.eyeball.thickness);
    init.eye_centre.resize(3, 2);
    for (std::size_t e = 0; e < 2; ++e) {
        init.eyeball[e] = eyeball_of(state.subject, config, e);
        init.eye_centre.col(static_cast<Index>(e)) = state.subject.eye_centre[e].cast<float>();
    }
    init.upsampler = config.gaussians.upsampler;
    init.upsampler.in_channels = config.avatar.channels;
    init.frames = static_cast<Index>(state.train_frames.size());
    return init;
}

} // namespace

TetGrid<float> make_lattice(const TrainState& state) {
    const Vec3<double> h = Vec3<double>::Constant(state.config.grid.half_side);
    const Vec3<float> lo = (state.subject.head_centre - h).cast<float>();
    const Vec3<float> hi = (state.subject.head_centre + h).cast<float>();
    return bcc_grid<float>(lo, hi, static_cast<float>(state.config.grid.cell));
}

void pretrain_mesh(TrainState& state, MeshNetworks* networks) {
    if (networks != nullptr) return pretrain_mesh_on(*networks, state);
    pretrain_mesh_by(train_backend(), state);
}

FittedLandmarks fit_landmarks(TrainState& state, const Capture& capture, MeshNetworks* networks) {
    std::vector<MeshSample<float>> frames;
    for (const int frame : capture.train)
        frames.push_back(mesh_sample(capture, state.subject, state.config, frame, {}));
    DeformationFit fit;
    fit.steps = state.config.mesh.fit_steps;
    fit.rate = state.config.mesh.fit_rate;
    fit.mixed = state.config.mesh.fit_mixed;
    fit.lids = state.config.mesh.fit_lids;
    fit.random = seed_of(state).fork(9);
    fit.regression = expression_prior(capture, state.subject, state.config.mesh);
    const Columns<float>& neutral = state.mesh.landmarks;
    if (fit.mixed > 0)
        fit.regression.noise =
            landmark_noise<float, MeshEffects>(train_backend(),
                                               {state.config.avatar, neutral, neutral},
                                               state.subject.roles, frames, fit.regression);
    const LandmarkStage stage{state.config.avatar, state.subject.roles,
                              state.config.mesh.landmarks_follow_gaze};
    std::optional<double> rms;
    if (networks != nullptr)
        rms = networks->fit(train_backend().threads, state.mesh, stage, frames, fit);
    if (!rms) rms = fit_deformation(train_backend(), state.mesh, stage, frames, fit);
    return {*rms, fit.regression.noise};
}

AvatarSize begin_avatar(TrainState& state, const TetGrid<float>& grid, const FoundLights& lights,
                        const FoundKappa& kappa) {
    const TrainConfig& config = state.config;
    const AvatarInit<float> init = avatar_init(state, grid);
    const Random random = seed_of(state).fork(4);
    const FacePoints<float> points =
        face_points(train_backend(), state.mesh, config.avatar, init, random);
    state.avatar = restricted<TrainEffects>(
        initialize_avatar(train_backend(), state.mesh, config.avatar, init, random, points));
    const AvatarSize size{state.avatar.face.position.cols(), state.avatar.eyes.position.cols()};
    Columns<float> normals;
    if (config.shading != ShadingName::none) normals = points.normals();
    begin_parts(state.avatar, config, normals, seed_of(state).fork(11));
    if (config.gaze_mechanism == GazeMechanismName::rotation && config.gaussians.rates.delta_view > 0)
        state.avatar.delta_view = Columns<float>::Zero(6, state.view_directions.cols());
    if (config.gaze_mechanism != GazeMechanismName::rotation) {
        ComparedTraining& t = state.compared.emplace();
        t.avatar = compared_avatar(state.avatar, config, normals, seed_of(state).fork(10));
        t.adam = Adam<ComparedAvatar>(t.avatar);
        state.avatar = {};
    } else {
        set_lights(state.avatar, lights);
        if (config.refraction) begin_refraction(state.avatar, state.subject);
        if (config.lid_shadow) begin_lid_shadow(state.avatar, state.subject.roles);
        if (config.gaze_axis == GazeAxis::visual)
            for (std::size_t e = 0; e < 2; ++e)
                state.avatar.eyes.kappa.col(static_cast<Index>(e)) = kappa.angles[e].cast<float>();
        state.avatar_adam = Adam<Avatar>(state.avatar);
    }
    state.stage = Stage::avatar;
    state.step = 0;
    return size;
}

FittedLids close_lids(TrainState& state, const Capture& capture) {
    LidFit fit;
    // A short training has a short fit.
    fit.steps = static_cast<int>(
        std::min<Index>(state.config.gaussians.lid_steps, state.step));
    if (fit.steps == 0) return {};
    fit.random = seed_of(state).fork(12);
    std::vector<MeshSample<float>> frames;
    std::vector<VecX<float>> expressions;
    for (const int frame : capture.train) {
        frames.push_back(mesh_sample(capture, state.subject, state.config, frame, {}));
        expressions.push_back(frames.back().drivers.expression);
    }
    const Columns<float>& neutral = state.mesh.landmarks;
    const AvatarConfig& config = state.config.avatar;
    const LandmarkRoles& roles = state.subject.roles;
    const LandmarkRegression regression = landmark_regression<float, MeshEffects>(
        train_backend(), {config, neutral, neutral}, roles, frames,
        expression_prior(capture, state.subject, state.config.mesh));
    const auto fitted = [&](auto& avatar) {
        return fit_lids(
            train_backend(), avatar, config, roles,
            {expressions, regression.blinks, regression.whole_blink},
            [&](const Random& random) {
                return mixed_frame(frames, regression, neutral, random).drivers.expression;
            },
            fit);
    };
    return state.compared ? fitted(state.compared->avatar) : fitted(state.avatar);
}

FaceNeighbours first_neighbours(const TrainState& state) {
    const AvatarLossConfig& weights = state.config.gaussians.weights;
    if (!(weights.face_smooth > 0 || weights.face_mirror > 0)) return {};
    const FacePoints<float> first =
        face_points(train_backend(), state.mesh, state.config.avatar,
                    avatar_init(state, make_lattice(state)), seed_of(state).fork(4));
    return face_neighbours(train_backend(), first.positions(), weights);
}

struct MeshStepper::Memory : MeshMemory {
    MeshNetworks* networks;
};

MeshStepper::MeshStepper(const TrainState& state, MeshNetworks* networks)
    : memory_(std::make_unique<Memory>(Memory{{zeros_like(state.mesh), {}}, networks})) {}
MeshStepper::~MeshStepper() = default;

StepReport MeshStepper::step(TrainState& state, const TetGrid<float>& grid,
                             const MeshSample<float>& sample, double rate, const Probe& probe) {
    const MeshStepInput input{grid, sample, rate, probe};
    if (memory_->networks != nullptr)
        return mesh_step_on(*memory_->networks, *memory_, state, input);
    return mesh_step_by(train_backend(), *memory_, state, input);
}

} // namespace rye::trainer
