// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/scene.hpp: contents of a synthetic capture: cameras around a head, and head
/// pose, gaze and expression in each frame.
/// World, head and camera conventions of rye; angles of gaze are (yaw, pitch), yaw + towards the
/// subject's left, pitch + up.
/// Source: the camera rig imitates that of ETH-XGaze (Zhang et al., 2020).
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include <rye/core/random.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/rig/cornea.hpp>

#include "synthetic_capture/head_render.hpp"

namespace rye::trainer {

struct CaptureSettings {
    int size = 256;             ///< edge of the images [px], even
    int cameras = 18;           ///< 1 to 18
    int train_frames = 24;      ///< the first is neutral and looks straight ahead
    int novel_frames = 6;       ///< tests with gazes outside those of training
    int independent_frames = 2; ///< tests with independent gazes of both eyes
    /// Targets of further test frames, (yaw, pitch) [deg], by the head at rest.
    std::vector<Vec2<double>> gazes = {};
    int samples = 4;            ///< rays a pixel
    std::uint64_t seed = 1;     ///< of the subject and of all frames
    /// Bound of the distance by which expression and head pose displace an eyeball in the head [mm],
    /// where a unit is 100 mm; 0: eyeballs only rotate.
    double eye_translation_mm = 0;
    bool png = false;           ///< images are written as PNG, else as JPEG
    std::optional<std::vector<Softbox>> softboxes = {}; ///< instead of usual_softboxes()
    bool refraction = false; ///< irises are seen through corneas of detail::corneal_index
    /// Refractive index behind the corneas, 1 without refraction.
    double corneal_index() const { return refraction ? detail::corneal_index : 1; }
};

/// A camera of the rig.
struct SceneCamera {
    std::string id;
    double yaw_deg = 0, pitch_deg = 0, distance = 0; ///< of its position, from the head's middle
    Pinhole<double> camera;
};

/// A rectangle of directions.
struct GazeCell {
    Vec2<double> yaw_deg, pitch_deg; ///< from, to
    bool contains(const Vec2<double>& deg) const {
        return deg.x() >= yaw_deg[0] && deg.x() <= yaw_deg[1] && deg.y() >= pitch_deg[0] &&
               deg.y() <= pitch_deg[1];
    }
};

enum class FrameKind { train, novel, independent };

struct SceneFrame {
    std::string id;
    FrameKind kind = FrameKind::train;
    Vec<double, 6> pose = Vec<double, 6>::Zero(); ///< axis-angle [rad], translation
    HeadState state;
    std::optional<Vec2<double>> fixation_deg; ///< of the target, from between the eyes
    std::optional<Vec3<double>> target;       ///< world
    std::array<Vec3<double>, 2> visual;       ///< unit, head frame
    std::array<Vec2<double>, 2> optical_deg;
};

struct CaptureScene {
    CaptureSettings settings;
    std::vector<SceneCamera> cameras;
    std::vector<SceneFrame> frames;
    std::array<Vec2<double>, 2> kappa_deg; ///< optical - visual, of left and right eye
    std::vector<GazeCell> held_out;        ///< fixations that no training frame has
};

/// Units of the head frame in a millimetre.
inline constexpr double unit_per_mm = 0.01;

/// The centre of the rig.
inline const Vec3<double> head_centre(0, 0.32, 0.25);

CaptureScene capture_scene(const HeadModel& model, const CaptureSettings& settings);

/// Returns random weights for a few expressions, nearly equal for left and right.
VecX<double> random_expression(const std::vector<std::string>& names, const Random& r);

/// Turns the eyes of a frame towards a target in the head frame, with the lids that follow them.
void look_at_target(SceneFrame& f, const HeadModel& model, const CaptureScene& scene,
                    const Vec3<double>& target);

/// Turns the eyes of a frame towards its fixation.
void place_eyes(SceneFrame& f, const HeadModel& model, const CaptureScene& scene);

/// Renders every view and writes the capture to a new folder `out`, which appears when complete.
/// Calls progress(done, of) after each frame.
void write_capture(const HeadModel& model, const CaptureScene& scene,
                   const std::filesystem::path& out, const std::function<void(int, int)>& progress);

} // namespace rye::trainer
