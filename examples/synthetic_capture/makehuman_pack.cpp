// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/makehuman_pack.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include <nlohmann/json.hpp>

#include <rye/core/error.hpp>

#include "data/json.hpp"
#include "synthetic_capture/makehuman_tables.hpp"
#include "synthetic_capture/noise.hpp"
#include "synthetic_capture/subdivision.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using V3 = Vec3<double>;
using Named = std::vector<std::pair<std::string, Points>>;

/// Units of the pack in a decimetre.
constexpr double per_dm = 10;
/// Where the middle between the eyeballs is to be [dm], as in ICT-FaceKit's mean head.
const V3 eyes_at(0, 0.36, 0.81);
/// Displacements that are left out of the expressions, in units of the pack.
constexpr double least_move = 2e-4;

/// Names of the parts, which are ICT-FaceKit's; MakeHuman's head lacks some.
constexpr std::array part_names{"face",
                                "head_neck",
                                "mouth_socket",
                                "eye_socket_left",
                                "eye_socket_right",
                                "gums_tongue",
                                "teeth",
                                "sclera_left",
                                "iris_left",
                                "sclera_right",
                                "iris_right",
                                "lacrimal_left",
                                "lacrimal_right",
                                "eye_blend_left",
                                "eye_blend_right",
                                "eye_occlusion_left",
                                "eye_occlusion_right",
                                "eyelashes_left",
                                "eyelashes_right"};
constexpr int face = 0, head_neck = 1, mouth_socket = 2, tongue = 5, teeth = 6, left_eye = 7,
              right_eye = 9;
/// Number of the faces of the eye sockets and of all that is not of the head, which are left out.
constexpr int socket = -2, elsewhere = -1;

std::string replaced(std::string_view text, char what, std::string_view by) {
    std::string out;
    for (const char c : text)
        if (c == what)
            out += by;
        else
            out += c;
    return out;
}

/// MakeHuman's folder: the base mesh, and targets by name.
class Source {
  public:
    explicit Source(const fs::path& folder) : folder_(folder) {
        const fs::path path = folder / "base.obj";
        mesh = parse_quads(read_plain_or_gz(path), path.string());
        require(mesh.vertices.cols() == makehuman::base_vertices, path.string(), "got ",
                mesh.vertices.cols(), " vertices, expected the ", makehuman::base_vertices,
                " of MakeHuman's base mesh hm08");
    }
    Points target(const std::string& name) const {
        const fs::path path = folder_ / "targets" / (name + ".target");
        return parse_target(read_plain_or_gz(path), mesh.vertices.cols(), path.string());
    }
    /// The sum over both sides of a target whose name has a *.
    Points both(std::string_view name) const {
        if (name.find('*') == std::string_view::npos) return target(std::string(name));
        return target(replaced(name, '*', "l")) + target(replaced(name, '*', "r"));
    }

    QuadMesh mesh;

  private:
    fs::path folder_;
};

/// Number of the texture island of each texture coordinate.
std::vector<Index> islands(const QuadMesh& mesh) {
    std::vector<Index> parent(static_cast<std::size_t>(mesh.uv.cols()));
    std::iota(parent.begin(), parent.end(), Index(0));
    const auto root = [&](Index i) {
        for (auto k = static_cast<std::size_t>(i); parent[k] != i; k = static_cast<std::size_t>(i))
            i = parent[k] = parent[static_cast<std::size_t>(parent[k])];
        return i;
    };
    for (const Quad& q : mesh.faces)
        for (const Index u : q.uv) parent[static_cast<std::size_t>(root(u))] = root(q.uv[0]);
    std::vector<Index> island;
    for (Index i = 0; i < mesh.uv.cols(); ++i) island.push_back(root(i));
    return island;
}

/// Part of each face of the base mesh.
std::vector<int> parts_of(const QuadMesh& mesh) {
    const std::vector<Index> island = islands(mesh);
    constexpr std::array<std::pair<Index, int>, 4> known{{{makehuman::nose_tip, face},
                                                          {makehuman::palate, mouth_socket},
                                                          {makehuman::left_socket, socket},
                                                          {makehuman::right_socket, socket}}};
    std::array<Index, 4> known_island{-1, -1, -1, -1};
    for (const Quad& q : mesh.faces)
        for (std::size_t k = 0; k < 4; ++k)
            if (std::find(q.vertex.begin(), q.vertex.end(), known[k].first) != q.vertex.end())
                known_island[k] = island[static_cast<std::size_t>(q.uv[0])];
    std::vector<int> parts;
    for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
        const Quad& q = mesh.faces[f];
        const std::string& group = mesh.groups[mesh.group[f]];
        int part = elsewhere;
        if (group == "helper-tongue") part = tongue;
        if (group == "helper-upper-teeth" || group == "helper-lower-teeth") part = teeth;
        if (group == "helper-l-eye") part = left_eye;
        if (group == "helper-r-eye") part = right_eye;
        const auto near = [&](Index v) {
            return mesh.vertices(1, v) > makehuman::lowest &&
                   std::abs(mesh.vertices(0, v)) < makehuman::widest;
        };
        if (group == "body" && std::all_of(q.vertex.begin(), q.vertex.end(), near)) {
            part = head_neck;
            for (std::size_t k = 0; k < 4; ++k)
                if (known_island[k] == island[static_cast<std::size_t>(q.uv[0])])
                    part = known[k].second;
        }
        parts.push_back(part);
    }
    return parts;
}

/// Takes faces with two or more borders off the cut's edge, so that no teeth of a saw are left.
void trim_edge(const QuadMesh& mesh, std::vector<int>& parts) {
    constexpr int rounds = 3;
    for (int round = 0; round < rounds; ++round) {
        std::map<std::pair<Index, Index>, int> faces; // on each edge
        const auto edge = [&](const Quad& q, std::size_t k) {
            return std::minmax(q.vertex[k], q.vertex[(k + 1) % 4]);
        };
        for (std::size_t f = 0; f < parts.size(); ++f)
            for (std::size_t k = 0; parts[f] >= 0 && k < 4; ++k)
                ++faces[std::pair<Index, Index>(edge(mesh.faces[f], k))];
        for (std::size_t f = 0; f < parts.size(); ++f) {
            int borders = 0;
            for (std::size_t k = 0; parts[f] == head_neck && k < 4; ++k)
                borders += faces[std::pair<Index, Index>(edge(mesh.faces[f], k))] == 1;
            if (borders >= 2) parts[f] = elsewhere;
        }
    }
}

/// The head cut out of the base mesh and subdivided: which vertices, and how they are made.
struct Cut {
    std::vector<Index> kept;                                     ///< vertices of the base mesh
    Subdivision mesh;                                            ///< of the kept ones
    std::vector<int> parts;                                      ///< of its faces
    std::vector<Index> order;                                    ///< its vertices, by part
    std::vector<Index> place;                                    ///< in the order, of each vertex
    std::array<std::array<Index, 2>, part_names.size()> range{}; ///< places of each part

    /// Subdivided columns in their order, of points or displacements of the base mesh.
    Points operator()(const Points& all) const {
        const Points made = Points(all(Eigen::all, kept)) * mesh.weights;
        return made(Eigen::all, order);
    }
};

Cut cut_head(const QuadMesh& base) {
    std::vector<int> parts = parts_of(base);
    trim_edge(base, parts);
    Cut cut;
    std::vector<Index> place(static_cast<std::size_t>(base.vertices.cols()), -1);
    std::vector<Quad> faces;
    std::vector<int> face_parts;
    for (std::size_t f = 0; f < parts.size(); ++f) {
        if (parts[f] < 0) continue;
        Quad q = base.faces[f];
        for (Index& v : q.vertex) {
            Index& at = place[static_cast<std::size_t>(v)];
            if (at < 0) {
                at = static_cast<Index>(cut.kept.size());
                cut.kept.push_back(v);
            }
            v = at;
        }
        faces.push_back(q);
        for (int k = 0; k < 4; ++k) cut.parts.push_back(parts[f]);
    }
    cut.mesh = subdivided(static_cast<Index>(cut.kept.size()), base.uv, faces);
    // Vertices at seams are of the first of their parts.
    const auto n = static_cast<std::size_t>(cut.mesh.weights.cols());
    std::vector<int> part(n, static_cast<int>(part_names.size()) - 1);
    for (std::size_t f = 0; f < cut.parts.size(); ++f)
        for (const Index v : cut.mesh.faces[f].vertex)
            part[static_cast<std::size_t>(v)] =
                std::min(part[static_cast<std::size_t>(v)], cut.parts[f]);
    cut.order.resize(n);
    std::iota(cut.order.begin(), cut.order.end(), Index(0));
    const auto part_at = [&](Index v) { return part[static_cast<std::size_t>(v)]; };
    std::stable_sort(cut.order.begin(), cut.order.end(),
                     [&](Index a, Index b) { return part_at(a) < part_at(b); });
    cut.place.resize(n);
    for (std::size_t i = 0; i < n; ++i)
        cut.place[static_cast<std::size_t>(cut.order[i])] = static_cast<Index>(i);
    Index at = 0;
    for (std::size_t p = 0; p < part_names.size(); ++p) {
        cut.range[p][0] = at;
        at += std::count(part.begin(), part.end(), static_cast<int>(p));
        cut.range[p][1] = at;
    }
    return cut;
}

/// Vertices of a group of the base mesh.
std::vector<Index> group_vertices(const QuadMesh& mesh, const std::string& name) {
    std::vector<Index> list;
    for (std::size_t f = 0; f < mesh.faces.size(); ++f)
        if (mesh.groups[mesh.group[f]] == name)
            list.insert(list.end(), mesh.faces[f].vertex.begin(), mesh.faces[f].vertex.end());
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
    require(!list.empty(), "MakeHuman's base mesh", "has no group '", name, "'");
    return list;
}

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

/// Means over the kinds of people, at an age.
Points mean_kind(const Source& source, const char* age) {
    Points sum = Points::Zero(3, source.mesh.vertices.cols());
    for (const std::string kind : makehuman::kinds)
        for (const char* gender : {"female", "male"})
            sum += source.target("macrodetails/" + kind + "-" + gender + "-" + age) / 6;
    return sum;
}

/// Modes of identity, before the eyes are put in place.
Named identity_modes(const Source& source, const Points& mean) {
    Named modes;
    const auto kind = [&](const std::string& name) {
        return source.target("macrodetails/" + name + "-young");
    };
    Points gender = Points::Zero(3, mean.cols());
    for (const std::string name : makehuman::kinds) {
        const Points female = kind(name + "-female"), male = kind(name + "-male");
        gender += (male - female) / 6;
        modes.emplace_back(name, makehuman::kind_weight * (0.5 * (female + male) - mean));
    }
    modes.pop_back(); // minus the sum of the others
    modes.emplace_back("gender", makehuman::gender_weight * gender);
    modes.emplace_back("age", makehuman::age_weight * (mean_kind(source, "old") - mean));
    for (const makehuman::Mode& m : makehuman::modes)
        modes.emplace_back(m.name, m.weight * (source.both(m.plus) - source.both(m.minus)));
    return modes;
}

/// The rims of the lids: vertices between the eyeballs and the crests, each with the vertex of a
/// crest that it follows. The targets move the crests and leave most of the rims behind, which then
/// hang before the irises.
class LidRims {
  public:
    explicit LidRims(const QuadMesh& mesh) {
        const std::vector<int> parts = parts_of(mesh);
        std::vector<int> ring(static_cast<std::size_t>(mesh.vertices.cols()), -1);
        const auto ring_of = [&](Index v) -> int& { return ring[static_cast<std::size_t>(v)]; };
        for (std::size_t f = 0; f < parts.size(); ++f)
            if (parts[f] == socket)
                for (const Index v : mesh.faces[f].vertex) ring_of(v) = 0;
        for (int k = 0; k < rings; ++k)
            for (std::size_t f = 0; f < parts.size(); ++f) {
                const auto& v = mesh.faces[f].vertex;
                if (parts[f] != face) continue;
                for (std::size_t i = 0; i < 4; ++i)
                    for (const Index beside : {v[(i + 1) % 4], v[(i + 3) % 4]})
                        if (ring_of(v[i]) == k && ring_of(beside) < 0) ring_of(beside) = k + 1;
            }
        std::vector<Index> crest;
        for (Index i = 0; i < mesh.vertices.cols(); ++i)
            if (ring_of(i) == rings) crest.push_back(i);
        for (Index i = 0; i < mesh.vertices.cols(); ++i) {
            if (ring_of(i) < 0 || ring_of(i) >= rings) continue;
            const auto away = [&](Index c) {
                return (mesh.vertices.col(c) - mesh.vertices.col(i)).squaredNorm();
            };
            follows_.emplace_back(
                i, *std::min_element(crest.begin(), crest.end(),
                                     [&](Index a, Index b) { return away(a) < away(b); }));
        }
    }
    void operator()(Points& moved) const {
        for (const auto& [vertex, crest] : follows_) {
            const V3 by = moved.col(crest);
            moved.col(vertex) = by;
        }
    }

  private:
    /// Edges from the border of a socket to the crest.
    static constexpr int rings = 3;
    std::vector<std::pair<Index, Index>> follows_;
};

/// What lids do that follow the gaze, at its full angles: the upper lid goes with the eye, the
/// lower lid a part of the way, and both a little to the side.
void add_lid_shapes(const Source& source, Named& shapes) {
    for (const std::size_t e : {0U, 1U}) {
        const std::string unit =
            std::string("expression/units/caucasian/eye-") + (e == 0 ? "left" : "right");
        const std::string side = e == 0 ? "_L" : "_R";
        const Points closed = source.target(unit + "-closure");
        const Points opened = source.target(unit + "-opened-up");
        Points lower = source.target(unit + "-slit"), aside = Points::Zero(3, lower.cols());
        for (Index i = 0; i < lower.cols(); ++i) {
            if (lower(1, i) < 0) lower.col(i).setZero();
            const double moves =
                closed.col(i).norm() + 3 * (opened.col(i).norm() + lower.col(i).norm());
            aside(0, i) = (e == 0 ? 0.015 : -0.015) * std::min(1.0, moves / 0.1);
        }
        shapes.emplace_back("eyeLookDown" + side, 0.55 * closed - 0.6 * lower);
        shapes.emplace_back("eyeLookIn" + side, -aside);
        shapes.emplace_back("eyeLookOut" + side, aside);
        shapes.emplace_back("eyeLookUp" + side, 2.0 * opened + 0.35 * lower);
    }
}

/// The part of a target that an expression of a side takes; side 0 is left, 1 right, 2 none.
Points share_of(Points moved, const makehuman::Expression& e, int side, const Source& source) {
    for (Index i = 0; i < moved.cols(); ++i) {
        double part = e.weight;
        const double x = (side == 1 ? -1 : 1) * source.mesh.vertices(0, i);
        if (e.share != makehuman::Share::all) part *= smooth_step(-0.12, 0.12, x);
        if (e.share == makehuman::Share::lower) part *= smooth_step(0, -0.02, moved(1, i));
        moved.col(i) *= part;
    }
    if (e.name == "jawOpen") return moved;
    for (const char* group : {"helper-tongue", "helper-upper-teeth", "helper-lower-teeth"})
        for (const Index i : group_vertices(source.mesh, group)) moved.col(i).setZero();
    return moved;
}

Named expression_shapes(const Source& source) {
    Named shapes;
    add_lid_shapes(source, shapes);
    for (const makehuman::Expression& e : makehuman::expressions) {
        const bool sided = e.name.ends_with("_");
        for (int side = sided ? 0 : 2; side < (sided ? 2 : 3); ++side) {
            std::string target = replaced(e.target, '*', "expression/units/caucasian/");
            target = replaced(target, '?', side == 0 ? "left" : "right");
            target = replaced(target, '!', side == 0 ? "l" : "r");
            shapes.emplace_back(std::string(e.name) + (side == 2   ? ""
                                                       : side == 0 ? "L"
                                                                   : "R"),
                                share_of(source.target(target), e, side, source));
        }
    }
    const LidRims rims(source.mesh);
    for (auto& [name, moved] : shapes)
        if (name.starts_with("eye")) rims(moved);
    std::sort(shapes.begin(), shapes.end(),
              [](const auto& a, const auto& b) { return a.first < b.first; });
    return shapes;
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
