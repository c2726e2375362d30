// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/config.hpp: the sizes and scales of an avatar. Every default is the paper's, or,
/// where the paper is silent, that of Gaussian Head Avatar (GHA), its parent; see
/// docs/deviations.md.
#pragma once

#include <variant>
#include <vector>

#include <rye/nn/mlp.hpp>
#include <rye/rig/influence.hpp>
#include <rye/rig/parts.hpp>

namespace rye {

/// Distance that the thresholds t1 ... t4 are compared with; GHA's code compares squared ones.
using ChosenMetric = std::variant<SquaredDistance, EuclideanDistance>;

/// Hidden widths of each network; inputs and outputs follow from AvatarConfig.
struct NetworkConfig {
    std::vector<int> geometry{256, 256, 256, 256, 256};
    std::vector<int> exp_color{256, 256};
    std::vector<int> pose_color{128};
    std::vector<int> exp_deform{256, 256, 256, 256, 256};
    std::vector<int> pose_deform{256, 256};
    std::vector<int> exp_attributes{256, 256, 256};
    std::vector<int> pose_attributes{128, 128};
    std::vector<int> gaze_deform{256, 256};
    std::vector<int> gaze_color{128};
    std::vector<int> eye_offset{128, 128};
};

/// Settings that fix an avatar's shapes: widths of codes and features, layers, ranges of influence.
/// Lengths in the head frame's units.
struct AvatarConfig {
    int expression = 0;   ///< width of the expression code; decided by the capture
    int feature = 128;    ///< width of the per-point feature vector
    int channels = 32;    ///< feature channels of a Gaussian; the first three are RGB
    int frequencies = 4;       ///< octaves of the positional encoding of points
    int pose_frequencies = 4;  ///< of the head pose
    int gaze_frequencies = 4;  ///< of the gaze; fewer bend less between a capture's gazes

    double exp_near = 0.15;    ///< t1, in units of the metric
    double exp_far = 0.25;     ///< t2
    double gaze_near = 0.075;  ///< t3
    double gaze_far = 0.125;   ///< t4
    ChosenMetric metric = SquaredDistance{};

    double deform_scale = 0.3;      ///< displacement = scale * tanh(network) [unit]
    double attribute_scale = 0.2;   ///< step of log-scale, quaternion and logit opacity
    double vertex_offset =
        1. / 128; ///< largest move of a lattice vertex is tanh(1) times this [unit]

    /// Weights of the frame inputs (expression, head pose, gaze) start at 0: what training has not
    /// seen vary then changes nothing. The published start is random.
    bool drivers_from_zero = false;

    NetworkConfig networks = {};

    /// Sizes of the codes that networks read: of points, head pose and gaze (pitch, yaw).
    template <NetworkPolicy N = PublishedNetworks>
    int position_code() const {
        return static_cast<int>(N::Encoding::size(3, frequencies));
    }
    template <NetworkPolicy N = PublishedNetworks>
    int pose_code() const {
        return static_cast<int>(N::Encoding::size(6, pose_frequencies));
    }
    template <NetworkPolicy N = PublishedNetworks>
    int gaze_code() const {
        return static_cast<int>(N::Encoding::size(2, gaze_frequencies));
    }
};

/// dims [point inputs + frame inputs, hidden..., outputs].
inline MlpShape mlp_shape(int point_inputs, int frame_inputs, const std::vector<int>& hidden,
                          int outputs) {
    MlpShape shape;
    shape.dims.push_back(point_inputs + frame_inputs);
    shape.dims.insert(shape.dims.end(), hidden.begin(), hidden.end());
    shape.dims.push_back(outputs);
    shape.frame_inputs = frame_inputs;
    return shape;
}

namespace detail {

/// The same with the skip of a policy.
template <NetworkPolicy N>
MlpShape network_shape(MlpShape shape) {
    shape.skip_layer = N::skip_layer(shape);
    return shape;
}

} // namespace detail

/// A first network for points that frame inputs drive.
template <class T, NetworkPolicy N = PublishedNetworks>
auto driven_mlp(const AvatarConfig& config, const MlpShape& of, const Random& random) {
    using Network = Mlp<T, typename N::Activation>;
    const MlpShape shape = detail::network_shape<N>(of);
    Network mlp = Network::init(shape, random);
    if (config.drivers_from_zero)
        for (int l = 0; l < shape.layers(); ++l)
            if (shape.reads_input(l))
                mlp.weight[static_cast<std::size_t>(l)].rightCols(shape.frame_inputs).setZero();
    return mlp;
}

} // namespace rye
