// SPDX-License-Identifier: Apache-2.0
#include "model/run_size.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>

#include <rye/core/error.hpp>
#include <rye/train/density.hpp>

namespace rye::trainer {
namespace {

/// Returns the number of the neutral surface's vertices per unit of area, if edges of the lattice
/// have length `lattice` and the surface's are halved until they are at most `edge`. A surface cuts
/// 6.75 edges of a body-centred lattice in an area of lattice^2, in any direction; the other terms
/// are fitted to refine() on spheres, within a tenth.
double vertex_density(double lattice, double edge) {
    const double u = edge / lattice;
    return std::max(6.75, 3.6 / (u * u) + 1.5 / u) / (lattice * lattice);
}

/// Area of the surface that stage 1 finds, relative to that of its initial sphere of radius 1.
/// Heads with their necks had 0.95 to 1.4, more with finer lattices and pictures.
constexpr double head_surface = 1.2;
constexpr double least_share = 0.75; // share of it that is certain: a run is refused only then

double sum_of(const std::vector<int>& widths) {
    double sum = 0;
    for (const int w : widths) sum += w;
    return sum;
}

/// Returns the number of weights between hidden layers, of all networks: their parameters are more.
double network_weights(const NetworkConfig& n) {
    double sum = 0;
    for (const std::vector<int>* hidden :
         {&n.geometry, &n.exp_color, &n.pose_color, &n.exp_deform, &n.pose_deform,
          &n.exp_attributes, &n.pose_attributes, &n.gaze_deform, &n.gaze_color, &n.eye_offset})
        for (std::size_t l = 1; l < hidden->size(); ++l)
            sum += static_cast<double>((*hidden)[l]) * (*hidden)[l - 1];
    return sum;
}

} // namespace

SurfaceGuess surface_guess(const TrainConfig& config, const Subject& subject) {
    const AvatarTrainConfig& g = config.gaussians;
    const double lattice = config.grid.cell * (config.grid.subdivide ? 0.5 : 1.0);
    constexpr Index samples = 4000;
    SurfaceGuess s;
    s.landmarks = subject.neutral.colwise() - subject.head_centre;
    s.landmarks.colwise().normalize();
    s.points.resize(3, samples);
    s.vertices.resize(samples);
    for (Index i = 0; i < samples; ++i) { // spiral of points of equal areas
        const double z = 1 - (2 * static_cast<double>(i) + 1) / samples, r = std::sqrt(1 - z * z);
        const double turn = std::numbers::pi * (3 - std::sqrt(5.0)) * static_cast<double>(i);
        const Vec3<double> x(r * std::cos(turn), r * std::sin(turn), z);
        double edge = lattice;
        if (g.spacing > 0) { // near eyes and lips
            const double nearest =
                (s.landmarks.middleCols(36, 30).colwise() - x).colwise().norm().minCoeff();
            edge = std::clamp(g.spacing + g.spacing_slope * nearest, lattice / 64, lattice);
        }
        s.points.col(i) = x;
        s.vertices(i) =
            head_surface * 4 * std::numbers::pi / samples * vertex_density(lattice, edge);
    }
    return s;
}

RunSize run_size(const TrainConfig& config, const Subject& subject, int width, int height) {
    const AvatarConfig& a = config.avatar;
    const AvatarTrainConfig& g = config.gaussians;
    RunSize s;
    const double n = std::max(1.0, std::round(2 * config.grid.half_side / config.grid.cell));
    const double finer = config.grid.subdivide ? 8 : 1;
    s.lattice = finer * (2 * n * n * n + 3 * n * n);
    // Per vertex: position and signed distance; six tetrahedra with their corners and edges.
    const double lattice_bytes = s.lattice * (4 * 4 + 6 * 10 * 8);
    const double surface = surface_guess(config, subject).vertices.sum();
    const double eyes = 2.0 * g.eyeball.points;
    const auto with_density = [&](double face) {
        const Index total = g.steps > 0 ? g.steps : std::numeric_limits<Index>::max();
        return most_of_face(g.density, face, 0, total) + eyes;
    };
    s.gaussians = surface + g.mouth_points + eyes;
    s.most = with_density(surface + g.mouth_points);
    // Per Gaussian: value, gradient and two moments; the hidden layers that its vjp reads.
    const double gaussian_bytes =
        with_density(least_share * surface + g.mouth_points) * 4 *
        (4.0 * (14 + std::min(a.feature, a.channels)) + sum_of(a.networks.pose_color));
    const double pixels = static_cast<double>(width) * height;
    const double small = pixels / (1 << (2 * g.upsampler.doublings));
    // Three renders and their cotangents; the upsampler's last two layers and theirs.
    const double picture_bytes = 4 * (6.0 * 3 * small + 2.0 * a.channels * small +
                                      pixels * (4.0 * g.upsampler.capacity + 6 * 3));
    const double network_bytes = 4 * 4 * network_weights(a.networks);
    s.bytes = std::max(lattice_bytes, gaussian_bytes + picture_bytes) + network_bytes;
    return s;
}

std::string text_of(const RunSize& size) {
    char text[128];
    std::snprintf(text, sizeof text, "about %.3g Gaussians, ", size.gaussians);
    std::string words = text;
    if (size.most > size.gaussians) {
        std::snprintf(text, sizeof text, "at most %.3g by gaussians.density, ", size.most);
        words += text;
    }
    std::snprintf(text, sizeof text, "at least %.2g GB of memory", size.bytes / 1e9);
    return words + text;
}

void require_room(const RunSize& size, double memory, const std::string& who) {
    char lattice[64], room[64];
    std::snprintf(lattice, sizeof lattice, "%.3g", size.lattice);
    std::snprintf(room, sizeof room, "%.2g", memory / 1e9);
    require(size.bytes <= memory, who,
            std::string("got settings of a run of ") + lattice + " lattice vertices and " +
                text_of(size) + ", expected at most the " + room +
                " GB that there are (grid.cell, gaussians.spacing, gaussians.spacing_slope, "
                "gaussians.mouth_points, gaussians.density.most, avatar.networks)");
}

} // namespace rye::trainer
