// SPDX-License-Identifier: Apache-2.0
/// rye/rig/eyeball.hpp: the eyeball's surface: a sphere with a corneal bulge, as rings of points,
/// denser inside the limbus. Frame: origin at the eyeball's centre, iris toward +z, y up.
/// Lengths in canonical head units, 1 unit = 1 dm. Source: the radii of Gullstrand's schematic
/// eye; the idea of a dense iris from 3DGazeNet's template (Ververas et al., 2024).
///
/// Surface that carries the iris' colour: one sees the iris plane through the cornea, but splatted
/// Gaussians are opaque and do not refract. There are two choices: the bulge itself (the paper's
/// mesh, correct in profile), or with `iris_plane` the iris behind it (correct in parallax), which
/// the effect CornealRefraction (rig/cornea.hpp) displaces to its apparent position.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <limits>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/geometry/mesh.hpp>
#include <rye/math/linalg.hpp>
#include <rye/rig/effect_slots.hpp>

namespace rye {

/// Dimensions of an eyeball; a sphere without the cornea's members if CornealBulge is off.
template <EffectSet E>
struct BasicEyeballShape {
    using CorneaSlot = detail::Slot<E, CornealBulge, double>;
    using CorneaSlot2 = detail::Slot<E, CornealBulge, double, 1>;
    static constexpr bool bulges = has_effect<E, CornealBulge>;

    double sclera_radius = 0.12;      ///< radius of the sphere [unit]
    /// Radius of the corneal sphere [unit].
    [[no_unique_address]] CorneaSlot cornea_radius = detail::initial_slot<CorneaSlot>(0.078);
    /// Distance from the eyeball's centre to the cornea's [unit].
    [[no_unique_address]] CorneaSlot2 cornea_offset = detail::initial_slot<CorneaSlot2>(0.056);
    double limbus_radius = 0.059;     ///< rim of the iris, from the axis [unit]
    double pupil_radius = 0.020;      ///< from the axis [unit]
    /// z of the middle of the iris, which curves from there to the limbus [unit]; if empty, the
    /// iris lies on the bulge.
    std::optional<double> iris_plane = {};

    int iris_rings = 16;              ///< from the axis to the limbus, inclusive
    int sclera_rings = 12;            ///< from the limbus to the equator, inclusive
    int back_rings = 10;              ///< behind the equator, without the pole

    /// Returns the eye scaled to another radius, all lengths in proportion.
    BasicEyeballShape with_radius(double radius) const {
        BasicEyeballShape s = *this;
        const double k = radius / sclera_radius;
        for (double* x : {&s.sclera_radius, &s.limbus_radius, &s.pupil_radius}) *x *= k;
        if constexpr (bulges) {
            s.cornea_radius *= k;
            s.cornea_offset *= k;
        }
        if (s.iris_plane) *s.iris_plane *= k;
        return s;
    }

    /// Returns the eye with another limbus radius; pupil and cornea in proportion, the bulge
    /// starting from the sphere at the limbus.
    BasicEyeballShape with_limbus(double radius) const {
        BasicEyeballShape s = *this;
        const double k = radius / limbus_radius;
        for (double* x : {&s.limbus_radius, &s.pupil_radius}) *x *= k;
        if constexpr (bulges) {
            s.cornea_radius *= k;
            s.cornea_offset =
                std::sqrt(std::max(0., sclera_radius * sclera_radius - radius * radius)) -
                std::sqrt(std::max(0., s.cornea_radius * s.cornea_radius - radius * radius));
        }
        return s;
    }

    /// Returns z of the iris behind the cornea at a distance r from the axis, r <= limbus_radius: a
    /// paraboloid through the middle of the iris and the limbus.
    double iris(double r) const {
        if (!iris_plane) return front(r);
        const double share = r / limbus_radius;
        return *iris_plane + (limbus_plane() - *iris_plane) * share * share;
    }

    /// Returns z of the front surface at a distance r from the axis, r <= limbus_radius: the outer
    /// one of sphere and cornea.
    double front(double r) const {
        const double sphere = std::sqrt(std::max(0., sclera_radius * sclera_radius - r * r));
        if constexpr (bulges) {
            const double inside = cornea_radius * cornea_radius - r * r;
            return inside < 0 ? sphere : std::max(sphere, cornea_offset + std::sqrt(inside));
        }
        return sphere;
    }

    /// Returns the distance of the front surface from the eyeball's centre at an angle from +z.
    double outermost(double angle) const {
        if constexpr (bulges) {
            const double side = cornea_offset * std::sin(angle);
            const double inside = cornea_radius * cornea_radius - side * side;
            const double cornea =
                inside < 0 ? 0 : cornea_offset * std::cos(angle) + std::sqrt(inside);
            return std::max(sclera_radius, cornea);
        }
        return sclera_radius;
    }

    /// Returns z of the limbus, where the iris meets the surface: the plane of a flat iris.
    double limbus_plane() const { return front(limbus_radius); }

    /// Returns the eye with its iris as a disc through the limbus.
    BasicEyeballShape with_flat_iris() const {
        BasicEyeballShape s = *this;
        s.iris_plane = limbus_plane();
        return s;
    }
};

/// The eyeball of the paper's effects.
using EyeballShape = BasicEyeballShape<PaperEffects>;

/// Part of the eyeball that a point lies on.
enum class EyeLabel : std::uint8_t { pupil, iris, sclera, back };

/// P points on the surface of an eyeball in its own frame. An avatar reads points, spacing and
/// normals; the others are for drawing it as a mesh and for gaze_from_mesh, and may be empty.
template <Real T>
struct EyeballTemplate {
    Columns<T> points;                         ///< 3 x P [unit]
    Columns<T> spacing;                        ///< 1 x P, RMS distance to 3 nearest points [unit]
    Columns<T> normals;                        ///< 3 x P, unit, outward
    std::vector<EyeLabel> labels;              ///< P
    std::vector<std::array<Index, 3>> faces;   ///< closed surface, normals outward
    std::array<Index, 8> iris8{};              ///< on the limbus, from +x toward +y
    std::vector<Index> equator;                ///< the ring z = 0; its mean is the centre
};

namespace detail {

template <EffectSet E>
void check_shape(const BasicEyeballShape<E>& s) {
    const double r = s.sclera_radius;
    double cornea_radius = r, cornea_offset = 0;  // of a sphere, without a cornea
    copy_slot(s.cornea_radius, cornea_radius);
    copy_slot(s.cornea_offset, cornea_offset);
    const bool sizes = r > 0 && r < 1e6 && cornea_radius > 0 && cornea_offset >= 0 &&
                       s.pupil_radius > 0 && s.pupil_radius < s.limbus_radius &&
                       s.limbus_radius < cornea_radius && s.limbus_radius < r &&
                       cornea_offset < r;
    require(sizes, "eyeball_template", "radii (sclera, cornea, limbus, pupil) = (", r, ", ",
            cornea_radius, ", ", s.limbus_radius, ", ", s.pupil_radius, ") and cornea offset ",
            cornea_offset,
            " violate 0 < pupil < limbus < cornea, limbus < sclera, 0 <= offset < sclera");
    require(s.iris_rings >= 2 && s.sclera_rings >= 1 && s.back_rings >= 1 &&
                s.iris_rings + s.sclera_rings + s.back_rings <= 1000,
            "eyeball_template", "got ", s.iris_rings, ", ", s.sclera_rings, ", ", s.back_rings,
            " rings, expected at least 2, 1, 1, at most 1000");
    require(!s.iris_plane || (*s.iris_plane > 0 && *s.iris_plane <= s.front(0)), "eyeball_template",
            "iris plane at z = ", s.iris_plane.value_or(0), ", expected above 0 and at most ",
            s.front(0), ", the cornea's front");
}

/// Triangulates the band between two rings with first points a, b and sizes n, m (a in front of b);
/// always advances on the ring whose next point has the smaller angle.
inline void join_rings(Index a, Index n, Index b, Index m,
                       std::vector<std::array<Index, 3>>& faces) {
    Index i = n == 1 ? 1 : 0, j = m == 1 ? 1 : 0;                        // a pole has no steps
    while (i < n || j < m) {
        const Index at_a = a + i % n, at_b = b + j % m;
        if (j == m || (i < n && (i + 1) * m <= (j + 1) * n))
            faces.push_back({at_a, at_b, a + ++i % n});
        else
            faces.push_back({at_a, at_b, b + ++j % m});
    }
}

/// Returns the RMS distance of each point to its three nearest neighbours, 1 x P.
template <Real T>
Columns<T> three_neighbour_spacing(const Columns<T>& points) {
    Columns<T> spacing(1, points.cols());
    for (Index i = 0; i < points.cols(); ++i) {
        std::array<T, 3> best;
        best.fill(std::numeric_limits<T>::infinity());
        for (Index k = 0; k < points.cols(); ++k) {
            const T d = (points.col(k) - points.col(i)).squaredNorm();
            if (k == i || d >= best[2]) continue;
            best[2] = d;
            if (best[2] < best[1]) std::swap(best[2], best[1]);
            if (best[1] < best[0]) std::swap(best[1], best[0]);
        }
        spacing(0, i) = std::sqrt((best[0] + best[1] + best[2]) / T(3));
    }
    return spacing;
}

/// Returns vertex normals: area-weighted means of the adjacent faces' normals, 3 x P.
template <Real T>
Columns<T> vertex_normals(const Columns<T>& points,
                          const std::vector<Face>& faces) {
    Columns<T> normals = Columns<T>::Zero(3, points.cols());
    for (const auto& f : faces) {
        const Vec3<T> area = area_vector<T>(points.col(f[0]), points.col(f[1]), points.col(f[2]));
        for (const Index i : f) normals.col(i) += area;
    }
    return normals.colwise().normalized();
}

} // namespace detail

/// Returns the template of a shape: a point on the axis, rings from front to back, the back pole. A
/// ring has a multiple of 8 points, about as far apart as the rings.
template <Real T, EffectSet E = PaperEffects>
EyeballTemplate<T> eyeball_template(const BasicEyeballShape<E>& shape) {
    detail::check_shape(shape);
    using std::numbers::pi;
    struct Ring {
        double radius, z, step;
        EyeLabel label;
    };
    std::vector<Ring> rings;
    const double iris_step = shape.limbus_radius / shape.iris_rings;
    for (int k = 1; k <= shape.iris_rings; ++k) {
        const double r = shape.limbus_radius * k / shape.iris_rings;
        rings.push_back({r, k < shape.iris_rings ? shape.iris(r) : shape.limbus_plane(), iris_step,
                         r <= shape.pupil_radius ? EyeLabel::pupil : EyeLabel::iris});
    }
    // Along the outer one of sphere and cornea to the equator, by the angle from +z.
    const double limbus = std::atan2(shape.limbus_radius, shape.limbus_plane());
    for (int k = 1; k <= shape.sclera_rings; ++k) {
        const double angle = limbus + (pi / 2 - limbus) * k / shape.sclera_rings;
        const double out = shape.outermost(angle);
        rings.push_back({out * std::sin(angle), k == shape.sclera_rings ? 0 : out * std::cos(angle),
                         shape.sclera_radius * (pi / 2 - limbus) / shape.sclera_rings,
                         EyeLabel::sclera});
    }
    for (int k = 1; k <= shape.back_rings; ++k) {
        const double angle = pi / 2 * (1 + double(k) / (shape.back_rings + 1));
        const double r = shape.sclera_radius;
        rings.push_back({r * std::sin(angle), r * std::cos(angle),
                         r * pi / 2 / (shape.back_rings + 1), EyeLabel::back});
    }

    EyeballTemplate<T> eye;
    std::vector<Vec3<T>> points;
    const auto add = [&](double x, double y, double z, EyeLabel label) {
        points.emplace_back(static_cast<T>(x), static_cast<T>(y), static_cast<T>(z));
        eye.labels.push_back(label);
    };
    add(0, 0, shape.iris(0), EyeLabel::pupil);
    Index previous = 0, previous_size = 1;
    for (std::size_t r = 0; r < rings.size(); ++r) {
        const Ring& ring = rings[r];
        const Index size =
            8 * std::max<Index>(1, Index(std::llround(2 * pi * ring.radius / ring.step / 8)));
        const auto first = static_cast<Index>(points.size());
        for (Index i = 0; i < size; ++i) {
            const double angle = 2 * pi * double(i) / double(size);
            add(ring.radius * std::cos(angle), ring.radius * std::sin(angle), ring.z, ring.label);
        }
        detail::join_rings(previous, previous_size, first, size, eye.faces);
        if (static_cast<int>(r) + 1 == shape.iris_rings)
            for (Index i = 0; i < 8; ++i)
                eye.iris8[static_cast<std::size_t>(i)] = first + i * size / 8;
        if (static_cast<int>(r) + 1 == shape.iris_rings + shape.sclera_rings)
            for (Index i = 0; i < size; ++i) eye.equator.push_back(first + i);
        previous = first;
        previous_size = size;
    }
    const auto pole = static_cast<Index>(points.size());
    add(0, 0, -shape.sclera_radius, EyeLabel::back);
    detail::join_rings(previous, previous_size, pole, 1, eye.faces);

    eye.points.resize(3, static_cast<Index>(points.size()));
    for (std::size_t i = 0; i < points.size(); ++i)
        eye.points.col(static_cast<Index>(i)).template head<3>() = points[i];
    eye.spacing = detail::three_neighbour_spacing(eye.points);
    eye.normals = detail::vertex_normals(eye.points, eye.faces);
    return eye;
}

/// A shape from which eyeball_template<T>, in rye or in the shape's own namespace, makes points.
/// AvatarInit::eyeball then holds two of them, for example MyEyeball{subject.eye_radius[e]}.
template <class S>
concept EyeballSource = requires(const S& shape) {
    { eyeball_template<float>(shape) } -> std::same_as<EyeballTemplate<float>>;
};
static_assert(EyeballSource<BasicEyeballShape<PaperEffects>>);

/// Returns the gaze direction of an eyeball from its transformed points: from the mean of the
/// equator to the mean of the iris.
template <Real T>
Vec3<T> gaze_from_mesh(const EyeballTemplate<T>& eye, const Columns<T>& points) {
    Vec3<T> iris = Vec3<T>::Zero(), centre = Vec3<T>::Zero();
    for (const Index i : eye.iris8) iris += points.col(i);
    for (const Index i : eye.equator) centre += points.col(i);
    return normalized(Vec3<T>(iris / T(8) - centre / static_cast<T>(eye.equator.size())));
}

} // namespace rye
