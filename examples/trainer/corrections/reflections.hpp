// SPDX-License-Identifier: Apache-2.0
/// corrections/reflections.hpp: what the corneas in pictures mirror. Each pixel over an iris
/// mirrors a direction of the world. Its colour less what the same part of the iris has in other
/// pictures, averaged over the pixels that mirror the same direction, is a map of the surroundings,
/// on which lights stand out. The iris lies behind the cornea, so that a camera from aside sees
/// another part of it beside a highlight. Frames: directions in the world, unit vectors.
#pragma once

#include <functional>
#include <vector>

#include <nlohmann/json.hpp>

#include <rye/core/columns.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/rig/cornea.hpp>
#include <rye/rig/eye_transform.hpp>

namespace rye::trainer {

/// A cornea before a camera.
struct CorneaInPicture {
    Pinhole<double> camera;
    EyeTransform<double> eye; ///< to the world
    Cornea<double> cornea;    ///< in the eyeball's frame
    double limbus_radius;     ///< of the iris, eyeball's frame
    double iris_plane;        ///< z of its plane, eyeball's frame
};

/// A pixel over an iris.
struct MirroredPixel {
    Vec3<float> to; ///< direction that the cornea mirrors there
    Vec3<float> colour;
    Vec2<float> iris; ///< place where the ray meets the iris' plane, in parts of the limbus' radius
    int eye;          ///< 0: the subject's left
    int picture;      ///< number of the picture of an eye
    int x = 0, y = 0; ///< column and row in the picture
    float iris_radius = 1; ///< of the iris in the picture [px]
};

/// Appends the pixels of an eye's iris in a picture. `area`, 1 x pixels: above 0.5 where the
/// picture shows that eye.
void add_mirrored_pixels(const Image<float>& picture, const Columns<float>& area,
                         const CorneaInPicture& of, int eye, int number,
                         std::vector<MirroredPixel>& all);

/// Subtracts what pixels have without what they mirror. A small part of an iris has one colour, the
/// median over pictures; a picture shows all of them times a gain, which changes linearly over the
/// iris, plus an offset: its light and the lids' shadow. These are by least squares in which bright
/// spots weigh little.
void subtract_own_colours(std::vector<MirroredPixel>& pixels);

/// The light that is mirrored from a small part of all directions.
struct ReflectedPart {
    Vec3<double> to;     ///< mean direction of its pixels
    Vec3<double> colour; ///< mean of their colours, less what their parts of the iris have
    int pixels;
};

/// Colour that is known to come from a direction.
using KnownLight = std::function<Vec3<float>(const Vec3<float>& to)>;

/// Returns the parts that pixels mirror, of `side` degrees of pitch and yaw, those with fewer than
/// `least` pixels left out. What an iris has by itself is the median of what `known` leaves.
std::vector<ReflectedPart> reflected_parts(std::vector<MirroredPixel> pixels, double side,
                                           int least, const KnownLight& known = {});

/// Reflections in photographs and renders of the same views.
struct Reflections {
    std::vector<MirroredPixel> photograph, render;
    int pictures = 0; ///< of an eye

    void add(const Reflections& r);
    /// Returns the correlation of both maps over directions, the standard deviation of each
    /// [colour], and the number of directions; nulls where too few pixels show an iris.
    nlohmann::ordered_json json() const;
};

} // namespace rye::trainer
