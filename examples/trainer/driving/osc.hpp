// SPDX-License-Identifier: Apache-2.0
/// driving/osc.hpp: eyes that another program sends as OSC, at the addresses that VRChat receives:
/// /tracking/eye/LeftRightPitchYaw and the others of its page "OSC Eye Tracking". Source: Open
/// Sound Control 1.0.
#pragma once

#include <functional>
#include <span>
#include <string_view>
#include <vector>

#include <rye/io/bytes.hpp>

#include "driving/face_track.hpp"

namespace rye::trainer {

struct OscMessage {
    std::string_view address;
    std::vector<double> numbers; ///< its arguments that are numbers or truth values
};

/// Calls `take` with each message of a packet, also those in bundles. Throws an Error that begins
/// with `who` for bytes that are no OSC.
void read_osc(ByteSpan packet, const std::string& who,
              const std::function<void(const OscMessage&)>& take);

/// Face of which a stream of packets says where its eyes look and how far they are closed.
class OscFace {
  public:
    /// Names of the coefficients: both eyes' lids.
    static std::vector<std::string> names() { return {"eyeBlinkLeft", "eyeBlinkRight"}; }
    /// Time without news after which what was said is no longer so [s], as in VRChat.
    static constexpr double timeout = 10;

    /// Takes a message that came at this time [s]; returns false for an address that is none of
    /// these. Throws an Error for a wrong number of numbers and for numbers that are not finite.
    bool take(const OscMessage& message, double now);
    /// Returns what holds at this time; nothing if nothing does.
    std::optional<TrackedFace> face(double now) const;

  private:
    std::array<Vec2<double>, 2> gaze_{};
    double closed_ = 0;
    std::optional<double> looked_, blinked_; ///< times of the last news
};

} // namespace rye::trainer
