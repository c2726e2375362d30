// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/head_render.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <rye/core/parallel.hpp>
#include <rye/math/rotation.hpp>

#include "data/threads.hpp"
#include "synthetic_capture/corneal_ray.hpp"
#include "synthetic_capture/noise.hpp"
#include "synthetic_capture/skin_paint.hpp"

namespace rye::trainer {
namespace {

using V3 = Vec3<double>;

/// Offset of the origin of shadow rays above the surface, against self-shadowing by rounding.
constexpr double lift = 0.004;
/// Gap between lids and eyeball.
constexpr double lid_gap = 0.010;
constexpr double exposure = 1.0;
/// Ambient light from interreflection of skin, also inside the mouth, where no light ray reaches.
const V3 bounced(0.30, 0.17, 0.13);

/// Share of a light that the cornea mirrors where it is seen along its normal.
constexpr double mirror_share = 0.035;
/// Half a softbox' edge over the width of the lobe that its highlights look like, as
/// corrections/lights.hpp finds it.
constexpr double edge_of_lobe = 1.2;
/// Colour of a dark iris [sRGB].
constexpr double dark_iris = 0.25;

Softbox softbox(const V3& to, double half_size, const V3& radiance, int edge) {
    const V3 z = normalized(to),
             x = normalized(cross(std::abs(z.y()) < 0.999 ? V3(0, 1, 0) : V3(0, 0, 1), z));
    return {z, x, cross(z, x), half_size, radiance, edge};
}
/// The sky, bright above and dim below.
V3 sky(const V3& d) {
    const double t = 0.5 + 0.5 * d.y();
    return V3(0.20, 0.19, 0.18) + t * V3(0.42, 0.43, 0.46);
}
constexpr int sky_directions = 36;

struct Beam {
    V3 to, power; // power: radiance times solid angle
    int box;      // softbox, or -1
};
std::vector<Beam> beams(const std::vector<Softbox>& softboxes) {
    std::vector<Beam> list;
    // A spiral of even density; the lower third of the sky is too dim to be sampled.
    constexpr double golden = 2.399963229728653;
    for (int i = 0; i < sky_directions; ++i) {
        const double y = 1 - 1.66 * (i + 0.5) / sky_directions, r = std::sqrt(1 - y * y);
        const V3 d(r * std::cos(golden * i), y, r * std::sin(golden * i));
        list.push_back({d, sky(d) * (4 * std::numbers::pi / sky_directions), -1});
    }
    for (std::size_t b = 0; b < softboxes.size(); ++b) {
        const Softbox& s = softboxes[b];
        const int edge = s.edge;
        const double solid = 4 * s.half_size * s.half_size / (edge * edge);
        for (int k = 0; k < edge * edge; ++k) {
            const auto place = [&](int i) { return s.half_size * ((2.0 * i + 1) / edge - 1); };
            const V3 d = normalized(V3(s.to + place(k % edge) * s.right + place(k / edge) * s.up));
            list.push_back({d, s.radiance * solid, static_cast<int>(b)});
        }
    }
    return list;
}

/// Part of a softbox that a mirror in direction d reflects, with a soft rim.
double mirrored(const Softbox& s, const V3& d) {
    const double z = d.dot(s.to);
    if (z <= 0) return 0;
    const double far = std::max(std::abs(d.dot(s.right)), std::abs(d.dot(s.up))) / z;
    return smooth_step(1.15, 0.85, far / s.half_size);
}

double power(double x, int n) {
    double result = 1;
    for (; n > 0; n >>= 1, x *= x)
        if (n & 1) result *= x;
    return result;
}

double srgb(double x) { return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055; }
constexpr double knee = 0.5;
/// Tone curve: linear up to a half, then compressed to stay below 1.
double shoulder(double x) {
    return x < knee ? x : 1 - (1 - knee) * std::exp(-(x - knee) / (1 - knee));
}
/// Returns the light whose picture has this colour, in (0, 1).
double light_of(double colour) {
    const double x = colour <= 0.04045 ? colour / 12.92 : std::pow((colour + 0.055) / 1.055, 2.4);
    return x < knee ? x : knee - (1 - knee) * std::log((1 - x) / (1 - knee));
}

/// Returns where in a pixel its rays are [px], their mean in its middle: Roberts' R2 sequence, which
/// is uniform and without rows, shifted.
std::vector<Vec2<double>> places_in_pixel(int samples) {
    std::vector<Vec2<double>> places;
    Vec2<double> mean = Vec2<double>::Zero();
    for (int s = 0; s < samples; ++s) {
        const double a = 0.5 + 0.7548776662466927 * s, b = 0.5 + 0.5698402909980532 * s;
        places.emplace_back(a - std::floor(a), b - std::floor(b));
        mean += places.back() / samples;
    }
    for (Vec2<double>& place : places) place += Vec2<double>(0.5, 0.5) - mean;
    return places;
}

} // namespace

const std::vector<Softbox>& usual_softboxes() {
    static const std::vector<Softbox> both{softbox({0.62, 0.68, 0.95}, 0.26, {17.0, 16.0, 14.6}, 4),
                                           softbox({-0.95, 0.22, 0.60}, 0.30, {3.6, 3.9, 4.3}, 2)};
    return both;
}

Softbox softbox_of(const V3& to, double width, const V3& intensity) {
    V3 radiance;
    for (Index c = 0; c < 3; ++c)
        radiance[c] = (light_of(dark_iris + intensity[c]) - light_of(dark_iris)) / mirror_share;
    return softbox(to, edge_of_lobe * width, radiance, 4);
}

void PosedHead::add_eyeball(const Eyeball& eye, const HeadState& state, int index) {
    const auto e = static_cast<std::size_t>(index);
    const EyeballMesh ball = eyeball_mesh(eye);
    const Mat3<double> turn = quat_matrix(shortest_arc(V3(0, 0, 1), state.optical[e]));
    world_from_eye_[e] = state.world_from_head.rotation * turn;
    eye_centres_[e] = state.world_from_head.apply(eye.centre);
    const Index first = vertices_.cols();
    Points all(3, first + ball.vertices.cols());
    all.leftCols(first) = vertices_;
    all.rightCols(ball.vertices.cols()) =
        (world_from_eye_[e] * ball.vertices).colwise() + eye_centres_[e];
    vertices_ = all;
    for (const Face& f : ball.faces) {
        faces_.push_back({f[0] + first, f[1] + first, f[2] + first});
        parts_.push_back(index == 0 ? Part::eyeball_left : Part::eyeball_right);
    }
}

PosedHead::PosedHead(const HeadModel& model, const HeadState& state)
    : model_(model),
      world_from_lights_(state.world_from_lights),
      softboxes_(state.softboxes),
      corneal_index_(state.corneal_index),
      faces_(model.faces),
      parts_(model.parts),
      caster_(Columns<double>(3, 0), {}) {
    Points head = model.vertices(state.expression, state.lids);
    std::array<Eyeball, 2> eyes = model.eyes;
    for (std::size_t e = 0; e < 2; ++e) displace_eye(head, eyes[e], state.eye_offset[e]);
    clear_eyeballs(head, eyes, state.optical, lid_gap);
    vertices_ =
        (state.world_from_head.rotation * head).colwise() + state.world_from_head.translation;
    for (int e = 0; e < 2; ++e) add_eyeball(eyes[static_cast<std::size_t>(e)], state, e);
    find_normals();
    caster_ = RayCaster(vertices_, faces_);
    gather_light();
}

void PosedHead::find_normals() {
    normals_ = Points::Zero(3, vertices_.cols());
    for (const Face& f : faces_) {
        const V3 n =
            area_vector<double>(vertices_.col(f[0]), vertices_.col(f[1]), vertices_.col(f[2]));
        for (const Index i : f) normals_.col(i) += n;
    }
    for (Index i = 0; i < normals_.cols(); ++i) {
        const V3 n = normals_.col(i);
        const double length = n.norm();
        const V3 unit = length > 0 ? V3(n / length) : V3::Zero();
        normals_.col(i) = unit;
    }
}

void PosedHead::gather_light() {
    std::vector<Beam> all = beams(softboxes_);
    for (Beam& beam : all) beam.to = world_from_lights_ * beam.to;
    light_ = Columns<double>::Zero(3 + static_cast<Index>(softboxes_.size()), vertices_.cols());
    for_chunks(program_threads(), vertices_.cols(), 256, [&](Index begin, Index end, Index) {
        for (Index i = begin; i < end; ++i) {
            const V3 n = normals_.col(i), from = V3(vertices_.col(i)) + lift * n;
            if (n.isZero(0)) continue; // no face uses it
            for (const Beam& beam : all) {
                const double facing = n.dot(beam.to);
                if (facing <= 0 || caster_.meets({from, beam.to})) continue;
                for (int c = 0; c < 3; ++c) light_(c, i) += beam.power[c] * facing;
                if (beam.box < 0) continue;
                const int edge = softboxes_[static_cast<std::size_t>(beam.box)].edge;
                light_(3 + beam.box, i) += 1.0 / (edge * edge);
            }
        }
    });
    // Subsurface scattering, widest in red: irradiance is averaged with the neighbours'.
    constexpr std::array<int, 3> rounds{7, 3, 1};
    std::vector<Index> skin;
    for (std::size_t f = 0; f < faces_.size(); ++f)
        if (parts_[f] == Part::skin) skin.push_back(static_cast<Index>(f));
    VecX<double> sum(vertices_.cols()), count(vertices_.cols());
    for (int c = 0; c < 3; ++c)
        for (int round = 0; round < rounds[static_cast<std::size_t>(c)]; ++round) {
            sum = light_.row(c).transpose();
            count.setOnes();
            for (const Index f : skin) {
                const Face& v = faces_[static_cast<std::size_t>(f)];
                const double total = light_(c, v[0]) + light_(c, v[1]) + light_(c, v[2]);
                for (const Index i : v) {
                    sum[i] += total / 3;
                    count[i] += 1;
                }
            }
            light_.row(c) = sum.cwiseQuotient(count).transpose();
        }
}

V3 PosedHead::eye_colour(const Ray& ray, const V3& at, int index, double& inside) const {
    const auto e = static_cast<std::size_t>(index);
    const Eyeball& eye = model_.eyes[e];
    const EyeLook& look = model_.look;
    const std::uint64_t seed = look.seed + e;
    const V3 p = world_from_eye_[e].transpose() * (at - eye_centres_[e]);
    const V3 d = world_from_eye_[e].transpose() * ray.direction;
    inside = 0;
    // Visible part of the iris disc behind the cornea. Labels have it where it is; only an index
    // above 1 moves what is seen.
    const double plane = eye.iris_plane();
    double r = p.head<2>().norm() / eye.limbus_radius;
    V3 q = p;
    if (p.z() > plane && corneal_index_ != 1) {
        q = seen_on_iris(eye, p, d, corneal_index_);
        r = q.head<2>().norm() / eye.limbus_radius;
    } else if (p.z() > plane && d.z() < 0) {
        q = p + d * ((plane - p.z()) / d.z());
        r = q.head<2>().norm() / eye.limbus_radius;
    }
    const double turn = std::atan2(q.y(), q.x());
    const V3 veins(60 * p.x(), 60 * p.y(), 60 * p.z());
    const double vein =
        std::max(0.0, 1 - 9 * std::abs(noise(seed, 0.35 * veins) + 0.3 * noise(seed + 1, veins)));
    const double away = std::acos(std::clamp(p.z() / p.norm(), -1.0, 1.0));
    const double tired = smooth_step(0.45, 1.3, away);
    const V3 sclera =
        V3(0.70, 0.665, 0.635)
            .cwiseProduct(V3(1, 1 - 0.16 * tired - 0.10 * vein, 1 - 0.18 * tired - 0.10 * vein));
    if (r > 1.12 || p.z() < 0.5 * plane) return sclera;
    inside = smooth_step(1.0, 0.9, r);
    const double fibre =
        noise(seed + 2, V3(9 * std::cos(turn), 9 * std::sin(turn), 1.6 * r)) +
        0.6 * noise(seed + 3, V3(19 * std::cos(turn), 19 * std::sin(turn), 2.5 * r));
    V3 iris = look.iris * (1.25 + 0.9 * fibre);
    const double collar = smooth_step(0.68, 0.45, r + 0.05 * fibre);
    iris += (look.ring * (1.2 + 0.8 * fibre) - iris) * collar;
    iris *= 1 - 0.78 * smooth_step(0.78, 1.0, r);
    iris *= smooth_step(look.pupil_radius - 0.035, look.pupil_radius + 0.035, r);
    const double rim = smooth_step(0.95, 1.10, r);
    return iris.cwiseMax(0.003) + (sclera - iris) * rim;
}

V3 PosedHead::shade(const Ray& ray, const Hit& hit) const {
    const auto f = static_cast<std::size_t>(hit.face);
    const Face& face = faces_[f];
    const double w = 1 - hit.u - hit.v;
    const auto blend = [&](const auto& columns) {
        return (w * columns.col(face[0]) + hit.u * columns.col(face[1]) +
                hit.v * columns.col(face[2]))
            .eval();
    };
    const V3 flat =
        area_vector<double>(vertices_.col(face[0]), vertices_.col(face[1]), vertices_.col(face[2]));
    const bool back = flat.dot(ray.direction) > 0;
    V3 n = blend(normals_);
    n /= std::max(n.norm(), 1e-12);
    const VecX<double> light = blend(light_);
    // In the lights' frame.
    const V3 along = world_from_lights_.transpose() * ray.direction,
             normal = world_from_lights_.transpose() * n;
    const V3 fallen = (light.head<3>() + bounced) / std::numbers::pi;
    const V3 half_grey(0.10, 0.045, 0.035);
    V3 colour;
    const Part part = parts_[f];
    if (part == Part::eyeball_left || part == Part::eyeball_right) {
        double inside = 0;
        const V3 at = ray.origin + hit.t * ray.direction;
        const V3 albedo = eye_colour(ray, at, part == Part::eyeball_left ? 0 : 1, inside);
        colour = albedo.cwiseProduct(fallen);
        // Reflection of the softboxes on the wet surface, where the lids do not hide them.
        const V3 reflected = along - 2 * normal.dot(along) * normal;
        const double grazing = power(1 - std::clamp(-n.dot(ray.direction), 0.0, 1.0), 5);
        const double reflects = mirror_share + 0.6 * grazing;
        for (std::size_t b = 0; b < softboxes_.size(); ++b) {
            const Softbox& s = softboxes_[b];
            colour += s.radiance * (reflects * light[3 + static_cast<Index>(b)] *
                                    mirrored(s, reflected) * std::lerp(0.35, 1.0, inside));
        }
        return colour;
    }
    if (back && part == Part::skin) return half_grey * 0.12;
    Vec4<double> skin;
    switch (part) {
        case Part::skin: {
            const Face& u = model_.face_uv[f];
            const Vec2<double> uv =
                w * model_.uv.col(u[0]) + hit.u * model_.uv.col(u[1]) + hit.v * model_.uv.col(u[2]);
            skin = sampled(model_.albedo, uv);
            break;
        }
        case Part::tooth:
            skin << 0.62, 0.57, 0.48, 0.8;
            break;
        case Part::eye_corner:
            skin << 0.52, 0.26, 0.22, 0.8;
            break;
        case Part::lash:
            skin << 0.035, 0.024, 0.020, 0.1;
            break;
        default:
            skin << 0.24, 0.055, 0.05, 0.6;
            break;
    }
    colour = skin.head<3>().cwiseProduct(fallen);
    // Specular skin: a broad and a narrow lobe about each softbox's centre.
    for (std::size_t b = 0; b < softboxes_.size(); ++b) {
        const Softbox& s = softboxes_[b];
        const V3 middle = normalized(V3(s.to - along));
        const double nh = std::max(0.0, normal.dot(middle)), nl = std::max(0.0, normal.dot(s.to));
        const double lobe = 0.7 * power(nh, 12) * 20 / 25 + 0.3 * power(nh, 50) * 58 / 25;
        const double fresnel =
            0.035 + 0.5 * power(1 - std::max(0.0, -middle.dot(along)), 5);
        const double solid = 4 * s.half_size * s.half_size;
        colour += s.radiance *
                  (solid * nl * lobe * fresnel * skin[3] * 1.4 * light[3 + static_cast<Index>(b)]);
    }
    return colour;
}

HeadPicture PosedHead::picture(const Pinhole<double>& camera, int samples) const {
    RYE_ASSERT(model_.albedo.size() > 0, "PosedHead: the model has no albedo image");
    const int width = camera.width, height = camera.height;
    HeadPicture out{Image<float>(width, height, 3), Image<float>(width, height, 1), {}};
    out.eye.assign(static_cast<std::size_t>(out.mask.size()), 0);
    const V3 from = camera.centre();
    const std::vector<Vec2<double>> at_samples = places_in_pixel(samples);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            V3 sum = V3::Zero();
            int covered = 0;
            for (int first = 0; first < samples; first += 4) {
                RayBundle bundle{from, {}};
                for (int k = 0; k < 4; ++k) {
                    const int s = std::min(first + k, samples - 1);
                    bundle.directions[static_cast<std::size_t>(k)] =
                        camera.ray(Vec2<double>(x, y) + at_samples[static_cast<std::size_t>(s)]);
                }
                const std::array<Hit, 4> hits = caster_.nearest(bundle);
                for (int k = 0; k < std::min(4, samples - first); ++k) {
                    const Hit& hit = hits[static_cast<std::size_t>(k)];
                    if (!hit) continue;
                    ++covered;
                    const V3 colour =
                        exposure *
                        shade({from, bundle.directions[static_cast<std::size_t>(k)]}, hit);
                    for (int c = 0; c < 3; ++c) sum[c] += srgb(shoulder(std::max(0.0, colour[c])));
                }
            }
            const Index at = static_cast<Index>(y) * width + x;
            for (int c = 0; c < 3; ++c)
                out.image.pixels(c, at) = static_cast<float>(sum[c] / samples);
            out.mask.pixels(0, at) = static_cast<float>(covered) / static_cast<float>(samples);
        }
    // Eye labels, only where an eyeball can be.
    for (std::size_t e = 0; e < 2; ++e) {
        const V3 c = camera.project_point(eye_centres_[e]);
        const double reach = 1.3 * model_.eyes[e].radius * camera.fx / c.z() + 1;
        const auto first = [](double v) { return std::max(0, static_cast<int>(v)); };
        const int x1 = std::min(width, first(c.x() + reach)),
                  y1 = std::min(height, first(c.y() + reach));
        for (int y = first(c.y() - reach); y < y1; ++y)
            for (int x = first(c.x() - reach); x < x1; ++x) {
                const Hit hit = caster_.nearest(Ray{from, camera.ray({x + 0.5, y + 0.5})});
                if (!hit) continue;
                const Part part = parts_[static_cast<std::size_t>(hit.face)];
                const auto at = static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                                static_cast<std::size_t>(x);
                if (part == Part::eyeball_left) out.eye[at] = 1;
                if (part == Part::eyeball_right) out.eye[at] = 2;
            }
    }
    return out;
}

} // namespace rye::trainer
