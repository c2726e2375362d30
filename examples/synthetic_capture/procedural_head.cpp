// SPDX-License-Identifier: Apache-2.0
/// The procedural head: geometry, texture and expressions by formulas, from one seed.
#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>

#include <rye/core/random.hpp>
#include <rye/math/rotation.hpp>

#include "data/degrees.hpp"
#include "synthetic_capture/head_lids.hpp"
#include "synthetic_capture/noise.hpp"
#include "synthetic_capture/skin_paint.hpp"

namespace rye::trainer {
namespace {

using V3 = Vec3<double>;

/// Height of the scalp's hair above the skin.
constexpr double hair_height = 0.055;
/// Rotation of the jaw at jawOpen = 1, about the axis through its joints.
constexpr double jaw_turn = 15 * degree;
const V3 jaw_joint(0, 0.06, 0.12);

enum Expression {
    brow_down_l,
    brow_down_r,
    brow_inner_up,
    brow_outer_up_l,
    brow_outer_up_r,
    cheek_puff,
    blink_l,
    blink_r,
    squint_l,
    squint_r,
    wide_l,
    wide_r,
    jaw_left,
    jaw_open,
    jaw_right,
    frown,
    pucker,
    smile_l,
    smile_r,
    upper_up,
    nose_sneer,
    expression_count
};
const std::vector<std::string> names{
    "browDown_L",   "browDown_R",   "browInnerUp", "browOuterUp_L", "browOuterUp_R", "cheekPuff",
    "eyeBlink_L",   "eyeBlink_R",   "eyeSquint_L", "eyeSquint_R",   "eyeWide_L",     "eyeWide_R",
    "jawLeft",      "jawOpen",      "jawRight",    "mouthFrown",    "mouthPucker",   "mouthSmile_L",
    "mouthSmile_R", "mouthUpperUp", "noseSneer"};

/// A smooth displacement of the left half of the face, mirrored on the right with its own weight.
struct Push {
    int left, right; // weights that drive it, on either side
    V3 centre, radii, move;
    bool upper_lip_only = false;
};
const std::vector<Push> pushes{
    {brow_down_l, brow_down_r, {0.26, 0.60, 1.00}, {0.24, 0.13, 0.40}, {-0.035, -0.085, 0.012}},
    {brow_inner_up, brow_inner_up, {0.12, 0.62, 1.05}, {0.17, 0.19, 0.40}, {0.0, 0.10, 0.0}},
    {brow_outer_up_l, brow_outer_up_r, {0.46, 0.60, 0.90}, {0.21, 0.19, 0.40}, {0.0, 0.10, -0.01}},
    {cheek_puff, cheek_puff, {0.42, -0.22, 0.78}, {0.20, 0.19, 0.40}, {0.09, 0.0, 0.06}},
    {squint_l, squint_r, {0.38, 0.14, 0.93}, {0.20, 0.12, 0.40}, {0.0, 0.045, 0.018}},
    {wide_l, wide_r, {0.33, 0.60, 0.98}, {0.25, 0.13, 0.40}, {0.0, 0.045, 0.0}},
    {frown, frown, {0.24, -0.34, 1.00}, {0.14, 0.12, 0.40}, {0.015, -0.075, -0.01}},
    {smile_l, smile_r, {0.25, -0.325, 1.00}, {0.16, 0.13, 0.40}, {0.075, 0.080, -0.040}},
    {smile_l, smile_r, {0.42, 0.01, 0.88}, {0.18, 0.16, 0.40}, {0.020, 0.045, 0.022}},
    {upper_up, upper_up, {0.07, -0.27, 1.14}, {0.17, 0.10, 0.40}, {0.0, 0.060, 0.012}, true},
    {nose_sneer, nose_sneer, {0.12, 0.01, 1.10}, {0.10, 0.13, 0.40}, {0.005, 0.040, 0.0}},
};

/// Weight with which a point below the lips' line follows the jaw.
double below_lips(const V3& p, bool lower_side) {
    const double under = mouth_line(p.x()) - p.y(), beside = std::abs(p.x());
    const double apart = std::pow(std::max(0.0, 1 - beside * beside / (0.26 * 0.26)), 0.7);
    return std::lerp(smooth_step(-0.16, 0.30, under), lower_side ? 1.0 : 0.0, apart);
}

double jaw_weight(const V3& p, bool lower_side) {
    const double neck = smooth_step(-1.25, -0.78, p.y());
    return below_lips(p, lower_side) * neck * smooth_step(-0.02, 0.42, p.z()) *
           smooth_step(0.25, -0.05, p.y());
}

/// The head's parts and their deformations.
struct Parts {
    HeadGrid grid;
    HeadShape shape;
    Eyeball left_eye;
    std::vector<EyeLids> lids;
    std::array<Index, 2> first_rim{};
    Points rest;               // closed skin, then everything else
    std::vector<Points> moves; // per expression weight, on the rest vertices
    VecX<double> jaw;          // weight of each vertex

    Points vertices(const VecX<double>& expression, const VecX<double>& lid) const {
        Points v = rest;
        for (int eye = 0; eye < 2; ++eye) {
            const LidState state = lid_state({expression[blink_l + eye], expression[squint_l + eye],
                                              expression[wide_l + eye], lid[eye], lid[2 + eye]});
            lids[static_cast<std::size_t>(eye)].open(v, state, 0.6 * (lid[6 + eye] - lid[4 + eye]),
                                                     first_rim[static_cast<std::size_t>(eye)]);
        }
        for (int k = 0; k < expression_count; ++k)
            if (expression[k] != 0) v += expression[k] * moves[static_cast<std::size_t>(k)];
        const Mat3<double> turn = so3_exp(V3(jaw_turn * expression[jaw_open], 0, 0));
        const double aside = 0.07 * (expression[jaw_left] - expression[jaw_right]);
        const V3 drop = V3(aside, -0.02 * expression[jaw_open], 0.01 * expression[jaw_open]);
        for (Index i = 0; i < v.cols(); ++i) {
            if (jaw[i] == 0) continue;
            const V3 p = v.col(i);
            const V3 turned = turn * (p - jaw_joint) + jaw_joint + drop;
            v.col(i) = p + jaw[i] * (turned - p);
        }
        return v;
    }
};

/// Lips: the sculpted muzzle, displaced outwards above and below the line where they meet.
void shape_lips(HeadGrid& grid, const HeadShape& shape) {
    for (Index i = 0; i < grid.vertices.cols(); ++i) {
        V3 p = grid.vertices.col(i);
        const double x = std::abs(p.x()) / 0.255;
        if (p.z() < 0.7 || x > 1.3) continue;
        const double wide = std::sqrt(std::max(0.0, 1 - x * x)), dy = p.y() - mouth_line(p.x());
        const double bow = 1 - 0.16 * std::exp(-80 * p.x() * p.x());
        const double upper = (dy - 0.032 * bow) / 0.033, lower = (dy + 0.042) / 0.038;
        p.z() += (0.050 + shape.lip_fullness) * wide * bow * std::exp(-upper * upper);
        p.z() += (0.052 + shape.lip_fullness) * wide * std::exp(-lower * lower);
        const double seam = dy / 0.014;
        p.z() -= 0.022 * std::exp(-seam * seam) * (x < 1 ? 1.0 : std::exp(-30 * (x - 1) * (x - 1)));
        const V3 corner((p.x() < 0 ? -1 : 1) * 0.262, mouth_line(0.255), 1.0);
        p.z() -= 0.022 * std::exp(-(p - corner).head<2>().squaredNorm() / 0.0025);
        grid.vertices.col(i) = p;
    }
}

/// Collects vertices and faces other than those of the grid.
struct Builder {
    HeadModel& model;
    std::vector<V3> points;
    std::vector<double> jaw;
    std::vector<Index> led_by; // the skin vertex whose expressions move this one, or -1
    Index first = 0;
    std::vector<Vec2<double>> uv;
    Index first_uv = 0;

    Index add(const V3& p, double jaw_follow, Index leader = -1) {
        points.push_back(p);
        jaw.push_back(jaw_follow);
        led_by.push_back(leader);
        return first + static_cast<Index>(points.size()) - 1;
    }
    void face(Index a, Index b, Index c, Part part, const Face& f_uv = {0, 0, 0}) {
        model.faces.push_back({a, b, c});
        model.face_uv.push_back(f_uv);
        model.parts.push_back(part);
    }
    void quad(Index a, Index b, Index c, Index d, Part part) {
        face(a, b, c, part);
        face(a, c, d, part);
    }

    /// A grid of points p(i, j), faces oriented towards (d/dj) x (d/di).
    template <class F>
    void sheet(int n, int m, Part part, const F& p,
               const std::function<double(const V3&)>& jaw_of) {
        const Index start = first + static_cast<Index>(points.size());
        for (int j = 0; j <= m; ++j)
            for (int i = 0; i <= n; ++i) {
                const V3 x = p(static_cast<double>(i) / n, static_cast<double>(j) / m);
                add(x, jaw_of(x));
            }
        for (int j = 0; j < m; ++j)
            for (int i = 0; i < n; ++i) {
                const Index a = start + static_cast<Index>(j) * (n + 1) + i;
                quad(a, a + n + 1, a + n + 2, a + 1, part);
            }
    }
};

/// An ear: profiles from the hollow over the rim to its back, around an egg-shaped outline.
void add_ear(Builder& b, double side, const HeadShape& shape) {
    constexpr int around = 40, across = 22;
    const V3 centre(side * (0.765 + 0.6 * shape.width), 0.075, 0.055);
    // Axes of the ear: out of its opening, upwards, and towards the face.
    const V3 out = normalized(V3(side * 0.90, 0.0, 0.42)), up = normalized(V3(0, 0.98, -0.20));
    const V3 fore = normalized(V3(side * -0.42, 0.20, 0.88));
    const Index start = b.first + static_cast<Index>(b.points.size());
    const Index uv_start = b.first_uv + static_cast<Index>(b.uv.size());
    for (int i = 0; i <= around; ++i)
        for (int j = 0; j <= across; ++j) {
            const double a = 2 * std::numbers::pi * i / around, v = 1.32 * j / across;
            const double c = std::cos(a), s = std::sin(a); // c: towards the face, s: upwards
            const double lobe = smooth_step(-0.45, -0.95, s), face = smooth_step(0.2, 0.95, c);
            double radius = 1 / std::hypot(c / (c > 0 ? 0.125 : 0.175), s / (s > 0 ? 0.30 : 0.275));
            radius *= 1 - 0.10 * face;
            const double r = radius * (v <= 1 ? v : 1 - 0.75 * (v - 1) / 0.32);
            // Depth of the profile: hollow, inner fold, groove, rim; the back returns to the head.
            double h = -0.085 * smooth_step(0.52, 0.30, v) * (1 - 0.6 * lobe);
            h += 0.030 * std::exp(-std::pow((v - 0.60) / 0.10, 2)) * (1 - lobe);
            h -= 0.018 * std::exp(-std::pow((v - 0.78) / 0.07, 2)) * (1 - lobe);
            h += 0.030 * std::exp(-std::pow((v - 0.95) / 0.10, 2)) * (1 - 0.7 * lobe);
            if (v > 1) h -= 0.20 * std::pow((v - 1) / 0.32, 1.3);
            h += 0.055 * -c * smooth_step(0.2, 1.0, std::min(v, 1.0)); // the back edge stands off
            h -= 0.075 * face * smooth_step(0.45, 1.0, v);             // the front grows in
            const double tragus = std::hypot(c - 0.9, s + 0.15);
            h += 0.05 * std::exp(-tragus * tragus * 14) * std::exp(-std::pow((v - 0.62) / 0.2, 2));
            const V3 p = centre + r * (c * fore + s * up) + h * out;
            b.add(p, 0);
            b.uv.push_back(
                {(side > 0 ? 0.0 : 0.5) + 0.45 * i / around + 0.01, 0.91 + 0.085 * j / across});
        }
    for (int i = 0; i < around; ++i)
        for (int j = 0; j < across; ++j) {
            const auto at = [&](int k, int l) { return static_cast<Index>(k) * (across + 1) + l; };
            const Index p = at(i, j), q = at(i + 1, j), r = at(i + 1, j + 1), t = at(i, j + 1);
            const auto tri = [&](Index x, Index y, Index z) {
                b.face(start + x, start + y, start + z, Part::skin,
                       {uv_start + x, uv_start + y, uv_start + z});
            };
            // The right ear is mirrored, so its faces are reversed.
            if (side > 0) {
                tri(p, q, r);
                tri(p, r, t);
            } else {
                tri(p, r, q);
                tri(p, t, r);
            }
        }
}

void add_mouth(Builder& b, const HeadGrid& grid) {
    // Lips rolled inwards: two strips along the slit.
    for (const bool lower : {false, true}) {
        const std::vector<Index>& edge = lower ? grid.mouth.lower : grid.mouth.upper;
        std::vector<Index> previous = edge;
        for (int step = 1; step <= 3; ++step) {
            std::vector<Index> next;
            for (const Index i : edge) {
                const V3 p = grid.vertices.col(i);
                const double s = lower ? -1 : 1, depth = 0.022 * step * step;
                next.push_back(b.add(p + V3(0, s * 0.008 * step, -depth), jaw_weight(p, lower), i));
            }
            for (std::size_t i = 0; i + 1 < edge.size(); ++i) {
                if (lower)
                    b.quad(previous[i], next[i], next[i + 1], previous[i + 1], Part::mouth);
                else
                    b.quad(previous[i + 1], next[i + 1], next[i], previous[i], Part::mouth);
            }
            previous = next;
        }
    }
    // A dark wall behind the teeth.
    b.sheet(
        14, 10, Part::mouth,
        [](double s, double t) {
            const double a = (s - 0.5) * 2.6;
            return V3(0.27 * std::sin(a), -0.08 - 0.42 * t, 0.58 + 0.28 * std::cos(a));
        },
        [](const V3& p) { return smooth_step(-0.25, -0.42, p.y()); });
    // Two rows of slightly rounded teeth.
    for (const bool lower : {false, true}) {
        const double top = lower ? -0.352 : -0.215, height = lower ? 0.105 : 0.115;
        const double size = lower ? 0.95 : 1.0;
        b.sheet(
            96, 4, Part::tooth,
            [&](double s, double t) {
                const double a = (s - 0.5) * 2.5, tooth = std::abs(std::sin(a * 7.2));
                const double round = 0.010 * std::sqrt(tooth) - 0.012 * std::pow(2 * t - 1, 4);
                const double edge = (lower ? 1 - t : t) * 0.012 * (1 - tooth);
                return V3((0.205 * size + round) * std::sin(a),
                          top - height * t + (lower ? -edge : edge),
                          0.80 + (0.225 * size + round) * std::cos(a));
            },
            [&](const V3&) { return lower ? 1.0 : 0.0; });
    }
    // The tongue.
    b.sheet(
        12, 8, Part::mouth,
        [](double s, double t) {
            const double a = (s - 0.5) * std::numbers::pi;
            return V3(0.13 * std::sin(a), -0.40 + 0.05 * std::cos(a) - 0.03 * t, 0.70 + 0.26 * t);
        },
        [](const V3&) { return 1.0; });
}

/// The pink flesh in the inner corner of an eye.
void add_caruncle(Builder& b, double side) {
    b.sheet(
        10, 8, Part::eye_corner,
        [&](double s, double t) {
            const double a = -2 * std::numbers::pi * s, e = (t - 0.5) * std::numbers::pi;
            return V3(side * 0.196 + 0.026 * std::cos(e) * std::cos(a), 0.325 + 0.020 * std::sin(e),
                      0.893 - 0.026 * std::cos(e) * std::sin(a));
        },
        [](const V3&) { return 0.0; });
}

/// Positions of landmarks of the mean head, on the left and in the middle; -1 for no landmark.
struct Place {
    int left, right;
    V3 at;
};
const std::vector<Place> places{
    {16, 0, {0.76, 0.36, 0.34}},     {15, 1, {0.74, 0.16, 0.36}},
    {14, 2, {0.71, -0.04, 0.42}},    {13, 3, {0.66, -0.23, 0.48}},
    {12, 4, {0.57, -0.42, 0.56}},    {11, 5, {0.45, -0.57, 0.68}},
    {10, 6, {0.31, -0.66, 0.84}},    {9, 7, {0.16, -0.70, 0.97}},
    {8, -1, {0.0, -0.72, 1.02}},     {22, 21, {0.125, 0.575, 1.10}},
    {23, 20, {0.25, 0.615, 1.07}},   {24, 19, {0.385, 0.625, 1.01}},
    {25, 18, {0.505, 0.590, 0.92}},  {26, 17, {0.600, 0.515, 0.80}},
    {27, -1, {0.0, 0.38, 1.06}},     {28, -1, {0.0, 0.26, 1.14}},
    {29, -1, {0.0, 0.15, 1.21}},     {30, -1, {0.0, 0.03, 1.30}},
    {35, 31, {0.115, -0.075, 1.12}}, {34, 32, {0.06, -0.105, 1.15}},
    {33, -1, {0.0, -0.115, 1.17}},   {53, 49, {0.165, -0.268, 1.12}},
    {52, 50, {0.070, -0.245, 1.16}}, {51, -1, {0.0, -0.252, 1.17}},
    {55, 59, {0.165, -0.392, 1.09}}, {56, 58, {0.090, -0.412, 1.13}},
    {57, -1, {0.0, -0.416, 1.14}},
};

std::array<Index, 68> find_landmarks(const HeadGrid& grid) {
    std::array<Index, 68> found{};
    const auto closest = [&](const V3& at) {
        Index best = 0;
        (grid.vertices.colwise() - at).colwise().squaredNorm().minCoeff(&best);
        return best;
    };
    const auto put = [&](int landmark, Index vertex) {
        if (landmark >= 0) found[static_cast<std::size_t>(landmark)] = vertex;
    };
    for (const Place& p : places) {
        put(p.left, closest(p.at));
        put(p.right, closest(V3(-p.at.x(), p.at.y(), p.at.z())));
    }
    const auto part = [](const std::vector<Index>& list, double share) {
        return list[static_cast<std::size_t>(
            std::lround(share * static_cast<double>(list.size() - 1)))];
    };
    const Slit &l = grid.eyes[0], &r = grid.eyes[1], &m = grid.mouth;
    const std::array<std::pair<double, bool>, 6> lid{
        {{0, true}, {0.32, true}, {0.70, true}, {1, true}, {0.70, false}, {0.32, false}}};
    constexpr std::array mirrored{39, 38, 37, 36, 41, 40};
    for (std::size_t i = 0; i < 6; ++i) {
        put(42 + static_cast<int>(i), part(lid[i].second ? l.upper : l.lower, lid[i].first));
        put(mirrored[i], part(lid[i].second ? r.upper : r.lower, lid[i].first));
    }
    put(48, m.upper.front());
    put(54, m.upper.back());
    for (const auto& [landmark, share] :
         {std::pair{60, 0.07}, {61, 0.30}, {62, 0.5}, {63, 0.70}, {64, 0.93}})
        put(landmark, part(m.upper, share));
    for (const auto& [landmark, share] : {std::pair{65, 0.70}, {66, 0.5}, {67, 0.30}})
        put(landmark, part(m.lower, share));
    return found;
}

std::vector<Points> expression_moves(const Parts& parts) {
    const HeadGrid& grid = parts.grid;
    std::vector<Points> moves(expression_count, Points::Zero(3, parts.rest.cols()));
    for (Index i = 0; i < grid.vertices.cols(); ++i) {
        const V3 p = grid.vertices.col(i);
        const bool lower = grid.row_of[static_cast<std::size_t>(i)] > grid.mouth.row;
        const double free = 1 - std::max(parts.lids[0].hold(p), parts.lids[1].hold(p));
        for (const Push& push : pushes)
            for (const double side : {1.0, -1.0}) {
                const V3 mirror(side, 1, 1);
                const V3 q = (p.cwiseProduct(mirror) - push.centre).cwiseQuotient(push.radii);
                double w = free * std::exp(-q.squaredNorm());
                if (push.upper_lip_only) w *= 1 - below_lips(p, lower);
                if (w < 1e-4) continue;
                const V3 move = w * push.move.cwiseProduct(mirror);
                moves[static_cast<std::size_t>(side > 0 ? push.left : push.right)].col(i) += move;
            }
        const V3 q = (p - V3(0, -0.32, 1.08)).cwiseQuotient(V3(0.26, 0.20, 0.4));
        const double w = std::exp(-q.squaredNorm());
        if (w > 1e-4) {
            const V3 move = w * V3(-0.48 * p.x(), -0.12 * (p.y() + 0.32), 0.075);
            moves[pucker].col(i) += move;
        }
    }
    return moves;
}

} // namespace

HeadModel procedural_head(std::uint64_t seed, int width) {
    const Random random{seed, 17};
    HeadModel model;
    model.origin = "rye's own head, sculpted by formulas from seed " + std::to_string(seed) +
                   "; free of rights of others";
    model.expression_names = names;
    for (int i = 0; i < 10; ++i) model.identity_names.push_back("identity00" + std::to_string(i));
    model.identity.resize(10);
    for (int i = 0; i < 10; ++i)
        model.identity[i] = std::clamp(random.normal(static_cast<std::uint64_t>(i)), -1.6, 1.6);
    const VecX<double>& id = model.identity;
    const HeadShape shape{0.018 * id[0], 0.030 * id[1], 0.025 * id[2], 0.022 * id[3],
                          0.014 * id[4], 0.012 * id[5], 0.022 * id[6], 0.010 * id[7],
                          0.012 * id[8], 0.008 * id[9]};
    model.eyes[0].centre = V3(0.32, 0.35, 0.79);
    model.eyes[1].centre = V3(-0.32, 0.35, 0.79);

    const auto parts = std::make_shared<Parts>();
    parts->shape = shape;
    parts->left_eye = model.eyes[0];
    parts->grid = head_grid(shape, model.eyes[0]);
    HeadGrid& grid = parts->grid;
    for (int eye = 0; eye < 2; ++eye) parts->lids.emplace_back(grid, eye, model.eyes[0], shape);
    shape_lips(grid, shape);
    for (Index i = 0; i < grid.vertices.cols(); ++i) {
        const V3 p = grid.vertices.col(i), out = normalized(V3(p - V3(0, 0.45, 0.05)));
        const V3 raised = p + hair_height * hair_cover(p, 0.07) * out;
        grid.vertices.col(i) = raised;
    }

    model.faces = grid.faces;
    model.face_uv = grid.face_uv;
    model.parts.assign(model.faces.size(), Part::skin);
    Builder b{model, {}, {}, {}, grid.vertices.cols(), {}, grid.uv.cols()};
    for (int eye = 0; eye < 2; ++eye) {
        const auto e = static_cast<std::size_t>(eye);
        const Index n = static_cast<Index>(grid.eyes[e].upper.size());
        parts->first_rim[e] = b.first + static_cast<Index>(b.points.size());
        for (Index i = 0; i < 2 * n; ++i) b.add(V3::Zero(), 0);
        for (Index i = 0; i + 1 < n; ++i)
            for (const bool upper : {true, false}) {
                const auto& edge = upper ? grid.eyes[e].upper : grid.eyes[e].lower;
                const auto k = static_cast<std::size_t>(i);
                const Index r = parts->first_rim[e] + (upper ? 0 : n) + i;
                const Part part = upper ? Part::lash : Part::eye_corner;
                if (upper == (eye == 0))
                    b.quad(edge[k], edge[k + 1], r + 1, r, part);
                else
                    b.quad(edge[k], r, r + 1, edge[k + 1], part);
            }
    }
    add_mouth(b, grid);
    for (const double side : {1.0, -1.0}) {
        add_ear(b, side, shape);
        add_caruncle(b, side);
    }

    const Index skin = grid.vertices.cols(), all = skin + static_cast<Index>(b.points.size());
    parts->rest.resize(3, all);
    parts->rest.leftCols(skin) = grid.vertices;
    parts->jaw.resize(all);
    for (Index i = 0; i < skin; ++i)
        parts->jaw[i] = jaw_weight(grid.vertices.col(i),
                                   grid.row_of[static_cast<std::size_t>(i)] > grid.mouth.row);
    for (Index i = skin; i < all; ++i) {
        const auto k = static_cast<std::size_t>(i - skin);
        parts->rest.col(i) = b.points[k];
        parts->jaw[i] = b.jaw[k];
    }
    parts->moves = expression_moves(*parts);
    for (Points& moves : parts->moves)
        for (Index i = skin; i < all; ++i)
            if (const Index leader = b.led_by[static_cast<std::size_t>(i - skin)]; leader >= 0)
                moves.col(i) = V3(moves.col(leader));
    model.uv.resize(2, grid.uv.cols() + static_cast<Index>(b.uv.size()));
    model.uv.leftCols(grid.uv.cols()) = grid.uv;
    for (std::size_t i = 0; i < b.uv.size(); ++i)
        model.uv.col(grid.uv.cols() + static_cast<Index>(i)) = b.uv[i];

    model.landmarks = find_landmarks(grid);
    for (Index i = 0; i < skin; ++i) {
        const V3 p = grid.vertices.col(i);
        if (i % 5 == 0 && p.z() > 0.35 && p.y() > -0.78 && p.y() < 0.95) model.dense.push_back(i);
    }
    model.vertices = [parts](const VecX<double>& expression, const VecX<double>& lid) {
        return parts->vertices(expression, lid);
    };

    const Palette colours = palette(seed);
    model.look = colours.eyes;
    const Points neutral =
        parts->vertices(VecX<double>::Zero(expression_count), VecX<double>::Zero(8));
    std::array<V3, 68> marks;
    for (std::size_t i = 0; i < 68; ++i) marks[i] = neutral.col(model.landmarks[i]);
    model.albedo =
        painted(model, neutral, SkinPaint(marks, colours, seed), width, width / 4 * 3);
    return model;
}

} // namespace rye::trainer
