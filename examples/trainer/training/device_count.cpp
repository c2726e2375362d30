// SPDX-License-Identifier: Apache-2.0
#include "training/device_count.hpp"

#include <cmath>
#include <limits>

#include <rye/avatar/weights.hpp>
#include <rye/train/density.hpp>

#include "model/draws.hpp"
#include "model/run_size.hpp"
#include "model/trained_parts.hpp"

namespace rye::trainer {
namespace {

/// Sample points of a face, each standing for `count` of the face's points.
struct ListedPoints {
    const Columns<float>& points;
    const Columns<float>& landmarks;
    VecX<double> count;
};

/// Returns the number of the face's points that expression, pose and both gazes move.
std::array<double, 4> moved_by(const TrainState& state, const ListedPoints& face) {
    WeightsTrace<float, TrainEffects> nearest;
    const Weights<float, TrainEffects> w =
        face_weights<float>(train_backend(), {state.config.avatar, face.points, face.landmarks},
                            state.subject.roles, nearest);
    const auto among = [&](const Columns<float>& lambda) {
        return (lambda.row(0).transpose().array() > 0).select(face.count.array(), 0.0).sum();
    };
    return {among(ExpressionField{}.influence(w)), among(PoseField{}.influence(w)),
            among(GazeField<0>{}.influence(w)), among(GazeField<1>{}.influence(w))};
}

/// Gives a state in stage 1 what begin_avatar gives it, of zeros.
void begin_zeros(TrainState& s, const DeviceSizes& sizes) {
    const Index n = sizes.face, p = sizes.eyes;
    const AvatarConfig& c = s.config.avatar;
    s.mesh = Mesh::init(c, s.subject.neutral.cast<float>(), Random{0, 0});
    Avatar a = avatar_shape(s);
    for (auto* const cloud : {&a.face.position, &a.face.log_scale}) cloud->setZero(3, n);
    a.face.feature.setZero(c.feature, n);
    a.face.rotation.setZero(4, n);
    a.face.opacity_logit.setZero(1, n);
    for (auto* const cloud : {&a.eyes.position, &a.eyes.log_scale}) cloud->setZero(3, p);
    a.eyes.feature.setZero(c.channels, p);
    a.eyes.rotation.setZero(4, p);
    for (auto* const cloud : {&a.eyes.opacity_logit, &a.eyes.spacing}) cloud->setZero(1, p);
    a.face.landmarks = s.mesh.landmarks;
    a.eyes.centre.setZero(3, 2);
    a.eyes.left_points = p / 2;
    Columns<float> normals;
    if (s.config.shading != ShadingName::none) normals.setZero(3, n);
    begin_parts(a, s.config, normals, Random{0, 0});
    if (s.config.gaze_mechanism != GazeMechanismName::rotation) {
        s.compared.emplace().avatar = compared_avatar(a, s.config, normals, Random{0, 0});
        return;
    }
    if (s.config.gaussians.rates.delta_view > 0)
        a.delta_view.setZero(6, s.view_directions.cols());
    s.avatar = std::move(a);
}

/// Returns the memory of a training of this avatar after a run of steps.
template <EffectSet E>
DeviceStepsMemory counted(const TwoStream<float, E>& avatar, const TrainConfig& config,
                          const DeviceSizes& sizes, const DeviceTask& task) {
    const auto engine = device_engine<E>(avatar, Adam<TwoStream<float, E>>(avatar), task);
    TrainingView view;
    view.width = sizes.width, view.height = sizes.height;
    view.camera.width = sizes.width >> config.gaussians.upsampler.doublings;
    view.camera.height = sizes.height >> config.gaussians.upsampler.doublings;
    const auto pixels = static_cast<std::size_t>(view.width) * static_cast<std::size_t>(view.height);
    view.rgb.resize(3 * pixels);
    for (auto* const mask : {&view.mask, &view.visible, &view.eyes}) mask->resize(pixels);
    const auto drivers = neutral_drivers<float>(config.avatar);
    for (Index v = 0; v < sizes.views; ++v) engine->add(view, drivers);
    StepDraw draw; // of the kind that needs most
    draw.scaled = config.gaussians.augment;
    const Index steps = chunk_end(0, std::numeric_limits<Index>::max(), config.gaussians);
    engine->run(std::vector<StepDraw>(static_cast<std::size_t>(steps * task.share.count), draw));
    return engine->memory();
}

} // namespace

DeviceSizes device_sizes(const TrainState& state, const Capture& capture) {
    DeviceSizes s;
    const int factor = 1 << state.config.gaussians.upsampler.doublings;
    s.width = (capture.width + factor - 1) / factor * factor;
    s.height = (capture.height + factor - 1) / factor * factor;
    for (const int frame : capture.train)
        s.views += static_cast<Index>(present_cameras(capture, frame).size());
    double face = 0;
    std::array<double, 4> listed;
    const auto counted = [&](const auto& avatar) {
        face = static_cast<double>(avatar.face.position.cols());
        s.eyes = avatar.eyes.position.cols();
        listed = moved_by(state, {avatar.face.position, avatar.face.landmarks,
                                  VecX<double>::Ones(avatar.face.position.cols())});
    };
    if (state.stage == Stage::avatar) {
        if (state.compared) counted(state.compared->avatar);
        else counted(state.avatar);
    } else {
        s.eyes = Index(2) * state.config.gaussians.eyeball.points;
        const SurfaceGuess guess = surface_guess(state.config, state.subject);
        const Columns<float> points = guess.points.cast<float>(),
                             landmarks = guess.landmarks.cast<float>();
        listed = moved_by(state, {points, landmarks, guess.vertices});
        const double mouth = state.config.gaussians.mouth_points; // as if all were at the lips
        face = guess.vertices.sum() + mouth;
        listed[0] += mouth;
    }
    // All Gaussians that split may lie in one list.
    const AvatarTrainConfig& g = state.config.gaussians;
    const double most = most_of_face(
        g.density, face, state.stage == Stage::avatar ? state.step : 0, total_steps(g, capture));
    for (const double points : listed)
        s.listed.push_back(static_cast<std::uint32_t>(std::ceil(points + most - face)));
    s.face = static_cast<Index>(std::ceil(most));
    return s;
}

TrainState sized_state(const TrainState& state, const DeviceSizes& sizes) {
    TrainState s = drawn_state(state);
    s.view_directions = state.view_directions;
    if (s.stage == Stage::mesh) begin_zeros(s, sizes);
    s.stage = Stage::avatar;
    const auto resize = [&]<EffectSet E>(TwoStream<float, E>& avatar) {
        if (avatar.face.position.cols() == sizes.face) return;
        detail::for_face_columns<E>(
            [&](const char*, auto& a) {
                if (a.size() > 0) a.setZero(a.rows(), sizes.face);
            },
            avatar);
    };
    s.compared ? resize(s.compared->avatar) : resize(s.avatar);
    return s;
}

DeviceNeed device_need(const TrainState& state, const Capture& capture, bool lpips,
                       const DeviceFacts& device, DeviceStepSettings& settings) {
    const DeviceSizes sizes = device_sizes(state, capture);
    const TrainState sized = sized_state(state, sizes);
    const AvatarLossConfig& weights = state.config.gaussians.weights;
    FaceNeighbours neighbours; // all the same one
    const auto face = static_cast<std::size_t>(sizes.face);
    if (weights.face_smooth > 0) neighbours.near.resize(face);
    if (weights.face_mirror > 0) neighbours.mirror.resize(face);
    const auto need = [&] {
        DeviceTask task = device_task(sized, neighbours, settings);
        task.idle = true;
        task.listed = sizes.listed;
        if (lpips) task.lpips.emplace();
        const DeviceStepsMemory memory =
            sized.compared ? counted(sized.compared->avatar, state.config, sizes, task)
                           : counted(sized.avatar, state.config, sizes, task);
        DeviceNeed n = need_of(memory, state.config, lpips);
        n.views = sizes.views;
        n.on_host = settings.on_device ? sizes.views - *settings.on_device : 0;
        return n;
    };
    settings.on_device = {};
    DeviceNeed all = need();
    const Index on_host = views_on_host(all, device);
    if (on_host == 0) return all;
    settings.on_device = sizes.views - on_host;
    return need();
}

} // namespace rye::trainer
