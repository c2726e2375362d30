// SPDX-License-Identifier: Apache-2.0
/// corrections/cameras.hpp: detection and correction, before a training, of cameras whose pose or
/// focal length is wrong, by the eyes in their pictures, which are not at the position that labels
/// and camera give, and by the skin, which is not where other cameras show it. Cameras that are
/// right to within the bound keep their bits. The result is the position of the head in a camera's
/// pictures: a rotation and a shift with the same effect share it. Source:
/// corrections/camera_fit.hpp, corrections/skin_positions.hpp; docs/refine.md.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "data/capture.hpp"
#include "data/config.hpp"

namespace rye::trainer {

/// Finding about one camera.
struct CameraFinding {
    std::string camera;
    int irises = 0;       ///< number found in its pictures
    double off = 0;       ///< displacement of the head's landmarks, RMS over frames [mm]
    double pixels = 0;    ///< displacement in its pictures [px]
    bool wrong = false;   ///< true above the bound: corrected
    bool by_skin = false; ///< true if too few irises are seen, and the skin is compared alone
    double before = 0;    ///< median distance of irises or skin from where they should be [px]
    double after = 0;     ///< the same for the corrected camera [px]
    double turn = 0;      ///< rotation of the correction [deg]
    double shift = 0;     ///< motion of its centre by the correction [mm]
    double focal = 0;     ///< change of its focal lengths by the correction [%]
};

/// Findings about all cameras.
struct CameraFindings {
    std::vector<CameraFinding> all;
    double bound = 0;                    ///< bound on CameraFinding::off [mm]
    std::vector<std::string> not_judged; ///< sentences: cameras, and the reasons

    bool empty() const { return all.empty() && not_judged.empty(); }
    std::vector<std::string> lines() const;
    nlohmann::ordered_json json() const;
};

/// Judges the cameras of a capture with gazes by its training frames. Corrects wrong ones in all of
/// its frames in which they have the same numbers. Deterministic: the same capture gives the same
/// bits.
CameraFindings correct_cameras(Capture& capture, const TrainConfig& config);

/// Switches on the correction of all cameras' poses in stage 2 (gaussians.rates.delta_view) if
/// cameras were wrong, unless the configuration has it already. Returns a sentence that
/// says so, or nothing.
std::string refine_further(const CameraFindings& findings, const Capture& capture,
                           TrainConfig& config);

/// Returns the capture's corrected cameras after a training's further corrections (6 x cameras, or
/// empty; TwoStream::delta_view): those of all cameras, whose `wrong` numbers are the capture's
/// own.
std::vector<CorrectedCamera> trained_cameras(const Capture& capture,
                                             const Columns<float>& delta_view);

} // namespace rye::trainer
