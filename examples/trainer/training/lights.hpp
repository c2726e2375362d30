// SPDX-License-Identifier: Apache-2.0
/// training/lights.hpp: the lights of a capture, from the highlights (highlights.hpp) that its
/// photographs show on the corneas. Each highlight gives the direction that its cornea mirrors;
/// directions that many pictures share are lights. Their places, and the shape of the corneas, are
/// then fitted to where the highlights are, by least squares.
/// Frames: the world's; lengths in world units. Lights do not move with the head.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "data/samples.hpp"
#include "training/highlights.hpp"
#include "training/types.hpp"

namespace rye::trainer {

/// A light as a capture's photographs show it.
struct FoundLight {
    Vec3<double> position;  ///< world
    Vec3<double> intensity; ///< colour that its image adds at its middle
    double width;           ///< standard deviation of its image on the cornea [canonical unit]
    int seen = 0;           ///< pictures of an eye that show it
    int expected = 0;       ///< pictures of an eye that would
    double error_px = 0;    ///< distance of highlights from where it puts them, median [px]
};

/// Lights of a capture.
struct FoundLights {
    std::vector<FoundLight> lights;
    std::array<Cornea<double>, 2> corneas; ///< eyeball's frame, canonical units
    int eyes = 0;       ///< pictures of an eye that were looked at
    int highlights = 0; ///< highlights in them

    /// Returns a line for each light, or one that says that there are none.
    std::vector<std::string> lines() const;
};

/// Returns the lights that the training frames' photographs show. Finds none without eye masks or
/// measured eyeballs.
FoundLights find_lights(const Capture& capture, const Subject& subject);

/// Returns the cornea of an eye in a picture. `cornea`: in canonical units.
CorneaInPicture cornea_in_picture(const CaptureFrame& frame, const Pinhole<double>& camera,
                                  const Subject& subject, std::size_t eye,
                                  const Cornea<double>& cornea);

/// Gives an avatar these lights and corneas; none, and nothing changes, where there are none.
void set_lights(Avatar& avatar, const FoundLights& found);

} // namespace rye::trainer
