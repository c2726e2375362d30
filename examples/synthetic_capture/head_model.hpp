// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/head_model.hpp: a head that can be posed and textured, from any source.
/// Head frame: x subject's left, y up, z out of the face; 1 unit is about 1 dm, nasion to chin 1.1.
/// Eye 0 is the subject's left (x > 0), eye 1 the right. Colours are linear RGB.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/geometry/mesh.hpp>

namespace rye::trainer {

/// Points or directions in space, one column each.
using Points = Eigen::Matrix<double, 3, Eigen::Dynamic>;

/// A rigid eyeball: a sphere (sclera), cut at the limbus, with a bulging cornea. The iris is the
/// flat disc inside the rim of the limbus.
struct Eyeball {
    Vec3<double> centre = Vec3<double>::Zero(); ///< of rotation, head frame
    double radius = 0.15;                       ///< of the sclera
    double limbus_radius = 0.061;               ///< of the rim between sclera and cornea
    double cornea_radius = 0.088;               ///< of curvature

    /// Distance of the iris' plane from the centre, along the optical axis.
    double iris_plane() const;
    /// Distance of the surface from the centre at an angle [rad] from the optical axis.
    double surface(double angle) const;
};

/// The eyeball's surface about the origin, looking along +z, densest at the front.
struct EyeballMesh {
    Points vertices;
    std::vector<Face> faces;
};
EyeballMesh eyeball_mesh(const Eyeball& eye);

/// Material of a face of the mesh.
enum class Part : std::uint8_t {
    skin,
    mouth,
    tooth,
    eye_corner,
    lash,
    eyeball_left,
    eyeball_right
};

/// Names of the lid coefficients, which follow the gaze and are not part of the expression.
inline const std::vector<std::string> lid_names{"eyeLookUp_L",   "eyeLookUp_R", "eyeLookDown_L",
                                                "eyeLookDown_R", "eyeLookIn_L", "eyeLookIn_R",
                                                "eyeLookOut_L",  "eyeLookOut_R"};

/// Lid coefficients in [0, 1] (8) for the optical axes (yaw, pitch) [deg] of left and right eye.
VecX<double> lid_coefficients(const std::array<Vec2<double>, 2>& optical_deg);

struct EyeLook {
    Vec3<double> iris = {0.10, 0.16, 0.22}; ///< of the fibres' middle
    Vec3<double> ring = {0.25, 0.20, 0.09}; ///< around the pupil
    double pupil_radius = 0.36;             ///< of the limbus radius
    std::uint64_t seed = 0;                 ///< of fibres and veins
};

/// A head: its deformation and the texture of its skin.
struct HeadModel {
    std::string origin;                        ///< source and licence
    std::vector<std::string> expression_names; ///< weights in [0, 1]
    std::vector<std::string> identity_names;
    VecX<double> identity;             ///< of this subject
    std::vector<Face> faces;           ///< without the eyeballs
    std::vector<Part> parts;           ///< of each face
    Columns<double> uv;                ///< 2 x U, in [0, 1], of the albedo image
    std::vector<Face> face_uv;         ///< columns of uv at the corners of each face
    Image<float> albedo;               ///< linear RGB and gloss [1] of Part::skin
    std::array<Index, 68> landmarks{}; ///< vertices, in the order of iBUG
    std::vector<Index> dense;          ///< vertices of the narrow face area
    std::array<Eyeball, 2> eyes;
    EyeLook look;
    /// In the head frame, for expression weights and lid coefficients.
    std::function<Points(const VecX<double>&, const VecX<double>&)> vertices;
};

/// Moves vertices inside or on an eyeball out to `gap` above its surface, so that the lids follow
/// the corneal bulge; `gaze` are the unit optical axes in the frame of the vertices.
void clear_eyeballs(Points& vertices, const std::array<Eyeball, 2>& eyes,
                    const std::array<Vec3<double>, 2>& gaze, double gap);

/// Displaces an eyeball and the skin around it: all of the displacement up to the lids, none of it
/// from 2.4 radii from the centre on.
void displace_eye(Points& vertices, Eyeball& eye, const Vec3<double>& by);

/// Width of the procedural head's albedo image [px].
inline constexpr int albedo_width = 1024;
/// Returns the width for pictures of so many pixels a side: all of it from 128 on, below that as
/// many texels a pixel as pictures of 256 have, or more.
constexpr int albedo_width_for(int picture) {
    return picture < 128 ? std::max(256, 4 * picture) : albedo_width;
}
/// The procedural head, from the seed alone. Its albedo image is three quarters as high as wide;
/// a width of 0 leaves it empty, for shapes alone.
HeadModel procedural_head(std::uint64_t seed, int width = albedo_width);

/// The ICT face model (light, packed as an npz), or another in the same arrays
/// (makehuman_pack.hpp); the seed selects the identity and the skin.
HeadModel ict_head(const std::filesystem::path& path, std::uint64_t seed);

} // namespace rye::trainer
