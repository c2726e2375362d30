// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/ray_caster.hpp: nearest and any intersection of rays with a triangle soup.
/// Double precision throughout; results depend on mesh and ray alone.
/// Source: Wald, "On fast construction of SAH-based bounding volume hierarchies", 2007;
/// Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
#pragma once

#include <array>
#include <limits>
#include <vector>

#include <rye/geometry/mesh.hpp>

namespace rye::trainer {

struct Ray {
    Vec3<double> origin;
    Vec3<double> direction; ///< any length; t counts in it
    double t_min = 0;       ///< closer intersections are ignored
    double t_max = std::numeric_limits<double>::infinity();
};

/// Intersection of a ray with a face: origin + t direction = (1 - u - v) a + u b + v c.
struct Hit {
    Index face = -1; ///< -1: no intersection
    double t = std::numeric_limits<double>::infinity();
    double u = 0, v = 0;
    explicit operator bool() const { return face >= 0; }
};

/// Nearly parallel rays from one point, such as those through one pixel.
struct RayBundle {
    Vec3<double> origin;
    std::array<Vec3<double>, 4> directions;
};

/// A bounding volume hierarchy over the faces of a mesh, two-sided.
class RayCaster {
  public:
    RayCaster(const ColumnsView<double>& vertices, const std::vector<Face>& faces);

    /// The closest intersection.
    Hit nearest(const Ray& ray) const;
    /// The closest intersection of each ray; several times as fast as one by one.
    std::array<Hit, 4> nearest(const RayBundle& rays) const;
    /// True if the ray meets a triangle.
    bool meets(const Ray& ray) const;

  private:
    struct Node {
        Vec3<double> lower, upper;
        Index first = 0; // of a leaf: its first triangle; of a branch: its left child
        Index count = 0; // of a leaf: its triangles; 0: a branch, whose right child is first + 1
    };
    struct Triangle {
        Vec3<double> a, ab, ac;
        Index face = 0;
    };
    struct Split {
        int axis = -1; // -1: do not split
        double at = 0;
        double cost = 0;
    };
    struct Builder;

    template <bool any>
    Hit walk(const Ray& ray) const;

    std::vector<Node> nodes_;
    std::vector<Triangle> triangles_;
};

} // namespace rye::trainer
