// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/head_render.hpp: images of a posed head by ray casting.
/// The irradiance at each vertex (a sky and softboxes, with shadows) does not depend on the
/// view and is computed once per pose; images then cast primary rays only. Deterministic: the same
/// pose and camera give the same image on any number of threads. World and camera conventions of
/// rye; output colours are sRGB in [0, 1].
#pragma once

#include <array>
#include <vector>

#include <rye/geometry/camera.hpp>

#include "synthetic_capture/head_model.hpp"
#include "synthetic_capture/ray_caster.hpp"

namespace rye::trainer {

/// A square light at infinity.
struct Softbox {
    Vec3<double> to, right, up; ///< unit vectors, lights' frame
    double half_size;           ///< of its edge [rad]
    Vec3<double> radiance;      ///< linear R, G, B
    int edge = 4;               ///< rays of light along its edge
};
/// The lights that a capture has by itself: a bright one and a dim one on the other side.
const std::vector<Softbox>& usual_softboxes();
/// Returns a light in a direction of any length, whose highlight on a dark iris adds `intensity`
/// (sRGB, 0 to most_highlight) and is as wide as a lobe of `width` [rad, at most most_light_width]
/// (rye/rig/cornea.hpp).
Softbox softbox_of(const Vec3<double>& to, double width, const Vec3<double>& intensity);
inline constexpr double most_highlight = 0.7, most_light_width = 0.8;

/// State of a head in one frame.
struct HeadState {
    VecX<double> expression;             ///< weights in [0, 1]
    VecX<double> lids;                   ///< lid_coefficients of the gaze
    std::array<Vec3<double>, 2> optical; ///< unit optical axes, head frame
    /// Displacements of the eyeballs, which carry their lids along, head frame.
    std::array<Vec3<double>, 2> eye_offset{Vec3<double>::Zero(), Vec3<double>::Zero()};
    Rigid<double> world_from_head = {};
    /// Turn of the lights, which are at infinity.
    Mat3<double> world_from_lights = Mat3<double>::Identity();
    std::vector<Softbox> softboxes = usual_softboxes();
    /// Refractive index behind the corneas; 1: irises are seen where they are.
    double corneal_index = 1;
};

/// An image premultiplied over black: composite with image + (1 - mask) * background, in sRGB.
struct HeadPicture {
    Image<float> image;            ///< 3 channels, sRGB
    Image<float> mask;             ///< coverage of each pixel by the head
    std::vector<std::uint8_t> eye; ///< 0 none, 1 left, 2 right eyeball at the pixel's centre
};

class PosedHead {
  public:
    PosedHead(const HeadModel& model, const HeadState& state);

    /// `samples` rays a pixel.
    HeadPicture picture(const Pinhole<double>& camera, int samples) const;

    const Points& vertices() const { return vertices_; } ///< world; the model's, then the eyeballs'
    std::array<Vec3<double>, 2> eye_centres() const { return eye_centres_; } ///< world

  private:
    void add_eyeball(const Eyeball& eye, const HeadState& state, int index);
    void find_normals();
    void gather_light();
    Vec3<double> shade(const Ray& ray, const Hit& hit) const;
    Vec3<double> eye_colour(const Ray& ray, const Vec3<double>& at, int eye, double& cover) const;

    const HeadModel& model_;
    Mat3<double> world_from_lights_;
    std::vector<Softbox> softboxes_;
    double corneal_index_;
    Points vertices_, normals_;
    std::vector<Face> faces_;
    std::vector<Part> parts_;
    RayCaster caster_;
    Columns<double> light_; // (3 + boxes) x V: irradiance RGB, visible part of each softbox
    std::array<Vec3<double>, 2> eye_centres_;
    std::array<Mat3<double>, 2> world_from_eye_;
};

} // namespace rye::trainer
