// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/ray_caster.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <rye/core/error.hpp>
#include <rye/math/linalg.hpp>

namespace rye::trainer {
namespace {

/// Bins per axis in the search for the best split.
constexpr int bin_count = 16;
/// Largest number of triangles of a leaf.
constexpr Index leaf_size = 3;
/// Size of the traversal stack; the build splits at the median below half that depth.
constexpr int max_depth = 64;
/// Tolerance by which a ray through a shared edge meets one of its triangles despite rounding.
constexpr double edge_slack = 1e-10;
/// Relative enlargement of boxes, so that a ray in the plane of a side meets the box.
constexpr double box_slack = 1e-12;
constexpr double infinity = std::numeric_limits<double>::infinity();

/// 1 / d, with 0 replaced by a tiny number, so that 0 * inf cannot occur.
double safe_inverse(double d) {
    return 1.0 / (std::abs(d) < 1e-290 ? std::copysign(1e-290, d) : d);
}

struct Box {
    Vec3<double> lower = Vec3<double>::Constant(infinity);
    Vec3<double> upper = -lower;

    void add(const Vec3<double>& p) {
        lower = lower.cwiseMin(p);
        upper = upper.cwiseMax(p);
    }
    void add(const Box& b) {
        lower = lower.cwiseMin(b.lower);
        upper = upper.cwiseMax(b.upper);
    }
    double half_area() const {
        const Vec3<double> d = (upper - lower).cwiseMax(0.0);
        return d.x() * d.y() + d.y() * d.z() + d.z() * d.x();
    }
};

} // namespace

struct RayCaster::Builder {
    std::vector<Box> boxes;
    std::vector<Vec3<double>> centres;
    std::vector<Index> order;

    Box bounds(Index first, Index count) const {
        Box box;
        for (Index i = first; i < first + count; ++i)
            box.add(boxes[static_cast<std::size_t>(order[static_cast<std::size_t>(i)])]);
        return box;
    }

    /// The cheapest split between bins of each axis, by the surface area heuristic.
    Split best_split(Index first, Index count) const {
        Box span;
        for (Index i = first; i < first + count; ++i)
            span.add(centres[static_cast<std::size_t>(order[static_cast<std::size_t>(i)])]);
        Split best;
        best.cost = bounds(first, count).half_area() * static_cast<double>(count);
        for (int axis = 0; axis < 3; ++axis) {
            const double width = span.upper[axis] - span.lower[axis];
            if (!(width > 0)) continue;
            std::array<Box, bin_count> box;
            std::array<double, bin_count> size{};
            for (Index i = first; i < first + count; ++i) {
                const auto t = static_cast<std::size_t>(order[static_cast<std::size_t>(i)]);
                const double x = (centres[t][axis] - span.lower[axis]) / width;
                const auto bin = static_cast<std::size_t>(
                    std::min(bin_count - 1, static_cast<int>(x * bin_count)));
                box[bin].add(boxes[t]);
                size[bin] += 1;
            }
            std::array<double, bin_count> right_cost{};
            Box right;
            double right_size = 0;
            for (std::size_t b = bin_count; b-- > 1;) {
                right.add(box[b]);
                right_size += size[b];
                right_cost[b] = right_size > 0 ? right.half_area() * right_size : 0;
            }
            Box left;
            double left_size = 0;
            for (std::size_t b = 1; b < bin_count; ++b) {
                left.add(box[b - 1]);
                left_size += size[b - 1];
                const double cost =
                    (left_size > 0 ? left.half_area() * left_size : 0) + right_cost[b];
                if (cost < best.cost && left_size > 0 && left_size < static_cast<double>(count))
                    best = {axis, span.lower[axis] + width * static_cast<double>(b) / bin_count,
                            cost};
            }
        }
        return best;
    }

    void build(std::vector<Node>& nodes, Index at, int depth) {
        const Index first = nodes[static_cast<std::size_t>(at)].first;
        const Index count = nodes[static_cast<std::size_t>(at)].count;
        if (count <= leaf_size) return;
        Split split;
        if (depth < max_depth / 2) split = best_split(first, count);
        const auto begin = order.begin() + first, end = begin + count;
        auto middle = begin + count / 2;
        if (split.axis >= 0)
            middle = std::partition(begin, end, [&](Index t) {
                return centres[static_cast<std::size_t>(t)][split.axis] < split.at;
            });
        else if (count <= 4 * leaf_size && depth < max_depth / 2)
            return;
        // Rounding can leave one side empty; then any split will do.
        if (middle == begin || middle == end) middle = begin + count / 2;
        const Index left = middle - begin, children = static_cast<Index>(nodes.size());
        nodes[static_cast<std::size_t>(at)].first = children;
        nodes[static_cast<std::size_t>(at)].count = 0;
        for (const auto& [f, n] : {std::pair{first, left}, std::pair{first + left, count - left}}) {
            const Box box = bounds(f, n);
            nodes.push_back({box.lower, box.upper, f, n});
        }
        build(nodes, children, depth + 1);
        build(nodes, children + 1, depth + 1);
    }
};

RayCaster::RayCaster(const ColumnsView<double>& vertices, const std::vector<Face>& faces) {
    require(vertices.rows() == 3 && vertices.allFinite(), "ray caster",
            "a vertex is not finite");
    Builder builder;
    const std::size_t n = faces.size();
    builder.boxes.resize(n);
    builder.centres.resize(n);
    builder.order.resize(n);
    for (std::size_t f = 0; f < n; ++f) {
        Box& box = builder.boxes[f];
        for (const Index i : faces[f]) box.add(vertices.col(i));
        const double slack = box_slack * std::max(1.0, box.lower.cwiseAbs().maxCoeff());
        box.lower.array() -= slack;
        box.upper.array() += slack;
        builder.centres[f] = 0.5 * (builder.boxes[f].lower + builder.boxes[f].upper);
        builder.order[f] = static_cast<Index>(f);
    }
    if (n == 0) return;
    nodes_.reserve(2 * n);
    const Box all = builder.bounds(0, static_cast<Index>(n));
    nodes_.push_back({all.lower, all.upper, 0, static_cast<Index>(n)});
    builder.build(nodes_, 0, 0);
    triangles_.reserve(n);
    for (const Index t : builder.order) {
        const Face& f = faces[static_cast<std::size_t>(t)];
        const Vec3<double> a = vertices.col(f[0]);
        triangles_.push_back({a, vertices.col(f[1]) - a, vertices.col(f[2]) - a, t});
    }
}

namespace {

/// Calls visit(leaf) for the leaves that a ray enters, the nearer child first, until it returns
/// true. `entry` returns the distance at which the ray enters a node, infinity if it misses;
/// `furthest` the distance beyond which nothing is looked for.
template <class Node, class Entry, class Furthest, class Visit>
void visit_leaves(const std::vector<Node>& nodes, const Entry& entry, const Furthest& furthest,
                  const Visit& visit) {
    struct Waiting {
        Index node;
        double enter;
    };
    std::array<Waiting, max_depth + 2> stack;
    std::size_t waiting = 0;
    if (entry(nodes[0]) < infinity) stack[waiting++] = {0, 0.0};
    while (waiting > 0) {
        const Waiting next = stack[--waiting];
        if (next.enter > furthest()) continue;
        const Node& node = nodes[static_cast<std::size_t>(next.node)];
        if (node.count > 0) {
            if (visit(node)) return;
            continue;
        }
        Waiting near{node.first, entry(nodes[static_cast<std::size_t>(node.first)])};
        Waiting far{node.first + 1, entry(nodes[static_cast<std::size_t>(node.first) + 1])};
        if (far.enter < near.enter) std::swap(near, far);
        if (far.enter < infinity) stack[waiting++] = far;
        if (near.enter < infinity) stack[waiting++] = near;
    }
}

} // namespace

template <bool any>
Hit RayCaster::walk(const Ray& ray) const {
    Hit hit;
    hit.t = ray.t_max;
    if (nodes_.empty()) return hit;
    const Vec3<double> inverse = ray.direction.unaryExpr(&safe_inverse);
    // Distance at which the ray enters the box; infinity if it misses.
    const auto entry = [&](const Node& node) {
        double enter = ray.t_min, leave = hit.t;
        for (int i = 0; i < 3; ++i) {
            const double a = (node.lower[i] - ray.origin[i]) * inverse[i];
            const double b = (node.upper[i] - ray.origin[i]) * inverse[i];
            enter = std::max(enter, std::min(a, b));
            leave = std::min(leave, std::max(a, b));
        }
        return enter <= leave ? enter : infinity;
    };
    visit_leaves(
        nodes_, entry, [&] { return hit.t; },
        [&](const Node& node) {
            for (Index i = node.first; i < node.first + node.count; ++i) {
                const Triangle& tri = triangles_[static_cast<std::size_t>(i)];
                const Vec3<double> p = cross(ray.direction, tri.ac);
                const double det = tri.ab.dot(p);
                if (det == 0) continue;
                const Vec3<double> s = ray.origin - tri.a;
                const double u = s.dot(p) / det;
                if (u < -edge_slack || u > 1 + edge_slack) continue;
                const Vec3<double> q = cross(s, tri.ab);
                const double v = ray.direction.dot(q) / det;
                if (v < -edge_slack || u + v > 1 + edge_slack) continue;
                const double t = tri.ac.dot(q) / det;
                // At equal distance the face of lower index wins, so the tree does not matter.
                if (t < ray.t_min || t > hit.t || (t == hit.t && hit && tri.face > hit.face))
                    continue;
                hit = {tri.face, t, u, v};
                if constexpr (any) return true;
            }
            return false;
        });
    return hit;
}

std::array<Hit, 4> RayCaster::nearest(const RayBundle& rays) const {
    using Lanes = Eigen::Array<double, 4, 1>; // one ray each
    std::array<Hit, 4> hits;
    if (nodes_.empty()) return hits;
    std::array<Lanes, 3> d, inverse;
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 4; ++k) {
            const auto axis = static_cast<std::size_t>(i);
            d[axis][k] = rays.directions[static_cast<std::size_t>(k)][i];
            inverse[axis][k] = safe_inverse(d[axis][k]);
        }
    Lanes closest = Lanes::Constant(infinity);
    // The first distance at which any of the rays enters the box.
    const auto entry = [&](const Node& node) {
        Lanes enter = Lanes::Zero(), leave = closest;
        for (int i = 0; i < 3; ++i) {
            const auto axis = static_cast<std::size_t>(i);
            const Lanes a = (node.lower[i] - rays.origin[i]) * inverse[axis];
            const Lanes b = (node.upper[i] - rays.origin[i]) * inverse[axis];
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        return (enter <= leave).select(enter, infinity).minCoeff();
    };
    const auto meet = [&](const Triangle& tri) {
        const Vec3<double> s = rays.origin - tri.a, q = cross(s, tri.ab);
        const Vec3<double>&ab = tri.ab, &ac = tri.ac;
        const Lanes px = d[1] * ac[2] - d[2] * ac[1], py = d[2] * ac[0] - d[0] * ac[2];
        const Lanes pz = d[0] * ac[1] - d[1] * ac[0];
        const Lanes det = ab[0] * px + ab[1] * py + ab[2] * pz;
        const Lanes u = (s[0] * px + s[1] * py + s[2] * pz) / det;
        const Lanes v = (d[0] * q[0] + d[1] * q[1] + d[2] * q[2]) / det;
        const Lanes t = ac.dot(q) / det; // a det of 0 gives NaN or inf, which fails the tests
        const auto within = (u >= -edge_slack && v >= -edge_slack && u + v <= 1 + edge_slack &&
                             t >= 0.0 && t <= closest)
                                .eval();
        if (!within.any()) return;
        for (int k = 0; k < 4; ++k) {
            Hit& hit = hits[static_cast<std::size_t>(k)];
            if (!within[k] || (t[k] == hit.t && hit && tri.face > hit.face)) continue;
            hit = {tri.face, t[k], u[k], v[k]};
            closest[k] = t[k];
        }
    };
    visit_leaves(
        nodes_, entry, [&] { return closest.maxCoeff(); },
        [&](const Node& node) {
            for (Index i = node.first; i < node.first + node.count; ++i)
                meet(triangles_[static_cast<std::size_t>(i)]);
            return false;
        });
    return hits;
}

Hit RayCaster::nearest(const Ray& ray) const { return walk<false>(ray); }
bool RayCaster::meets(const Ray& ray) const { return static_cast<bool>(walk<true>(ray)); }

} // namespace rye::trainer
