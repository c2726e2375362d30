// SPDX-License-Identifier: Apache-2.0
/// driving/retarget.hpp: an avatar's drivers from a tracked face: coefficients by name, gazes, the
/// head's motion.
#pragma once

#include <string>
#include <vector>

#include <rye/avatar/drivers.hpp>

#include "driving/face_track.hpp"

namespace rye::trainer {

/// Coefficients of an avatar for named ones at 1.
struct ExpressionMix {
    std::vector<std::string> names; ///< K
    Columns<double> weights;        ///< E x K
};

/// The rule by which a track of these names moves an avatar.
class Retarget {
  public:
    /// tracked: names of a track's coefficients; avatar: those of the avatar's, none if it has no
    /// names; coefficients: their number. A coefficient takes that of its name in any spelling
    /// (browDown_L, BrowDownLeft); one with a side, else, that of the same name without; one
    /// without a side, else, the mean of both sides.
    Retarget(const std::vector<std::string>& tracked, const std::vector<std::string>& avatar,
             int coefficients);
    /// For an avatar whose coefficients have no names: by what the named ones are in terms of them
    /// (fit_expressions.hpp).
    Retarget(const std::vector<std::string>& tracked, const ExpressionMix& mix);

    /// Returns the drivers of `rest` with the face's expression, with its gaze where the track says
    /// where eyes look, and with its head pose as if the head of `rest` faced the tracker. Gazes
    /// come from the track's angles, else from its coefficients of looking: 1 is 40 degrees aside,
    /// 30 up or down. Coefficients that the track lacks stay as in `rest`.
    Drivers<float> apply(const TrackedFace& face, const Drivers<float>& rest) const;

    /// Returns how many of the avatar's coefficients are driven.
    int driven() const;
    /// Returns a sentence: what is driven, and what is not.
    const std::string& words() const { return words_; }

  private:
    struct Source {
        Index tracked;
        double weight;
    };
    /// Finds the coefficients of looking.
    void find_looks(const std::vector<std::string>& tracked);
    std::vector<std::vector<Source>> sources_; ///< of each of the avatar's coefficients
    /// Looks of the left and the right eye: toward the subject's left and right, up, down.
    std::array<std::array<std::optional<Index>, 4>, 2> looks_;
    std::string words_;
    bool mixed_ = false; ///< sums are added to the rest's coefficients
};

} // namespace rye::trainer
