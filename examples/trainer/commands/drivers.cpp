// SPDX-License-Identifier: Apache-2.0
/// `rye drivers`: the drivers of a run or a capture, or a face tracker's file turned into the
/// run's, as a CSV file, to be edited, drawn as curves, or given to `rye redirect --driving`.
#include <iostream>
#include <memory>
#include <span>

#include <CLI/CLI.hpp>

#include <rye/io/atomic_file.hpp>

#include "commands/commands.hpp"
#include "commands/driving.hpp"
#include "commands/options.hpp"
#include "data/driver_table.hpp"
#include "data/moving_picture.hpp"

namespace rye::trainer {
namespace {

struct DriversOptions {
    std::filesystem::path run, capture, out;
    DrivingOptions driving;
    std::string rate = "25";
};

void write_drivers(const DriversOptions& o) {
    const TrainState state = load_trained(o.run);
    const Capture capture = driving_capture(o.run, state, o.capture);
    std::vector<Drivers<float>> frames;
    std::vector<std::string> ids;
    std::vector<PupilRatios> pupils;
    if (!o.driving.path.empty()) {
        const Drivers<float> own =
            frame_drivers(capture, frame_index(capture, ""), state.config.gaze_axis);
        frames = driving_frames(o.driving, state, capture, own,
                                pictures_a_second(parsed_rate(o.rate, "--fps")), &pupils);
        for (std::size_t i = 0; i < frames.size(); ++i) ids.push_back(std::to_string(i));
    } else {
        for (int f = 0; f < capture.frame_count(); ++f) {
            frames.push_back(frame_drivers(capture, f, state.config.gaze_axis));
            ids.push_back(capture.frames[static_cast<std::size_t>(f)].id);
        }
    }
    const std::string text = text_of_drivers(frames, ids, pupils);
    write_atomic(o.out, std::as_bytes(std::span(text)));
    std::cout << o.out.string() << ": " << frames.size() << " frames\n";
}

} // namespace

void add_drivers(CLI::App& app) {
    auto o = std::make_shared<DriversOptions>();
    CLI::App* c =
        app.add_subcommand("drivers", "Write expressions, head poses and gazes as a table");
    c->add_option("--run", o->run, "Folder of the run")
        ->required()
        ->check(folder_check("the folder of a run with its checkpoint"));
    c->add_option("--capture", o->capture,
                  "Folder of a capture whose frames are written (default: the "
                  "run's own)")
        ->check(folder_check("the folder of a capture"));
    add_driving_options(*c, o->driving);
    c->add_option("--fps", o->rate, "Pictures a second of a tracker's file: 25, or 30000/1001")
        ->check(read_check(parsed_rate))
        ->needs("--driving")
        ->capture_default_str();
    c->add_option("--out", o->out, "File to write (.csv)")
        ->required()
        ->check(out_check({OutFormat::csv}));
    add_memory(*c);
    c->callback([o] { write_drivers(*o); });
}

} // namespace rye::trainer
