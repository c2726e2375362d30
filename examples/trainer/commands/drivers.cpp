// SPDX-License-Identifier: Apache-2.0
/// `rye drivers`: the drivers of a run or a capture as a CSV file, to be edited, drawn as curves,
/// or given to `rye redirect --driving`.
#include <iostream>
#include <memory>
#include <span>

#include <CLI/CLI.hpp>

#include <rye/capture/atomic_file.hpp>

#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "data/driver_table.hpp"

namespace rye::trainer {
namespace {

struct DriversOptions {
    std::filesystem::path run, capture, out;
};

void write_drivers(const DriversOptions& o) {
    const TrainState state = load_trained(o.run);
    const Capture capture = driving_capture(o.run, state, o.capture);
    std::vector<Drivers<float>> frames;
    std::vector<std::string> ids;
    for (int f = 0; f < capture.frame_count(); ++f) {
        frames.push_back(frame_drivers(capture, f, state.config.gaze_axis));
        ids.push_back(capture.frames[static_cast<std::size_t>(f)].id);
    }
    const std::string text = text_of_drivers(frames, ids);
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
    c->add_option("--out", o->out, "File to write (.csv)")
        ->required()
        ->check(out_check({OutFormat::csv}));
    add_memory(*c);
    c->callback([o] { write_drivers(*o); });
}

} // namespace rye::trainer
