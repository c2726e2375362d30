// SPDX-License-Identifier: Apache-2.0
#include "device/memory.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <rye/avatar/weights.hpp>
#include <rye/nn/cuda/convolution_weights.hpp>
#include <rye/nn/cuda/mlp_weight_cut.hpp>
#include <rye/nn/features.hpp>
#include <rye/splat/cuda/rasterizer.hpp>
#include <rye/train/density.hpp>

#include "model/draws.hpp"
#include "model/run_size.hpp"
#include "model/types.hpp"

namespace rye::trainer {
namespace {

constexpr double number = sizeof(float), half = sizeof(std::uint16_t);
/// Places of rye::ViewRing; share of the free memory that is filled with pictures.
constexpr double places_of_fetched = 3, spared = 0.95;

double up(double x, double multiple) { return std::ceil(x / multiple) * multiple; }

/// Group of a network's vjp memory: networks of displacements are differentiated in parallel with
/// the face's others, networks of the eyes' features in parallel with both.
enum class VjpMemory { face, displacements, eyes };

/// Network over the points of a driver's list, or of an eye.
struct Network {
    MlpShape shape;
    double points;
    VjpMemory memory = VjpMemory::face;

    double parameters() const {
        double sum = 0;
        for (int l = 0; l < shape.layers(); ++l)
            sum += (static_cast<double>(shape.fan_in(l)) + 1) * shape.layer_out(l);
        return sum;
    }
    /// Returns the half words of the planes of a layer's outputs, or of the inputs.
    double halves(int width, int planes) const { return planes * points * up(width, 16); }
};

std::vector<Network> networks_of(const TrainConfig& config, const DeviceSizes& sizes) {
    const AvatarConfig& c = config.avatar;
    constexpr VjpMemory beside = VjpMemory::displacements;
    const NetworkConfig& n = c.networks;
    const int xyz = c.position_code(), pose = c.pose_code(), gaze = c.gaze_code();
    const auto [of_exp, of_pose, left, right] = sizes.listed;
    std::vector<Network> all{{mlp_shape(c.feature, c.expression, n.exp_color, c.channels), of_exp},
                             {mlp_shape(xyz, c.expression, n.exp_deform, 3), of_exp, beside},
                             {mlp_shape(c.feature, c.expression, n.exp_attributes, 8), of_exp},
                             {mlp_shape(c.feature, pose, n.pose_color, c.channels), of_pose},
                             {mlp_shape(xyz, pose, n.pose_deform, 3), of_pose, beside},
                             {mlp_shape(c.feature, pose, n.pose_attributes, 8), of_pose}};
    for (const double points : {left, right}) {
        all.push_back({mlp_shape(c.feature, gaze, n.gaze_color, c.channels), points});
        all.push_back({mlp_shape(xyz, gaze, n.gaze_deform, 3), points, beside});
    }
    all.push_back({mlp_shape(c.expression + pose, 0, n.eye_offset, 6), 0}); // one column
    if (config.eye_appearance == EyeAppearanceName::driven)
        all.insert(
            all.end(), 2,
            {DrivenFeatures::shape(appearance_sizes<TrainEffects>(c, Index(sizes.eyes))),
             sizes.eyes / 2, VjpMemory::eyes});
    return all;
}

/// Layers of the upsampler for one picture.
struct UpsamplerLayers {
    UpsamplerShape shape;
    double small; ///< pixels of the render

    double pixels(int l) const { return std::ldexp(small, l / 2 * 2); }
    double parameters() const {
        double sum = 3.0 * (shape.capacity + 1);
        for (int l = 0; l < shape.layers(); ++l)
            sum += 9.0 * shape.layer_in(l) * shape.block_out(l / 2);
        return sum;
    }
    /// Returns the memory that the vjp of one pass reads: results of layers, and their inputs as
    /// planes.
    double trace(int planes) const {
        double sum = 0;
        for (int l = 0; l < shape.layers(); ++l)
            sum += number * (pixels(l) + 2) * shape.block_out(l / 2) +
                   planes * half * pixels(l) * up(shape.layer_in(l), 32);
        if (shape.skip)
            for (int d = 0; d <= shape.doublings; ++d) sum += number * 3 * pixels(2 * d);
        return sum;
    }
    /// Returns the memory shared by the passes: planes of a cotangent, two cotangents, those of the
    /// skip, weights as planes for both directions, partial gradients of weights.
    double shared(int planes, int width, int height) const {
        double most = 0, padded = 0, packed = 0, partial = 0;
        for (int l = 0; l < shape.layers(); ++l) {
            const int in = shape.layer_in(l), out = shape.block_out(l / 2),
                      wide = std::max(in, out);
            most = std::max(most, wide * pixels(l));
            padded = std::max(padded, up(wide, 32) * pixels(l));
            packed += 2 * 9 * up(in, 32) * up(out, 32);
            const ConvolutionSlices slices{
                width << l / 2, height << l / 2, in, out, planes};
            partial = std::max(partial, static_cast<double>(slices.numbers()));
        }
        const double skip = shape.skip ? 2 * 3 * pixels(2 * shape.doublings) : 0;
        return planes * half * (padded + packed) + number * (2 * most + skip + partial);
    }
};

/// Returns the memory of the frames of a step's three renders, at their initial capacity.
double frames_of(const TrainConfig& config, const DeviceSizes& s, int width, int height) {
    const auto frame = [&](double gaussians, int channels) {
        const int kernels = channels <= 3 ? 3 : channels <= 16 ? 16 : 32;
        DeviceFrameShape f{};
        f.gaussians = static_cast<std::size_t>(gaussians);
        f.tiles = static_cast<std::size_t>(tiles_across(width)) *
                  static_cast<std::size_t>(tiles_across(height));
        f.entries = 8 * f.gaussians + 8 * f.tiles + 1024;
        f.groups = f.entries / 16 + 8 * f.tiles;
        f.stride = static_cast<std::size_t>(up(kernels + 8, 4));
        return static_cast<double>(f.bytes());
    };
    return frame(s.face + s.eyes, config.avatar.channels) + frame(s.face, 3) +
           frame(s.eyes, config.avatar.channels);
}

/// Returns the memory of LPIPS on whole pictures: features of both, planes, cotangents, weights.
double lpips_bytes(double pixels, int planes) {
    const VggShape shape;
    double features = 0, slices = 0, most = 0, weights = 0;
    int in = shape.in_channels;
    for (std::size_t s = 0; s < vgg_slices; ++s) {
        const double here = pixels / std::ldexp(1.0, 2 * static_cast<int>(s));
        for (int k = 0; k < shape.convolutions[s]; ++k) {
            const int out = shape.channels[s];
            features += here * out;
            most = std::max(most, here * std::max(in, out));
            weights += 9.0 * in * out;
            in = out;
        }
        slices += here * shape.channels[s];
    }
    return number * (features + slices + 2 * most + 3 * pixels) +
           planes * half * (most + 2 * weights);
}

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

/// Returns the capacity of a list when it is first found too short.
double list_room(double points, double face) {
    return std::min(face, points + std::floor(points / 4) + 64);
}

} // namespace

DeviceSizes device_sizes(const TrainState& state, const Capture& capture) {
    DeviceSizes s;
    const int factor = 1 << state.config.gaussians.upsampler.doublings;
    s.width = (capture.width + factor - 1) / factor * factor;
    s.height = (capture.height + factor - 1) / factor * factor;
    s.frames = static_cast<double>(capture.train.size());
    for (const int frame : capture.train)
        s.views += static_cast<double>(present_cameras(capture, frame).size());
    const auto counted = [&](const auto& avatar) {
        s.face = static_cast<double>(avatar.face.position.cols());
        s.eyes = static_cast<double>(avatar.eyes.position.cols());
        s.listed = moved_by(state, {avatar.face.position, avatar.face.landmarks,
                                    VecX<double>::Ones(avatar.face.position.cols())});
    };
    if (state.stage == Stage::avatar) {
        if (state.compared) counted(state.compared->avatar);
        else counted(state.avatar);
    } else {
        s.eyes = 2.0 * state.config.gaussians.eyeball.points;
        const SurfaceGuess guess = surface_guess(state.config, state.subject);
        const Columns<float> points = guess.points.cast<float>(),
                             landmarks = guess.landmarks.cast<float>();
        s.listed = moved_by(state, {points, landmarks, guess.vertices});
        const double mouth = state.config.gaussians.mouth_points; // as if all were at the lips
        s.face = guess.vertices.sum() + mouth;
        s.listed[0] += mouth;
    }
    // All Gaussians that split may lie in one list.
    const AvatarTrainConfig& g = state.config.gaussians;
    const double most = most_of_face(
        g.density, s.face, state.stage == Stage::avatar ? state.step : 0, total_steps(g, capture));
    for (double& points : s.listed) points = list_room(points + most - s.face, most);
    s.face = most;
    return s;
}

double picture_bytes(const TrainConfig& config, const DeviceSizes& s) {
    return 6.0 * s.width * s.height + number * config.avatar.expression;
}

double views_on_host(const TrainConfig& config, const DeviceSizes& sizes,
                     const DeviceFacts& device) {
    const double need = device_need(config, sizes).sum(), one = picture_bytes(config, sizes);
    if (need <= device.free) return 0;
    const double others = need - one * sizes.views + one * places_of_fetched;
    if (others > device.free) return 0;
    return sizes.views - std::max(0.0, std::floor((spared * device.free - others) / one));
}

int gradients_of(const TrainConfig& config, const Ranks* ranks) {
    if (config.gaussians.views == 1 && ranks == nullptr) return 0;
    const StepShare share = share_of(config, ranks);
    return TreeLevels::levels(share.count) + (ranks != nullptr ? 1 : 0);
}

DeviceNeed device_need(const TrainConfig& config, const DeviceSizes& s) {
    const AvatarConfig& a = config.avatar;
    const AvatarTrainConfig& g = config.gaussians;
    const int factor = 1 << g.upsampler.doublings, planes = g.planes;
    const double full = static_cast<double>(s.width) * s.height;
    const double small = full / (factor * factor), points = s.face + s.eyes;
    UpsamplerLayers upsampler{g.upsampler, small};
    upsampler.shape.in_channels = a.channels;
    const std::vector<Network> networks = networks_of(config, s);

    double parameters = s.face * (11 + a.feature) + s.eyes * (8 + a.channels) + 6 * s.frames +
                        upsampler.parameters();
    if (g.rates.delta_gaze > 0) parameters += 4 * s.frames;
    if (config.shading != ShadingName::none) parameters += 3 * s.face; // normals
    // Per point: code, feature, influences and their cotangents, the last ones twice; nearest
    // landmarks, lists, steps of attributes. The driven cloud and its cotangent, parts of the other
    // renders.
    double kept = number * s.face * (2 * (a.position_code() + a.feature + 4) + 4 + 3 + 4 + 16) +
                  number * (points * (2 * (11 + a.channels) + 14 + 3) + s.eyes * (17 + a.channels));
    if (config.eye_appearance == EyeAppearanceName::driven) // directions, and their codes
        kept += number * s.eyes * (3 + 2 * DrivenFeatures::point_inputs());
    double cotangents[3] = {0, 0, 0}, outputs[3] = {0, 0, 0};
    for (const Network& n : networks) {
        parameters += n.parameters();
        kept += 2 * planes * half * n.parameters(); // weights as planes, for both directions
        if (n.points == 0) continue;
        const MlpShape& shape = n.shape;
        double all = 0;
        kept += half * n.halves(shape.point_inputs(), planes) + number * shape.outputs() * n.points;
        for (int l = 0; l < shape.layers(); ++l) {
            const double out = half * n.halves(shape.layer_out(l), planes);
            all += out;
            if (l + 1 < shape.layers()) kept += out;
        }
        const auto k = static_cast<std::size_t>(n.memory);
        cotangents[k] = std::max(cotangents[k], all);
        if (n.memory != VjpMemory::eyes) // whose outputs are the features themselves
            outputs[k] = std::max(outputs[k], number * shape.outputs() * n.points);
    }
    // Two networks at a time hold sums of their weights' gradients, and one more for eyes'
    // features; narrow tiles as many numbers.
    constexpr double of_sums = number * MlpWeightCut<256>::aim * MlpWeightCut<256>::of_block;
    for (int k = 0; k < 3; ++k) kept += cotangents[k] + outputs[k];
    kept += 2 * of_sums;
    using Mechanism = GazeMechanismName;
    const Mechanism m = config.gaze_mechanism;
    if (m == Mechanism::feature_rotation || m == Mechanism::condition ||
        m == Mechanism::latent_rotation || config.eye_appearance == EyeAppearanceName::driven)
        kept += of_sums;

    const double pictures = s.views - s.on_host + (s.on_host > 0 ? places_of_fetched : 0);
    const double maps = (6.0 * a.channels + 9 + 6) * small + (12 + 5) * full;
    const double pyramid = 2 * 3 * full * (1.0 / 4 + 1.0 / 16);
    const bool dense = g.density.every > 0;
    // A graph of neighbours: four of each point, where they are named, and its sums.
    const int graphs = (g.weights.face_smooth > 0 ? 1 : 0) + (g.weights.face_mirror > 0 ? 1 : 0);
    const double compared = (g.weights.dssim > 0 ? 9 * full : 0) + (g.augment ? 4 * full : 0) +
                            graphs * s.face * (9 + a.feature / 64.0);
    return {
        {{{"parameters, gradient and moments", (4 + s.gradients) * number * parameters,
           dense ? "avatar.networks, gaussians.density.most or gaussians.spacing"
                 : "avatar.networks, gaussians.spacing or gaussians.mouth_points"},
          {"pictures", picture_bytes(config, s) * pictures,
           "the capture's number or size of pictures, as no field does it"},
          {"networks", kept,
           dense ? "avatar.networks, gaussians.planes or gaussians.density.most"
                 : "avatar.networks, gaussians.planes or gaussians.mouth_points"},
          {"renders", frames_of(config, s, s.width / factor, s.height / factor) + number * maps,
           dense ? "gaussians.density.most or avatar.channels"
                 : "gaussians.mouth_points or avatar.channels"},
          {"upsampler",
           2 * upsampler.trace(planes) +
               upsampler.shared(planes, s.width / factor, s.height / factor),
           "gaussians.upsampler.capacity"},
          {"losses",
           s.lpips ? lpips_bytes(full, planes) + number * compared : number * (pyramid + compared),
           s.lpips ? "the perceptual loss, by leaving out --perceptual-weights"
                   : "gaussians.weights.dssim to 0"}}}};
}

double DeviceNeed::sum() const {
    double all = 0;
    for (const Part& p : parts) all += p.bytes;
    return all;
}
const DeviceNeed::Part& DeviceNeed::largest() const {
    return *std::max_element(parts.begin(), parts.end(),
                             [](const Part& a, const Part& b) { return a.bytes < b.bytes; });
}

std::string text_of(const DeviceNeed& need) {
    const auto gigabytes = [](double bytes) {
        char digits[64];
        std::snprintf(digits, sizeof digits, "%.3f", bytes / 1e9);
        return std::string(digits);
    };
    std::string text = "about " + gigabytes(need.sum()) + " GB of device memory:";
    for (const auto& p : need.parts)
        text +=
            std::string(&p == need.parts.data() ? " " : ", ") + p.name + " " + gigabytes(p.bytes);
    return text;
}

std::string text_of_pictures(const DeviceSizes& sizes) {
    if (sizes.on_host <= 0) return "";
    return "; " + std::to_string(static_cast<Index>(sizes.on_host)) + " of " +
           std::to_string(static_cast<Index>(sizes.views)) + " pictures stay in the host's memory";
}

void require_device_room(const DeviceNeed& need, const DeviceFacts& device, const std::string& who,
                         const std::string& rest) {
    char free[64], total[64];
    std::snprintf(free, sizeof free, "%.3f", device.free / 1e9);
    std::snprintf(total, sizeof total, "%.3f", device.total / 1e9);
    require(need.sum() <= device.free, who,
            "got settings that need " + text_of(need) + ", expected at most the " + free +
                " GB that are free of the " + total + " GB of " + device.name +
                "; what needs most is made less by lowering " + need.largest().lower +
                ", or train with --device cpu" + rest);
}

} // namespace rye::trainer
