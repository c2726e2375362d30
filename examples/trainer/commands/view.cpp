// SPDX-License-Identifier: Apache-2.0
/// `rye view`: a page on this machine that shows a run, an .avatar or a splat file: camera, gaze,
/// expression, effects, and accuracy beside its time. A run that is trained is shown as it trains.
#include "commands/view.hpp"

#include <chrono>
#include <fstream>
#include <iostream>
#include <memory>

#include <CLI/CLI.hpp>

#include "commands/commands.hpp"
#include "commands/driving.hpp"
#include "commands/options.hpp"
#include "data/json.hpp"
#include "data/noted_stops.hpp"
#include "data/run_frames.hpp"
#include "data/threads.hpp"
#include "driving/osc.hpp"
#include "driving/retarget.hpp"
#include "viewing/view_page.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

struct ViewOptions {
    fs::path path;
    std::string device = "auto";
    DrivingOptions driving;
    int port = 0, osc = 0, threads = 0;
};

double seconds_since(Clock::time_point begin) {
    return std::chrono::duration<double>(Clock::now() - begin).count();
}

/// Returns the end of a file, at most so many bytes.
std::string end_of(const fs::path& path, std::streamoff most) {
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    if (!file) return {};
    const std::streamoff size = file.tellg(), length = std::min(size, most);
    file.seekg(size - length);
    std::string text(static_cast<std::size_t>(length), '\0');
    file.read(text.data(), length);
    text.resize(static_cast<std::size_t>(file.gcount()));
    return text;
}

/// Returns what the last whole line of a training's log says; empty without one.
std::string training_words(const fs::path& run) {
    std::string text = end_of(run / "log.jsonl", 8192);
    text.resize(std::min(text.size(), text.rfind('\n') + 1));
    while (!text.empty()) {
        text.pop_back(); // the end of the line
        const std::size_t begin = text.rfind('\n') + 1;
        try {
            const auto line = nlohmann::json::parse(text.substr(begin));
            if (line.contains("loss"))
                return line.at("stage").get<std::string>() + ", step " +
                       std::to_string(line.at("step").get<long long>()) + ": loss " +
                       std::to_string(line.at("loss").get<double>());
        } catch (const nlohmann::json::exception&) { // cut, or of another kind
        }
        text.resize(begin);
    }
    return {};
}

/// A run's folder, of which a page shows the last checkpoint.
class FollowedRun {
  public:
    FollowedRun(fs::path run, DeviceWish wish) : run_(std::move(run)), wish_(wish) {}

    /// Looks whether there is a newer checkpoint, and shows it.
    void look(ViewPage& page) {
        std::error_code fault;
        const fs::file_time_type time = fs::last_write_time(checkpoint_path(run_), fault);
        const std::string words = training_words(run_);
        if (!fault && time != shown_) {
            show(page);
            shown_ = time;
        }
        const bool head = page.has_scene();
        page.say(!fault_.empty()          ? fault_
                 : !head && words.empty() ? "no head has been trained yet"
                 : !head                  ? words + "; no head yet"
                 : words != first_words_  ? words
                                          : "");
        if (first_words_.empty()) first_words_ = words;
    }
    /// Returns why the last checkpoint cannot be shown; empty if it can.
    const std::string& fault() const { return fault_; }

  private:
    void show(ViewPage& page) {
        fault_.clear();
        try {
            const TrainState there = load_checkpoint(run_);
            if (there.stage == Stage::mesh || there.step == 0) return; // no head yet
            TrainState state = drawn_state(there);
            const ShownView view = shown_view(run_, state, {}, "", "");
            page.show(viewed_run(std::move(state), view.capture, view.frame, view.camera, wish_));
        } catch (const Error& e) {
            fault_ = e.what();
        }
    }

    fs::path run_;
    DeviceWish wish_;
    fs::file_time_type shown_ = fs::file_time_type::min();
    std::string first_words_, fault_;
};

/// Returns drivers that play in a circle at 60 a second.
LiveDriver playing(std::vector<Drivers<float>> frames) {
    constexpr double rate = 60;
    return [frames = std::move(frames), begin = Clock::now()](Drivers<float>& d) {
        const auto picture = static_cast<std::size_t>(seconds_since(begin) * rate);
        d = frames[picture % frames.size()];
        return true;
    };
}

/// Returns drivers by OSC, which the server receives on a port; says what it does not understand
/// once.
LiveDriver by_osc(LoopbackServer& server, int port, const std::vector<std::string>& names,
                  int coefficients) {
    auto face = std::make_shared<OscFace>();
    const auto begin = Clock::now();
    server.receive(port, [face, begin, told = false](ByteSpan packet) mutable {
        try {
            read_osc(packet, "--osc",
                     [&](const OscMessage& m) { face->take(m, seconds_since(begin)); });
        } catch (const Error& e) {
            if (!told)
                std::cerr << "rye: note: " << e.what() << "; further such packets are not told\n";
            told = true;
        }
    });
    return [face, begin,
            retarget = Retarget(OscFace::names(), names, coefficients)](Drivers<float>& d) {
        const std::optional<TrackedFace> f = face->face(seconds_since(begin));
        if (f) d = retarget.apply(*f, d);
        return f.has_value();
    };
}

/// Shows what the options say, and returns what moves it; `run` follows a run's folder.
LiveDriver begin_view(const ViewOptions& o, ViewPage& page, LoopbackServer& server,
                      std::optional<FollowedRun>& run) {
    const DeviceWish wish = device_wish(o.device);
    LiveDriver live;
    if (fs::is_directory(o.path)) {
        require(fs::exists(checkpoint_path(o.path)) || fs::exists(o.path / "log.jsonl"),
                o.path.string(), "has no checkpoint and no log, expected the folder of a run");
        run.emplace(o.path, wish);
        run->look(page);
        require(page.has_scene() || o.driving.path.empty(), "--driving",
                "needs a trained head, and there is none yet");
    } else {
        require(wish != DeviceWish::cuda, "--device", "got cuda, but ", o.path.string(),
                " is drawn on the CPU, expected the folder of a run");
        require(o.driving.path.empty(), "--driving", "got ", o.driving.path.string(), ", but ",
                o.path.string(), " is no run, expected the folder of one");
        page.show(extension_of(o.path) == ".avatar" ? viewed_avatar(o.path)
                                                    : viewed_splats(o.path));
    }
    if (!o.driving.path.empty()) {
        const TrainState state = load_trained(o.path);
        const ShownView view = shown_view(o.path, state, {}, "", "");
        live = playing(
            driving_frames(o.driving, state, view.capture,
                           frame_drivers(view.capture, view.frame, state.config.gaze_axis), 60));
    }
    if (o.osc > 0) {
        require(page.has_scene(), "--osc", "needs a trained head, and there is none yet");
        live = by_osc(server, o.osc, page.expression_names(), page.expressions());
    }
    return live;
}

void serve(LoopbackServer& server, ViewPage& page, FollowedRun* run,
           const std::function<bool()>& stop) {
    Clock::time_point looked = Clock::now();
    server.run([&] {
        if (run != nullptr && seconds_since(looked) >= 1) {
            run->look(page);
            looked = Clock::now();
        }
        return stop();
    });
}

void view(const ViewOptions& o) {
    set_threads(o.threads);
    ViewPage page;
    LoopbackServer server(o.port, [&](const WebRequest& r) { return page.answer(r); });
    std::optional<FollowedRun> run;
    page.drive(begin_view(o, page, server, run));
    if (run && !run->fault().empty()) std::cerr << "rye: note: " << run->fault() << "\n";
    const NotedStops stops;
    std::cout << "open " << server.address() << "\nCtrl-C ends it\n" << std::flush;
    serve(server, page, run ? &*run : nullptr, [&] { return stops.signal() != 0; });
    std::cout << "ended\n";
}

} // namespace

ViewedTraining::ViewedTraining(fs::path run, int port) {
    struct Parts {
        ViewPage page;
        FollowedRun run;
        LoopbackServer server;
        Parts(fs::path folder, int p)
            : run(std::move(folder), DeviceWish::cpu),
              server(p, [this](const WebRequest& r) { return page.answer(r); }) {
            page.say("no head has been trained yet");
        }
    };
    auto parts = std::make_shared<Parts>(std::move(run), port);
    address_ = parts->server.address();
    thread_ = std::thread([this, parts] {
        try {
            serve(parts->server, parts->page, &parts->run, [&] { return stop_.load(); });
        } catch (const std::exception& e) {
            std::cerr << "rye: note: the view of the training ended: " << e.what() << "\n";
        }
    });
}

ViewedTraining::~ViewedTraining() {
    stop_ = true;
    thread_.join();
}

void add_view(CLI::App& app) {
    auto o = std::make_shared<ViewOptions>();
    CLI::App* c = app.add_subcommand(
        "view", "Show a run, also while it trains, an .avatar or a splat file in the browser");
    c->add_option("what", o->path, "Folder of a run, an .avatar, or a splat file")
        ->required()
        ->check(CLI::ExistingPath);
    c->add_option("--port", o->port, "Port of 127.0.0.1 (default: a free one)")
        ->check(from_to(1, 65535));
    add_driving_options(*c, o->driving);
    c->add_option("--osc", o->osc,
                  "UDP port of 127.0.0.1 for eyes by OSC at VRChat's addresses, /tracking/eye/...: "
                  "VRChat's own is 9000")
        ->check(from_to(1, 65535))
        ->excludes("--driving");
    add_device(*c, o->device, drawing_device_help);
    add_memory(*c);
    add_threads(*c, o->threads);
    c->callback([o] { view(*o); });
}

} // namespace rye::trainer
