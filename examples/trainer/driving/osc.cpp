// SPDX-License-Identifier: Apache-2.0
#include "driving/osc.hpp"

#include <bit>
#include <cmath>

#include <rye/core/error.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"

namespace rye::trainer {
namespace {

constexpr int most_depth = 8;            // of bundles in bundles
constexpr double between_eyes_m = 0.064; // as VRChat's examples have it

/// Reader of what stands one after the other in a packet.
class Packet {
  public:
    Packet(ByteSpan bytes, const std::string& who) : bytes_(bytes), who_(who) {}

    bool done() const { return at_ == bytes_.size(); }
    ByteSpan take(std::size_t size) {
        require(size <= bytes_.size() - at_, who_, "an OSC packet of ", bytes_.size(),
                " bytes ends too early");
        const ByteSpan part = bytes_.subspan(at_, size);
        at_ += size;
        return part;
    }
    /// Text that ends with a zero, filled up to four bytes.
    std::string_view text() {
        const std::string_view rest = as_text(bytes_.subspan(at_));
        const std::size_t length = rest.find('\0');
        require(length != std::string_view::npos, who_, "an OSC text has no end");
        take((length / 4 + 1) * 4);
        return rest.substr(0, length);
    }
    std::uint64_t whole(std::size_t size) {
        std::uint64_t x = 0;
        for (const std::byte b : take(size)) x = x << 8U | std::to_integer<std::uint64_t>(b);
        return x;
    }

  private:
    ByteSpan bytes_;
    const std::string& who_;
    std::size_t at_ = 0;
};

void read(ByteSpan bytes, const std::string& who,
          const std::function<void(const OscMessage&)>& take, int depth) {
    require(depth < most_depth, who, "OSC bundles are nested deeper than ", most_depth);
    Packet packet(bytes, who);
    OscMessage message;
    message.address = packet.text();
    if (message.address == "#bundle") {
        packet.take(8); // time: all is used at once
        while (!packet.done()) {
            const auto size = static_cast<std::size_t>(packet.whole(4));
            read(packet.take(size), who, take, depth + 1);
        }
        return;
    }
    require(message.address.starts_with('/'), who, "got the OSC address '", message.address,
            "', expected one that begins with /");
    if (packet.done()) { // of old senders, without types
        take(message);
        return;
    }
    const std::string_view types = packet.text();
    require(types.starts_with(','), who, "got the OSC types '", types, "', expected a comma first");
    for (const char type : types.substr(1)) switch (type) {
            case 'f':
                message.numbers.push_back(
                    std::bit_cast<float>(static_cast<std::uint32_t>(packet.whole(4))));
                break;
            case 'd':
                message.numbers.push_back(std::bit_cast<double>(packet.whole(8)));
                break;
            case 'i':
                message.numbers.push_back(static_cast<std::int32_t>(packet.whole(4)));
                break;
            case 'T':
            case 'F':
                message.numbers.push_back(type == 'T' ? 1 : 0);
                break;
            case 'h':
            case 't':
                packet.take(8);
                break;
            case 's':
            case 'S':
                packet.text();
                break;
            case 'N':
            case 'I':
                break;
            default:
                throw Error(who + ": got the OSC type '" + std::string(1, type) +
                            "', expected f, d, i, h, t, s, T, F, N or I");
        }
    take(message);
}

/// Returns (pitch, yaw) in the head frame of a vector with x to the right, y up and z ahead.
Vec2<double> look_of(double x, double y, double z) { return pitch_yaw(Vec3<double>(-x, y, z)); }

} // namespace

void read_osc(ByteSpan packet, const std::string& who,
              const std::function<void(const OscMessage&)>& take) {
    read(packet, who, take, 0);
}

bool OscFace::take(const OscMessage& m, double now) {
    const std::string_view root = "/tracking/eye/";
    if (!m.address.starts_with(root)) return false;
    const std::string_view what = m.address.substr(root.size());
    const std::pair<std::string_view, std::size_t> known[]{
        {"EyesClosedAmount", 1}, {"CenterPitchYaw", 2}, {"CenterPitchYawDist", 3}, {"CenterVec", 3},
        {"CenterVecFull", 3},    {"LeftRightVec", 6},   {"LeftRightPitchYaw", 4}};
    const std::vector<double>& n = m.numbers;
    bool found = false;
    for (const auto& [name, count] : known) {
        if (what != name) continue;
        found = true;
        require(n.size() == count, std::string(m.address), "got ", n.size(), " numbers, expected ",
                count);
    }
    if (!found) return false;
    for (const double x : n)
        require(std::isfinite(x), std::string(m.address), "got a number that is not finite");
    if (what == "EyesClosedAmount") {
        closed_ = std::clamp(n[0], 0.0, 1.0);
        blinked_ = now;
        return true;
    }
    // + is down and to the right there.
    const auto angles = [&](std::size_t i) {
        return Vec2<double>(-n[i] * degree, -n[i + 1] * degree);
    };
    // Both eyes look at a point [m] from between them.
    const auto at = [&](const Vec3<double>& p) {
        for (std::size_t e = 0; e < 2; ++e) {
            const double aside = (e == 0 ? -0.5 : 0.5) * between_eyes_m; // the left eye: -x
            gaze_[e] = look_of(p.x() - aside, p.y(), p.z());
        }
    };
    if (what == "LeftRightPitchYaw") {
        gaze_ = {angles(0), angles(2)};
    } else if (what == "LeftRightVec") {
        gaze_ = {look_of(n[0], n[1], n[2]), look_of(n[3], n[4], n[5])};
    } else if (what == "CenterPitchYaw") {
        gaze_ = {angles(0), angles(0)};
    } else if (what == "CenterVec") {
        gaze_ = {look_of(n[0], n[1], n[2]), look_of(n[0], n[1], n[2])};
    } else if (what == "CenterVecFull") {
        at({n[0], n[1], n[2]});
    } else {
        const Vec3<double> ahead = gaze_vector(angles(0)[0], angles(0)[1]);
        at(n[2] * Vec3<double>(-ahead.x(), ahead.y(), ahead.z()));
    }
    looked_ = now;
    return true;
}

std::optional<TrackedFace> OscFace::face(double now) const {
    const auto holds = [&](const std::optional<double>& time) {
        return time && now - *time < timeout;
    };
    if (!holds(looked_) && !holds(blinked_)) return std::nullopt;
    TrackedFace f;
    f.time = now;
    if (holds(looked_))
        for (std::size_t e = 0; e < 2; ++e) f.gaze[e] = gaze_[e];
    if (holds(blinked_)) f.coefficients = VecX<double>::Constant(2, closed_);
    return f;
}

} // namespace rye::trainer
