// SPDX-License-Identifier: Apache-2.0
/// importers/subject_eyes.hpp: the eyeballs of a subject, one rig for all frames, from the irises
/// in the pictures of an imported capture. Where several cameras show an iris, its middle is a
/// point in the head; these points lie on a sphere around the eyeball's centre, in the direction of
/// the gaze. Head frame, canonical units.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "data/capture.hpp"
#include "training/seen_gazes.hpp"

namespace rye::trainer {

/// What the gazes of a capture are good for.
enum class GivenGazes {
    labels, ///< right in the mean over frames
    none,   ///< both eyes look at one thing, about straight ahead in the mean
};

/// Middle of an iris in the head, from several cameras.
struct IrisPoint {
    int frame = 0;
    std::size_t eye = 0;
    Vec3<double> at;         ///< head frame
    Mat3<double> covariance; ///< of its error
    Vec3<double> gaze;       ///< given one, unit
};

/// Eyeballs of both eyes.
struct SubjectEyes {
    std::array<EyeballInHead, 2> eye;
    int irises = 0, frames = 0; ///< irises in pictures, and frames, that they come from
    double off = 0;             ///< root mean square distance of irises from their spheres
    int gazes = 0, views = 0;   ///< gazes of an eye that irises gave, and their pictures
    std::string text() const;   ///< a sentence for people
};

/// Returns the centres and the distance of the irises that fit the points best, starting from eyes
/// whose centres are expected to be right to within `centre_sigma` a coordinate and whose distance
/// of the iris to 15 %. Nothing for points of fewer than six frames.
std::optional<SubjectEyes> fit_eyes(const std::vector<IrisPoint>& points,
                                    const std::array<EyeballInHead, 2>& start, GivenGazes given,
                                    double centre_sigma);

/// Returns eyes of average proportions behind the lids, whose middle is the median over the
/// training frames.
std::array<EyeballInHead, 2> average_eyes(const Capture& capture);

/// Finds the eyes of a capture in the pictures of its training frames, whose head poses are aligned
/// by the landmarks for this alone, and puts their centres and sizes, and with GivenGazes::none
/// also the gazes that the irises show, into all frames. Returns nothing, and changes nothing, if
/// too few irises are seen by two cameras or more. start: average_eyes if absent.
std::optional<SubjectEyes> place_eyes(Capture& capture, GivenGazes given,
                                      const std::optional<std::array<EyeballInHead, 2>>& start);

/// Returns the radius of the rim of the iris, over the distance of its plane, that explains the
/// pictures of the eyes best; 0 if none are seen. balls: both eyes in each of these frames.
double rim_of_iris(const Capture& capture, const std::vector<int>& frames,
                   const std::vector<std::array<EyeballInHead, 2>>& balls);

/// Puts the sizes of the iris that the pictures show into all frames of a capture with centres and
/// radii. Returns the radius of its rim over that of the eyeball; changes nothing and returns 0 if
/// no iris is seen.
double measure_iris(Capture& capture);

} // namespace rye::trainer
