// SPDX-License-Identifier: Apache-2.0
/// corrections/lights.hpp: the lights of a capture, from what the corneas in its photographs mirror
/// (reflections.hpp): lobes that explain the map of the surroundings, by least squares.
/// Frames: the world's; lengths in world units. Lights that are found are far away; none moves with
/// the head.
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "corrections/reflections.hpp"
#include "data/samples.hpp"
#include "model/types.hpp"

namespace rye::trainer {

/// A light as a capture's photographs show it, or as a file states it.
struct FoundLight {
    Vec3<double> to;        ///< direction of its middle, unit length
    Vec3<double> intensity; ///< colour that its highlight adds at its middle
    double width;           ///< standard deviation of its lobe [rad]
    std::optional<Vec3<double>> position = {}; ///< of one that is not far away
};

/// Lights of a capture.
struct FoundLights {
    std::vector<FoundLight> lights;             ///< brightest first
    std::array<Cornea<double>, 2> corneas;      ///< eyeball's frame, canonical units
    Vec3<double> middle = Vec3<double>::Zero(); ///< of the eyes over all frames, world
    double distance = 1;                        ///< of the lights from there [world units]
    int pictures = 0;                           ///< of an eye that were looked at
    double explained = 0; ///< share of the variance over directions that the lobes explain

    /// Returns a sentence about each light, or one that says that there are none.
    std::vector<std::string> lines() const;
    nlohmann::ordered_json json() const;
};

/// Returns the lights that the training frames' photographs show. Finds none without eye masks.
FoundLights find_lights(const Capture& capture, const Subject& subject);

/// Returns the cornea that a subject's eye has by a textbook's proportions.
Cornea<double> usual_cornea(const Subject& subject, std::size_t eye);

/// Returns the cornea of an eye in a picture. `cornea`: in canonical units.
CorneaInPicture cornea_in_picture(const CaptureFrame& frame, const Pinhole<double>& camera,
                                  const Subject& subject, std::size_t eye,
                                  const Cornea<double>& cornea);

/// Lets the corneas of an avatar, which are usual ones, refract.
void begin_refraction(Avatar& avatar, const Subject& subject);
/// Gives an avatar these lights and corneas; none, and nothing changes, where there are none.
void set_lights(Avatar& avatar, const FoundLights& found);
/// Gives an avatar that has corneas these lights instead of its own; none: no highlights.
void replace_lights(Avatar& avatar, const FoundLights& lights);

/// Returns an avatar's lights, with positions.
FoundLights lights_of(const Avatar& avatar);
/// Returns the lights of a JSON file: a list, alone or as the field `lights` of what `rye info
/// --json` prints, of objects with `to` (a direction of any length) or `position`, `intensity` and
/// `width`. Throws an Error with file, field and value for more than most_lights, and for numbers
/// that are not finite or out of range.
FoundLights read_lights(const std::filesystem::path& path);

} // namespace rye::trainer
