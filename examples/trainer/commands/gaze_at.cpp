// SPDX-License-Identifier: Apache-2.0
#include "commands/gaze_at.hpp"

#include <iostream>
#include <optional>
#include <string_view>

#include <CLI/CLI.hpp>

#include <rye/avatar/gaze_at.hpp>
#include <rye/core/error.hpp>
#include <rye/core/parse.hpp>

#include "commands/options.hpp"
#include "data/degrees.hpp"

namespace rye::trainer {
namespace {

constexpr double most_coordinate = 1e9;
constexpr std::string_view in_head = "head:";

} // namespace

GazePoint parsed_gaze_point(const std::string& text, const std::string& option) {
    GazePoint p;
    if (text == "camera") return p;
    std::string_view rest = text;
    p.frame = rest.starts_with(in_head) ? GazePoint::Frame::head : GazePoint::Frame::world;
    if (p.frame == GazePoint::Frame::head) rest.remove_prefix(in_head.size());
    bool read = true;
    for (int k = 0; k < 3 && read; ++k) {
        const std::size_t comma = rest.find(',');
        const std::optional<double> x = parse_double(rest.substr(0, comma));
        read =
            x && std::abs(*x) <= most_coordinate && (comma == std::string_view::npos) == (k == 2);
        if (read) p.point[k] = *x;
        if (comma != std::string_view::npos) rest.remove_prefix(comma + 1);
    }
    require(read, option, "got '", text,
            "', expected camera, or X,Y,Z in the world, or head:X,Y,Z, numbers to 1e9 either way");
    return p;
}

void add_gaze_at_options(CLI::App& command, GazeAtOptions& o) {
    CLI::Option* const at =
        command
            .add_option("--gaze-at", o.target,
                        "Point that both eyes look at, kappa and distance included: X,Y,Z in the "
                        "world, head:X,Y,Z in the head's frame, or camera")
            ->check(read_check(parsed_gaze_point));
    command
        .add_option("--gaze-range", o.range_deg,
                    "Angle from straight ahead, in degrees, at which an eye stops before it "
                    "reaches the point")
        ->needs(at)
        ->check(from_to(1.0, 70.0))
        ->capture_default_str();
}

PlacedEyes placed_eyes(const TrainState& state, const Drivers<float>& drivers) {
    PlacedEyes eyes;
    eyes.head = head_placement(drivers.cast<double>());
    const auto centre =
        driven_eye_centres(train_backend(), state.avatar.eyes, state.config.avatar, drivers);
    const auto kappa = kappas_of(state.avatar.eyes);
    for (std::size_t e = 0; e < 2; ++e) {
        eyes.centre[e] = centre[e].cast<double>();
        eyes.kappa[e] = {static_cast<double>(kappa[e].pitch), static_cast<double>(kappa[e].yaw)};
    }
    return eyes;
}

GazeTarget<double> gaze_target(const GazePoint& point, const HeadPlacement<double>& head,
                               const Pinhole<float>& camera) {
    if (point.frame == GazePoint::Frame::head) return {point.point};
    const Vec3<double> world = point.frame == GazePoint::Frame::world
                                   ? point.point
                                   : Vec3<double>(camera.cast<double>().centre());
    return target_in_head(head, GazeTarget<double>{world});
}

void aim_frames(const GazeAtOptions& o, const TrainState& state, std::vector<DrawnFrame>& frames) {
    const GazePoint point = parsed_gaze_point(o.target, "--gaze-at");
    std::size_t stopped = 0;
    for (std::size_t i = 0; i < frames.size(); ++i) {
        DrawnFrame& f = frames[i];
        const PlacedEyes eyes = placed_eyes(state, f.drivers);
        const GazeTarget<double> target = gaze_target(point, eyes.head, f.camera);
        for (std::size_t e = 0; e < 2; ++e)
            require(
                norm(toward(eyes.centre[e], target)) > target.weight * state.subject.eye_radius[e],
                "--gaze-at", "got ", o.target, ", which lies inside the ",
                (e == 0 ? "left" : "right"), " eye of picture ", i,
                ", expected a point outside the eyes");
        const AimedEyes<double> aimed =
            aim_eyes(eyes.centre, target, eyes.kappa, o.range_deg * degree);
        for (std::size_t e = 0; e < 2; ++e)
            f.drivers.gaze[e] = aimed[e].visual.template cast<float>();
        stopped += aimed[0].missed > 0 || aimed[1].missed > 0 ? 1 : 0;
    }
    if (stopped > 0)
        std::cerr << "rye: note: in " << stopped << " of " << frames.size()
                  << " pictures the point of --gaze-at is out of reach: an eye stops "
                  << o.range_deg << " degrees from straight ahead\n";
}

} // namespace rye::trainer
