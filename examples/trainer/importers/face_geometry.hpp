// SPDX-License-Identifier: Apache-2.0
/// importers/face_geometry.hpp: geometry for importers, from points and meshes: spheres,
/// points from rays, eye masks and silhouettes. Points are columns, world units; pixel
/// centres +0.5. Eye 0 is the subject's left.
#pragma once

#include <cstdint>
#include <vector>

#include <rye/geometry/camera.hpp>
#include <rye/geometry/distortion.hpp>
#include <rye/geometry/mesh.hpp>

#include "data/fit_rigid.hpp"
#include "data/picture.hpp"

namespace rye::trainer {

/// Returns the value of the left or right eyeball in an eye mask.
inline constexpr std::uint8_t eye_mask_value(int eye) { return eye == 0 ? 85 : 170; }

struct Sphere {
    Vec3<double> centre;
    double radius;
    double error; ///< root mean square distance of the points from the surface
};

/// Returns the sphere nearest to at least 4 points, by linear least squares on |x|^2 = 2 c.x +
/// const.
Sphere fit_sphere(const Columns<double>& points);

/// Point nearest to lines through `origins` along unit `directions`, both 3 x N, N >= 2.
struct NearestPoint {
    Vec3<double> point;
    double error; ///< root mean square distance from the lines
};
NearestPoint nearest_to_lines(const Columns<double>& origins, const Columns<double>& directions);

/// Triangle mesh with a label per face.
struct LabelledMesh {
    Columns<double> vertices; ///< 3 x V, world
    std::vector<Face> faces;
    std::vector<std::uint8_t> labels; ///< per face, not 255
};

/// Returns the label of the nearest face at each pixel's centre, 255 for none; 1 channel.
Image8 draw_labels(const LabelledMesh& mesh, const Pinhole<double>& camera);

/// Returns the eye masks from 66 or 68 landmarks: the polygons of the lids that face the camera and
/// are not hidden by the nose. 0 elsewhere.
Image8 lid_eye_mask(const Columns<double>& landmarks, const Pinhole<double>& camera);

/// Returns 255 inside the convex hull of image points (2 x N) [px], 0 outside.
Image8 hull_mask(const Columns<double>& points, ImageSize size);

/// Sets the pixels of an eye mask to 0 where the subject's mask is below half.
void clip_to_mask(Image8& eyes, const Image8& mask);

/// Image as a pinhole with the same intrinsics sees it, and a mask of its pixels: 255, or 0 for
/// none.
struct Straightened {
    Image8 picture, visible;
};
Straightened straightened(const Image8& picture, const Pinhole<double>& camera,
                          const BrownConrady<double>& lens);

/// Returns an image with all pixels of one value.
Image8 plain_image(int width, int height, std::uint8_t value);

} // namespace rye::trainer
