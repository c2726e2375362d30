// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/makehuman_shapes.hpp"

#include <algorithm>

#include "synthetic_capture/makehuman_cut.hpp"
#include "synthetic_capture/makehuman_tables.hpp"
#include "synthetic_capture/noise.hpp"

namespace rye::trainer::makehuman {
namespace {

using V3 = Vec3<double>;

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

/// Adds the shapes of lids that follow the gaze, at its full angles: the upper lid goes with the
/// eye, the lower lid a part of the way, and both a little to the side.
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

} // namespace

Points mean_kind(const Source& source, const std::string& age) {
    Points sum = Points::Zero(3, source.mesh.vertices.cols());
    for (const std::string kind : makehuman::kinds)
        for (const char* gender : {"female", "male"})
            sum += source.target("macrodetails/" + kind + "-" + gender + "-" + age) / 6;
    return sum;
}

Named identity_modes(const Source& source, const Points& mean) {
    Named list;
    const auto kind = [&](const std::string& name) {
        return source.target("macrodetails/" + name + "-young");
    };
    Points gender = Points::Zero(3, mean.cols());
    for (const std::string name : makehuman::kinds) {
        const Points female = kind(name + "-female"), male = kind(name + "-male");
        gender += (male - female) / 6;
        list.emplace_back(name, makehuman::kind_weight * (0.5 * (female + male) - mean));
    }
    list.pop_back(); // minus the sum of the others
    list.emplace_back("gender", makehuman::gender_weight * gender);
    list.emplace_back("age", makehuman::age_weight * (mean_kind(source, "old") - mean));
    for (const makehuman::Mode& m : makehuman::modes)
        list.emplace_back(m.name, m.weight * (source.both(m.plus) - source.both(m.minus)));
    return list;
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

} // namespace rye::trainer::makehuman
