// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/makehuman_pack.hpp"

#include <algorithm>

#include <nlohmann/json.hpp>

#include <rye/core/error.hpp>

#include "synthetic_capture/makehuman_cut.hpp"
#include "synthetic_capture/makehuman_shapes.hpp"
#include "synthetic_capture/makehuman_tables.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using namespace makehuman;
using V3 = Vec3<double>;

/// Units of the pack in a decimetre.
constexpr double per_dm = 10;
/// The middle between the eyeballs [dm], as in ICT-FaceKit's mean head.
const V3 eyes_at(0, 0.36, 0.81);
/// Displacements that are left out of the expressions, in units of the pack.
constexpr double least_move = 2e-4;

/// An eyeball of a mesh: a ball with a bulge at its front.
struct Ball {
    V3 centre;
    double radius = 0;
};
Ball ball_of(const Points& vertices, const std::vector<Index>& which) {
    const Points p = vertices(Eigen::all, which);
    const V3 low = p.rowwise().minCoeff(), high = p.rowwise().maxCoeff();
    Ball ball;
    ball.radius = 0.25 * (high.x() - low.x() + high.y() - low.y());
    ball.centre = 0.5 * (low + high);
    ball.centre.z() = low.z() + ball.radius;
    return ball;
}

template <class T>
NpyArray list(std::vector<Index> shape, const std::vector<T>& values) {
    return npy_array<T>(std::move(shape), std::span<const T>(values));
}

void append_columns(std::vector<float>& to, const Points& points) {
    for (Index i = 0; i < points.cols(); ++i)
        for (int d = 0; d < 3; ++d) to.push_back(static_cast<float>(points(d, i)));
}

/// The expressions' shapes, each as the vertices that it moves.
void add_expressions(NpzArrays& arrays, const Named& shapes, const Cut& cut) {
    std::vector<std::int32_t> index, offset{0};
    std::vector<float> delta;
    for (const auto& [name, moved] : shapes) {
        const Points d = per_dm * cut(moved);
        for (Index i = 0; i < d.cols(); ++i) {
            if (d.col(i).norm() <= least_move) continue;
            index.push_back(static_cast<std::int32_t>(i));
            append_columns(delta, d.col(i));
        }
        offset.push_back(static_cast<std::int32_t>(index.size()));
    }
    const auto rows = static_cast<Index>(index.size());
    arrays["expr_index"] = list({rows}, index);
    arrays["expr_delta"] = list({rows, 3}, delta);
    arrays["expr_offset"] = list({static_cast<Index>(offset.size())}, offset);
}

/// Faces, their parts and their texture: the face has u in 0 to 1, neck and shoulders in 1 to 2.
void add_faces(NpzArrays& arrays, const Cut& cut) {
    std::vector<std::int32_t> corners, corners_uv;
    std::vector<std::uint8_t> parts;
    Columns<double> uv = cut.mesh.uv;
    for (const int part : {face, head_neck}) {
        std::vector<Index> used;
        for (std::size_t f = 0; f < cut.parts.size(); ++f)
            if (cut.parts[f] == part)
                used.insert(used.end(), cut.mesh.faces[f].uv.begin(), cut.mesh.faces[f].uv.end());
        std::sort(used.begin(), used.end());
        used.erase(std::unique(used.begin(), used.end()), used.end());
        const Columns<double> own = uv(Eigen::all, used);
        const Vec2<double> low = own.rowwise().minCoeff(), high = own.rowwise().maxCoeff();
        for (const Index u : used)
            for (int d = 0; d < 2; ++d)
                uv(d, u) = (d == 0 ? part : 0) + 0.01 +
                           0.98 * (uv(d, u) - low[d]) / std::max(high[d] - low[d], 1e-9);
    }
    for (std::size_t f = 0; f < cut.parts.size(); ++f)
        for (const auto& triangle : {std::array<std::size_t, 3>{0, 1, 2}, {0, 2, 3}}) {
            parts.push_back(static_cast<std::uint8_t>(cut.parts[f]));
            for (const std::size_t k : triangle) {
                const Quad& q = cut.mesh.faces[f];
                corners.push_back(
                    static_cast<std::int32_t>(cut.place[static_cast<std::size_t>(q.vertex[k])]));
                corners_uv.push_back(static_cast<std::int32_t>(q.uv[k]));
            }
        }
    const auto n = static_cast<Index>(parts.size());
    arrays["faces"] = list({n, 3}, corners);
    arrays["faces_uv"] = list({n, 3}, corners_uv);
    arrays["face_part"] = list({n}, parts);
    arrays["uv"] = npy_array(Columns<float>(uv.cast<float>()));
}

std::string names_json(const Named& shapes, const Named& modes, const Cut& cut) {
    nlohmann::ordered_json json;
    for (const auto& [name, moved] : shapes) json["expressions"].push_back(name);
    for (std::size_t p = 0; p < part_names.size(); ++p)
        json["parts"].push_back({{"id", p},
                                 {"name", part_names[p]},
                                 {"vertex_begin", cut.range[p][0]},
                                 {"vertex_end", cut.range[p][1]}});
    for (const auto& [name, moved] : modes) json["identity"].push_back(name);
    json["origin"] =
        "MakeHuman base mesh hm08 and targets, (c) 2020 Data Collection AB, Joel "
        "Palmius and Jonas Hauquier, CC0";
    json["source"] = "https://www.makehumancommunity.org";
    return json.dump(1) + "\n";
}

/// Subtracts a displacement of the middle between the eyes, so that all subjects share a frame.
void hold_eyes(Points& moved, const std::vector<Index>& eyes) {
    const V3 shift = moved(Eigen::all, eyes).rowwise().mean();
    moved.colwise() -= shift;
}

} // namespace

HeadPack pack_makehuman(const fs::path& folder) {
    const Source source(folder);
    const Cut cut = cut_head(source.mesh);
    const std::array<std::vector<Index>, 2> eyes{group_vertices(source.mesh, "helper-l-eye"),
                                                 group_vertices(source.mesh, "helper-r-eye")};
    std::vector<Index> both = eyes[0];
    both.insert(both.end(), eyes[1].begin(), eyes[1].end());

    const Points kind = mean_kind(source, "young");
    Points mean = source.mesh.vertices + kind;
    const V3 between = 0.5 * (ball_of(mean, eyes[0]).centre + ball_of(mean, eyes[1]).centre);
    mean.colwise() += eyes_at - between;
    Named modes = identity_modes(source, kind);
    std::vector<float> neutral, identity;
    append_columns(neutral, per_dm * cut(mean));
    for (auto& [name, moved] : modes) {
        hold_eyes(moved, both);
        append_columns(identity, per_dm * cut(moved));
    }
    const Named shapes = expression_shapes(source);

    HeadPack pack;
    const auto n = static_cast<Index>(cut.order.size());
    pack.arrays["neutral"] = list({n, 3}, neutral);
    pack.arrays["id_delta"] = list({static_cast<Index>(modes.size()), n, 3}, identity);
    add_expressions(pack.arrays, shapes, cut);
    add_faces(pack.arrays, cut);
    std::vector<std::int32_t> marks, ranges;
    for (const Index v : makehuman::landmarks) {
        const auto at = std::find(cut.kept.begin(), cut.kept.end(), v) - cut.kept.begin();
        require(at < static_cast<Index>(cut.kept.size()), folder.string(),
                "base.obj: the landmark at vertex ", v, " is not on the head");
        marks.push_back(static_cast<std::int32_t>(cut.place[static_cast<std::size_t>(at)]));
    }
    for (const auto& range : cut.range)
        for (const Index v : range) ranges.push_back(static_cast<std::int32_t>(v));
    pack.arrays["lmk68"] = list({68}, marks);
    pack.arrays["part_range"] = list({static_cast<Index>(part_names.size()), 2}, ranges);
    std::vector<float> centres, radii;
    for (const std::vector<Index>& eye : eyes) {
        const Ball ball = ball_of(mean, eye);
        append_columns(centres, per_dm * Points(ball.centre));
        radii.push_back(static_cast<float>(per_dm * ball.radius));
    }
    pack.arrays["eye_center"] = list({2, 3}, centres);
    pack.arrays["eye_radius"] = list({2}, radii);
    pack.names = names_json(shapes, modes, cut);
    return pack;
}

} // namespace rye::trainer
