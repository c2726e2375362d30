// SPDX-License-Identifier: Apache-2.0
/// `rye train`: both stages, with progress, log, panels, checkpoints and resume.
#include <csignal>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <numeric>

#include <CLI/CLI.hpp>

#include <rye/train/fit_lids.hpp>
#include <rye/train/probe.hpp>

#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "commands/progress.hpp"
#include "commands/view.hpp"
#include "corrections/camera_colours.hpp"
#include "corrections/cameras.hpp"
#include "corrections/labels.hpp"
#include "data/folder_lock.hpp"
#include "data/json.hpp"
#include "data/panel.hpp"
#include "data/run_frames.hpp"
#include "data/system.hpp"
#include "data/threads.hpp"
#include "data/validate.hpp"
#include "data/work_beside.hpp"
#include "device/choice.hpp"
#include "device/mesh_networks.hpp"
#include "drawing/shown.hpp"
#include "model/draws.hpp"
#include "model/perceptual_weights.hpp"
#include "model/run_size.hpp"
#include "training/begun.hpp"
#include "training/density.hpp"
#include "training/device_count.hpp"
#include "training/one_camera.hpp"
#include "training/process_ranks.hpp"
#include "training/run_folder.hpp"
#include "training/steps.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;

volatile std::sig_atomic_t stop_requested = 0;  // set by a signal, read between steps

void request_stop(int signal) {
    stop_requested = signal;
    std::signal(signal, SIG_DFL);  // a second signal ends the program at once
}

struct TrainOptions {
    std::filesystem::path capture, out, config, perceptual_weights, begin;
    std::string preset = "cpu";
    std::string device = "auto";
    bool resume = false, overwrite = false, profile = false, quiet = false, print_config = false;
    bool json = false;
    int threads = 0;
    int view = -1; ///< port of a view of the training; 0: a free one, -1: none
    std::string ranks = "1"; ///< number of them in this process, or a launcher of theirs
    std::string rank_sum = "tree";
    std::optional<double> device_memory; ///< most of it that is used [bytes]
    std::optional<std::string> seed;  // as text: the option parser would accept -3 and 1e23
    std::optional<std::int64_t> steps;
};

/// Returns a device with no more free memory than the options let it use.
DeviceFacts device_of(const TrainOptions& o, DeviceFacts device) {
    if (o.device_memory) device.free = std::min(device.free, *o.device_memory);
    return device;
}

/// Returns how ranks add up, with all views on the device.
DeviceStepSettings settings_of(const TrainOptions& o, Ranks* ranks) {
    return {ranks, o.rank_sum == "tree" ? RankSum::tree : RankSum::library};
}

/// Returns true if standard output has no progress.
bool quiet(const TrainOptions& o) { return o.quiet || o.json; }

/// Number of steps in a row, skipped for a non-finite gradient, that ends the run.
constexpr int max_skipped_steps = 20;

/// Applies --steps, within the bounds of the configuration file.
void take_steps(const TrainOptions& o, TrainConfig& config) {
    if (o.steps) from_json({{"gaussians", {{"steps", *o.steps}}}}, "--steps", config);
}

/// Trainer of one run.
class Trainer {
  public:
    /// on: device for stage 2; none: the CPU. times: of what was done before. ranks: null for one.
    Trainer(const TrainOptions& options, std::optional<DeviceFacts> on, Capture capture,
            TrainState state, TimeProbe times, Beginning beginning, Ranks* ranks)
        : options_(options),
          device_(std::move(on)),
          capture_(std::move(capture)),
          state_(std::move(state)),
          random_{state_.config.seed, 0},
          grid_(make_lattice(state_)),
          ranks_(ranks),
          probe_(std::move(times)) {
        if (first_of(ranks)) folder_.emplace(options.out, state_, beginning, &capture_);
    }

    /// Writes the checkpoint of the current state, on rank 0.
    void save() { save(state_); }
    void save(const TrainState& state) {
        if (folder_) folder_->save(state);
    }
    /// Writes a line of the log, on rank 0.
    void log(const Json& line) {
        if (folder_) folder_->log(line);
    }
    /// Continues as if stage 1 were done, with the mesh of `run`.
    void begin_after(const std::filesystem::path& run) {
        has_mesh_ = true;
        TrainState after;
        after.stage = Stage::avatar;
        int damaged = 0;
        if (folder_) folder_->log_lines(kept_log(run / "log.jsonl", after, damaged));
        if (!quiet(options_)) std::cout << "stage 1 is that of " << run.string() << "\n";
    }

    /// Trains; returns true if the run is complete, false if it was stopped.
    bool run() {
        if (!first_of(ranks_)) {
            if (!follow_stage_one()) return false;
        } else {
            const bool begun = begin_stage_two();
            if (ranks_ != nullptr) ranks_->given(begun ? place() : stopped_words);
            if (!begun) return false;
        }
        return device_ ? train_avatar_on_device() : train_avatar();
    }
    const TrainState& state() const { return state_; }

  private:
    /// Trains stage 1, unless that is done, and makes the avatar; returns false if it was stopped.
    bool begin_stage_two() {
        if (state_.stage != Stage::mesh) return true;
        if (!has_mesh_) {
            if (!train_mesh()) return false;
            fit_to_landmarks();
        }
        probe_.start();
        FoundLights lights;
        if (state_.config.highlights &&
            state_.config.gaze_mechanism == GazeMechanismName::rotation) {
            lights = find_lights(capture_, state_.subject);
            if (!quiet(options_))
                for (const std::string& line : lights.lines()) std::cout << line << "\n";
            probe_("lights on corneas");
        }
        FoundKappa kappa;
        if (state_.config.gaze_axis == GazeAxis::visual && state_.config.measured_eyes) {
            kappa = find_kappa(capture_, state_.config.gaussians.eyeball.radius);
            if (!quiet(options_))
                for (const std::string& line : kappa.lines()) std::cout << line << "\n";
            probe_("kappa by irises");
        }
        const AvatarSize size = begin_avatar(state_, grid_, lights, kappa);
        save();
        probe_("first avatar");
        if (!quiet(options_))
            std::cout << "stage 2 begins with " << size.face << " face and " << size.eyes
                      << " eye Gaussians\n";
        return true;
    }
    static constexpr const char* stopped_words = "stopped";
    std::string place() const { return "stage 2 of " + std::to_string(state_.step); }

    /// Waits until rank 0 has trained stage 1, and goes on from the checkpoint that it wrote;
    /// returns false if rank 0 was stopped.
    bool follow_stage_one() {
        const std::string there = ranks_->given("");
        if (there == stopped_words) return false;
        const Columns<double> directions = state_.view_directions;
        state_ = load_checkpoint(options_.out);
        take_steps(options_, state_.config);
        state_.view_directions = directions;
        require(state_.stage == Stage::avatar && place() == there, options_.out.string(), "rank ",
                ranks_->rank(), " read ", [&] { return place(); }, ", rank 0 has ", there,
                ": the ranks do not see the same folder");
        return true;
    }

    void check_applied(const StepReport& report, const char* stage) {
        skipped_ = report.refused             ? static_cast<int>(*report.refused)
                   : report.bad_field.empty() ? 0
                                              : skipped_ + 1;
        if (skipped_ == 0) return;
        log({{"stage", stage}, {"step", state_.step}, {"skipped", report.bad_field}});
        require(skipped_ < max_skipped_steps, options_.out.string(), "the gradient of '",
                report.bad_field, "' was not finite ", skipped_, " times in a row at step ",
                state_.step, "; the last checkpoint is sound");
    }

    bool stopped() {
        bool stop = stop_requested != 0;
        if (ranks_ != nullptr && state_.stage == Stage::avatar) stop = ranks_->threads()->any(stop);
        if (!stop) return false;
        save();
        tell_stopped();
        return true;
    }
    void tell_stopped() const {
        if (!first_of(ranks_)) return;
        std::cout << "\nstopped; the checkpoint is saved. Go on with\n  rye train --capture "
                  << capture_.folder.string() << " --out " << options_.out.string()
                  << " --resume\n";
    }

    bool train_mesh() {
        const TrainConfig& config = state_.config;
        const MeshTrainConfig& m = config.mesh;
        const Index total = total_steps(m, capture_);
        const Random order = random_.fork(1), views = random_.fork(2);
        const std::unique_ptr<MeshNetworks> networks = device_ ? mesh_networks() : nullptr;
        if (state_.step == 0) pretrain_mesh(state_, networks.get());
        MeshStepper stepper(state_, networks.get());
        Progress progress("stage 1", total, quiet(options_));
        int empty = 0;
        const auto sample_of_step = [&](Index step) {
            const int frame = frame_of_step(capture_.train, step, order);
            std::vector<int> cameras = present_cameras(capture_, frame);
            const Random pick = views.fork(static_cast<std::uint64_t>(step));
            const int wanted = std::min<int>(m.views, static_cast<int>(cameras.size()));
            for (int v = 0; v < wanted; ++v)
                std::swap(cameras[static_cast<std::size_t>(v)],
                          cameras[static_cast<std::size_t>(
                              v + pick.below(static_cast<std::uint64_t>(v),
                                             static_cast<Index>(cameras.size()) - v))]);
            cameras.resize(static_cast<std::size_t>(wanted));
            return mesh_sample(capture_, state_.subject, config, frame, cameras);
        };
        MeshSample<float> sample, next;
        WorkBeside ahead("rye train"); // the next step's pictures
        const auto make_next = [&](Index step) {
            if (step < total) ahead.start([&, step] { next = sample_of_step(step); });
        };
        make_next(state_.step);
        while (state_.step < total) {
            probe_.start();
            const Index step = state_.step;
            ahead.wait();
            std::swap(sample, next);
            make_next(step + 1);
            probe_("data");
            const StepReport report = stepper.step(
                state_, grid_, sample, decayed(m.rate_decay, step, total), std::ref(probe_));
            empty = report.vertices == 0 ? empty + 1 : 0;
            require(empty < 100, options_.out.string(),
                    "the signed distance of stage 1 has had no surface for 100 steps (step ", step,
                    "); check units and head pose with `rye info`");
            check_applied(report, "mesh");
            tell("mesh", report, progress, state_.step == total);
            if (stopped()) return false;
            if (state_.step % state_.config.gaussians.checkpoint_every == 0) save();
        }
        return true;
    }

    void fit_to_landmarks() {
        if (state_.config.mesh.fit_steps == 0) return;
        probe_.start();
        const std::unique_ptr<MeshNetworks> networks = device_ ? mesh_networks() : nullptr;
        const FittedLandmarks left = fit_landmarks(state_, capture_, networks.get());
        probe_("fit to landmarks");
        log({{"stage", "mesh"},
             {"step", state_.step},
             {"landmark_rms", left.rms},
             {"landmark_noise", left.noise}});
        if (quiet(options_)) return;
        std::cout << brief("landmarks of all frames fitted: landmark_rms", left.rms);
        if (left.noise > 0)
            std::cout << "; " << brief("noise", left.noise);
        std::cout << "\n";
    }

    /// Logs and shows a step, the last of `taken` steps taken together.
    void tell(const char* stage, const StepReport& report, Progress& progress, bool last,
              Index taken = 1) {
        if (state_.step % log_every == 0 || last) {
            Json line = {{"stage", stage}, {"step", state_.step}};
            for (const auto& [name, value] : report.losses) line[name] = value;
            if (report.vertices > 0) line["vertices"] = report.vertices;
            log(line);
        }
        std::vector<std::string> shown;
        for (const auto& [name, value] : report.losses) shown.push_back(brief(name, value));
        progress.show(state_.step, shown, last, taken);
    }

    /// Fits what expressions do to lids that close; `state` has taken its last step.
    void close_lids(TrainState& state) {
        probe_.start();
        const FittedLids fitted = trainer::close_lids(state, capture_);
        if (fitted.points == 0) return;
        probe_("fit of the lids");
        log({{"stage", "avatar"},
             {"step", state.step},
             {"lid_points", fitted.points},
             {"lid_attributes", fitted.lids.attributes},
             {"lid_place", fitted.lids.place},
             {"other_attributes", fitted.others.attributes},
             {"other_place", fitted.others.place}});
        if (!quiet(options_))
            std::cout << "lids that close: " << fitted.points << " Gaussians grow as they part\n";
    }

    bool train_avatar() {
        const AvatarTrainConfig& g = state_.config.gaussians;
        const SampleDraws draws(capture_, state_.config);
        const Index total = draws.total();
        const StepShare share = share_of(state_.config, ranks_);
        std::unique_ptr<AvatarSteps> steps = avatar_steps(state_, options_.perceptual_weights);
        Progress progress("stage 2", total, quiet(options_));
        while (state_.step < total) {
            probe_.start();
            const SampleDraw first = draws(state_.step, share.first);
            const AvatarSample<float> sample = sample_of(capture_, state_.config, first);
            probe_("data");
            StepReport report;
            if (share.all == 1) {
                report = steps->step(state_, sample, first.rate, std::ref(probe_));
            } else {
                steps->add(sample, share.all, std::ref(probe_));
                for (Index k = 1; k < share.count; ++k) {
                    const AvatarSample<float> next =
                        sample_of(capture_, state_.config, draws(state_.step, share.first + k));
                    probe_("data");
                    steps->add(next, share.all, std::ref(probe_));
                }
                report = steps->take(state_, ranks_ == nullptr ? nullptr : ranks_->threads(),
                                     first.rate, std::ref(probe_));
            }
            check_applied(report, "avatar");
            const bool last = state_.step == total;
            tell("avatar", report, progress, last);
            if (last) close_lids(state_);
            if (density_due(g.density, state_.step, total)) {
                steps.reset(); // its memory fits the old number of Gaussians
                change_density();
                steps = avatar_steps(state_, options_.perceptual_weights);
                probe_("density");
            }
            if (folder_ && g.panel_every > 0 && (state_.step % g.panel_every == 0 || last))
                write_panel(state_, sample);
            if (stopped()) return false;
            if (state_.step % g.checkpoint_every == 0 || last) save();
        }
        tell_density();
        return true;
    }

    /// Splits and prunes the face's Gaussians of the state after a step, before anything uses the
    /// state: a checkpoint of this step has the change.
    void change_density() {
        const DensityChange c = change_face(state_);
        log({{"stage", "avatar"},
             {"step", state_.step},
             {"grown", c.grown},
             {"pruned", c.pruned},
             {"face", c.face}});
        ++changes_;
        changed_.grown += c.grown;
        changed_.pruned += c.pruned;
        changed_.face = c.face;
    }
    void tell_density() const {
        if (changes_ == 0 || quiet(options_)) return;
        std::cout << "the face has " << changed_.face << " Gaussians: " << changed_.grown
                  << " were split and " << changed_.pruned << " were pruned, in " << changes_
                  << (changes_ == 1 ? " change" : " changes") << " of density\n";
    }

    /// Trains stage 2 in chunks of steps. A thread makes panels and checkpoints from a copy of the
    /// state while further steps run.
    bool train_avatar_on_device() {
        const AvatarTrainConfig& g = state_.config.gaussians;
        const SampleDraws draws(capture_, state_.config);
        const Index total = draws.total();
        if (state_.step >= total) return true;
        const DeviceStepSettings settings = settings_on_device();
        probe_.start();
        const StepShare share = share_of(state_.config, ranks_);
        const std::unique_ptr<DeviceSteps> steps =
            device_steps(state_, capture_, options_.perceptual_weights, settings);
        probe_("pictures to the device");
        TrainState copy = state_; // read by the thread; outlives it
        WorkBeside files("rye train");
        Progress progress("stage 2", total, quiet(options_));
        while (state_.step < total) {
            probe_.start();
            std::vector<SampleDraw> chunk;
            const Index end = chunk_end(state_.step, total, g);
            for (Index step = state_.step; step < end; ++step)
                for (Index k = 0; k < share.count; ++k)
                    chunk.push_back(draws(step, share.first + k));
            probe_("data");
            const Index before = state_.step;
            const StepReport report = steps->run(state_, chunk, stop_requested != 0);
            probe_("steps on the device");
            files.check();
            check_applied(report, "avatar");
            const bool last = state_.step == total;
            const bool stop = ranks_ != nullptr ? report.asked : stop_requested != 0;
            const bool shows = folder_ && g.panel_every > 0 &&
                               (state_.step % g.panel_every == 0 || last);
            const bool saves = folder_ && (state_.step % g.checkpoint_every == 0 || last);
            tell("avatar", report, progress, last, state_.step - before);
            if (density_due(g.density, state_.step, total)) {
                files.wait();
                steps->fetch(state_);
                change_density();
                steps->restart(state_);
                copy = state_; // with the new shapes
                probe_("density");
            }
            if (!shows && !saves && !stop) continue;
            files.wait();
            probe_("wait for files");
            copy.step = state_.step;
            steps->fetch(copy);
            probe_("from the device");
            if (last) close_lids(copy);
            std::optional<AvatarSample<float>> shown;
            if (shows) // the last step's first picture
                shown = sample_of(capture_, state_.config,
                                  *(chunk.end() - static_cast<std::ptrdiff_t>(share.count)));
            files.start([this, &copy, shown, saves, stop] {
                if (shown) write_panel(copy, *shown);
                if (saves || stop) save(copy);
            });
            if (!stop) continue;
            files.wait();
            tell_stopped();
            return false;
        }
        files.wait();
        tell_density();
        held_ = static_cast<double>(steps->memory().sum());
        taken_ = device_->free - find_device().found.value_or(*device_).free;
        if (!quiet(options_))
            std::printf(
                "device memory held: %.3f GB (%.3f GB less are free than before stage 1, "
                "for graphs, kernels and other programs too); waited %.1f s for panels and "
                "checkpoints\n",
                held_ / 1e9, taken_ / 1e9, files.waited());
        return true;
    }

    /// Prints the memory that stage 2 needs, now that its Gaussians are counted; returns how it
    /// uses the device. Throws an Error if the device has less.
    DeviceStepSettings settings_on_device() {
        DeviceStepSettings settings = settings_of(options_, ranks_);
        const DeviceFacts device = device_of(options_, find_device().found.value_or(*device_));
        const bool lpips = !options_.perceptual_weights.empty();
        const DeviceNeed need = device_need(state_, capture_, lpips, device, settings);
        stated_ = need.sum();
        if (!quiet(options_))
            std::cout << "stage 2 needs " << text_of(need) << "\n" << std::flush;
        require_device_room(need, device, options_.out.string(),
                            "; stage 1 is kept, and `rye train --begin " + options_.out.string() +
                                "` with lower fields goes on from it");
        return settings;
    }

    void write_panel(const TrainState& state, const AvatarSample<float>& sample) {
        const std::string number = std::to_string(state.step);
        const std::string name = "step_" + std::string(7 - std::min<std::size_t>(7, number.size()), '0') +
                                 number + ".png";
        folder_->panel(name, [&] {
            const int factor = 1 << state.config.gaussians.upsampler.doublings;
            const Pinhole<float> full = scaled(sample.camera, factor);
            const AvatarView v =
                render_avatar(drawn_state(state), {sample.drivers, full}, true);
            const int width = sample.truth.width;
            return side_by_side({sample.truth, v.high, enlarged(rgb_of(v.final), width),
                                 enlarged(rgb_of(v.face), width),
                                 enlarged(rgb_of(v.eyes), width)});
        });
    }

    const TrainOptions& options_;
    std::optional<DeviceFacts> device_;
    Capture capture_;
    TrainState state_;
    Random random_;
    TetGrid<float> grid_;
    Ranks* ranks_;                    ///< null: one
    std::optional<RunFolder> folder_; ///< of rank 0
    TimeProbe probe_;
    int skipped_ = 0;
    bool has_mesh_ = false;        ///< true if stage 1 is another run's
    int changes_ = 0;              ///< changes of density since this program began
    DensityChange changed_;        ///< sum of these changes
    double stated_ = 0, held_ = 0, taken_ = 0; ///< device memory of stage 2 [bytes]

  public:
    /// Returns the parts of the training: name, calls, milliseconds per call, their median, share of
    /// the time.
    Json profile() const {
        double all = 0;
        for (const auto& [name, part] : probe_.parts()) all += part.seconds;
        Json parts = Json::array();
        for (const auto& [name, part] : probe_.parts())
            parts.push_back({{"part", name},
                             {"calls", part.calls},
                             {"ms", 1e3 * part.seconds / static_cast<double>(part.calls)},
                             {"median_ms", 1e3 * part.median()},
                             {"share", part.seconds / all}});
        return parts;
    }
    Json summary(bool done) const {
        Json result{{"run", options_.out.string()},
                    {"done", done},
                    {"device", device_ ? device_->name : "cpu"},
                    {"stage", state_.stage == Stage::mesh ? "mesh" : "avatar"},
                    {"step", state_.step}};
        if (held_ > 0)
            result["device_memory"] = {{"stated", stated_}, {"held", held_}, {"taken", taken_}};
        if (options_.profile) result["profile"] = profile();
        return result;
    }
};

void print_profile(const Json& parts) {
    std::printf("%-22s %10s %10s %10s %7s\n", "part", "calls", "ms a call", "median", "share");
    for (const Json& part : parts)
        std::printf("%-22s %10td %10.3f %10.3f %6.1f%%\n", part["part"].get<std::string>().c_str(),
                    part["calls"].get<std::ptrdiff_t>(), part["ms"].get<double>(), part["median_ms"].get<double>(),
                    100 * part["share"].get<double>());
}

TrainConfig config_of(const TrainOptions& o) {
    TrainConfig config = preset(o.preset);
    if (!o.config.empty()) {
        try {
            from_json(read_json<nlohmann::ordered_json>(o.config, JsonComments::skipped),
                      o.config.string(), config);
        } catch (const nlohmann::json::exception& e) {
            throw Error(o.config.string() + ": " + e.what());
        }
    }
    if (o.seed) config.seed = parsed_seed(*o.seed, "--seed");
    take_steps(o, config);
    return config;
}

/// Device or CPU for stage 2.
struct TrainedOn {
    std::optional<DeviceFacts> device; ///< none for the CPU
    std::string words;                 ///< a line about it, or empty
};

/// Returns the choice by --device and the policy; throws an Error if the device has too little
/// memory.
TrainedOn trained_on(const TrainOptions& o, const TrainState& state, const Capture& capture,
                     Ranks* ranks) {
    if (device_wish(o.device) == DeviceWish::cpu) return {};
    const DeviceFinding finding = find_device();
    const DeviceDecision decision = decided(device_wish(o.device), state.config, finding);
    if (!decision.device)
        return {std::nullopt, decision.reason.empty()
                                  ? ""
                                  : "stage 2 is trained on the CPU: " + decision.reason};
    DeviceStepSettings settings = settings_of(o, ranks);
    const DeviceFacts device = device_of(o, *finding.found);
    const DeviceNeed need =
        device_need(state, capture, !o.perceptual_weights.empty(), device, settings);
    require_device_room(need, device,
                        o.config.empty() ? "--preset " + state.config.preset : o.config.string());
    return {finding.found, "stage 2 is trained on " + device.name + ": " + text_of(need)};
}

/// Checks that the checkpoint in the folder fits the options and the capture.
void check_resumed(const TrainOptions& o, const TrainState& state, const Capture& capture) {
    const std::string who = capture.folder.string();
    if (!o.config.empty()) {
        const TrainConfig config = config_of(o);
        require(config.gaze_axis == state.config.gaze_axis, o.config.string(),
                "field 'gaze_axis': differs from that of the run in ", o.out.string(),
                ", whose checkpoint has a kappa or has none");
        const auto same = [&](const char* field, const auto& got, const auto& begun) {
            require(
                got == begun, o.config.string(), "field 'avatar.", field, "': got \"",
                [&] { return word_of(got); }, "\", expected \"", [&] { return word_of(begun); },
                "\", as the run in ", o.out.string(), " began with");
        };
        same("eye_appearance", config.eye_appearance, state.config.eye_appearance);
        same("shading", config.shading, state.config.shading);
        same("gaze_mechanism", config.gaze_mechanism, state.config.gaze_mechanism);
        require(config.view_color == state.config.view_color, o.config.string(),
                "field 'avatar.view_color': got ", config.view_color, ", expected ",
                state.config.view_color, ", as the run in ", o.out.string(), " began with");
    }
    require(state.train_frames == capture.train, who,
            "its training frames differ from those this run began with");
    const Index views = state.avatar.delta_view.cols();
    require(views == 0 || views == capture.camera_count(), who, "got ", capture.camera_count(),
            " cameras, expected ", views, ", as this run corrects");
    require_same_subject(state, capture);
    const Index landmarks = frame_landmarks(capture, capture.train.front()).cols();
    require(landmarks == state.subject.neutral.cols(), who, "got ", landmarks,
            " landmarks and vertices, expected ", state.subject.neutral.cols(),
            ", as this run began with");
}

/// Returns the initial state of a run.
TrainState first_state(const TrainConfig& config, const Capture& capture,
                       const std::filesystem::path& folder) {
    TrainState state;
    state.config = config;
    state.config.avatar.expression = capture.expression_width();
    choose_doublings(state.config, capture.width, capture.height);
    require_gazes(capture, config.gaze_axis);
    state.capture = folder.string();
    state.subject = describe_subject(capture, state.config);
    state.train_frames = capture.train;
    state.view_directions = view_directions(capture);
    return state;
}

/// Returns a sentence about the doublings that a run's photographs led to.
std::string words_of_doublings(const TrainConfig& config, const Capture& capture) {
    const int doublings = config.gaussians.upsampler.doublings;
    const auto side = [&](int full) {
        return std::to_string((full + (1 << doublings) - 1) >> doublings);
    };
    return "stage 2 draws at " + side(capture.width) + " x " + side(capture.height) +
           " pixels: gaussians.upsampler.doublings is " + std::to_string(doublings);
}

/// Inputs of a run, read and checked, and what is told about them.
struct Start {
    TrainState state;
    Capture capture;
    LabelFindings labels;            ///< about labels and colours, which are corrected
    CameraFindings cameras;          ///< about cameras, which are corrected
    std::vector<std::string> expect; ///< warnings
    std::vector<std::string> words;  ///< lines about what the capture changes in the configuration
    TimeProbe times;                 ///< of the corrections
};

/// Corrects what the configuration says of the capture's labels, cameras and colours.
void correct(const TrainConfig& config, Start& s) {
    if (!s.capture.has_gaze()) return;
    s.times.start();
    if (config.correct_cameras) {
        s.cameras = correct_cameras(s.capture, config);
        s.times("camera correction");
    }
    if (config.correct_labels) {
        s.labels = correct_labels(s.capture, config);
        s.times("label correction");
    }
    if (config.correct_colours) {
        for (LabelFinding& f : correct_colours(s.capture, config))
            s.labels.all.push_back(std::move(f));
        s.times("colour correction");
    }
}

Start read_start(const TrainOptions& o) {
    Start s;
    std::filesystem::path folder = o.capture;
    if (o.resume) {
        s.state = load_checkpoint(o.out);
        folder = capture_folder(o.out, s.state, folder, "training");
        take_steps(o, s.state.config);
    }
    require(!folder.empty(), "rye train", "--capture is missing, expected the folder of a capture");
    const TrainConfig config = o.resume ? s.state.config : config_of(o);
    s.capture = read_trainable_capture(folder, &s.expect);
    correct(config, s);
    if (o.resume) {
        check_resumed(o, s.state, s.capture);
        s.state.view_directions = view_directions(s.capture);
        return s;
    }
    s.state = first_state(config, s.capture, folder);
    s.words.push_back(refine_further(s.labels, s.state.config));
    s.words.push_back(refine_further(s.cameras, s.capture, s.state.config));
    s.words.push_back(flatten_for_one_camera(s.capture, s.state.config));
    if (config.gaussians.auto_doublings)
        s.words.push_back(words_of_doublings(s.state.config, s.capture));
    return s;
}

/// Sets the mesh that a new run begins with: that of --begin, or one of random numbers.
void begin_mesh(const TrainOptions& o, TrainState& state) {
    if (!o.begin.empty()) return take_stage_one(o.begin, state);
    state.mesh = Mesh::init(state.config.avatar, state.subject.neutral.cast<float>(),
                            Random{state.config.seed, 0});
    state.mesh_adam = Adam<Mesh>(state.mesh);
}

/// Prints what is told of a start, and the lines of `more`.
void tell(const TrainOptions& o, const Start& s, const std::string& preset,
          const std::vector<std::string>& more) {
    for (const std::string& words : s.expect) std::cerr << "rye: warning: " << words << "\n";
    if (preset.starts_with("paper") && o.perceptual_weights.empty())
        std::cerr << "rye: note: the loss is not the paper's: without --perceptual-weights its "
                     "VGG16 term is replaced by one of gradient pyramids\n";
    if (quiet(o)) return;
    for (const auto& lines : {s.cameras.lines(), s.labels.lines(), s.words, more})
        for (const std::string& line : lines)
            if (!line.empty()) std::cout << line << "\n";
}

void log_findings(const Start& s, Trainer& trainer) {
    if (s.labels.empty() && s.cameras.empty()) return;
    Json line = {{"stage", "labels"}, {"step", 0}};
    if (!s.labels.empty()) line.update(s.labels.json());
    if (!s.cameras.empty()) line["cameras"] = s.cameras.json();
    trainer.log(line);
}

/// Trains on one rank of a group, or alone if `ranks` is null.
int train_as(const TrainOptions& o, Ranks* ranks) {
    const bool first = first_of(ranks);
    const LockOptions as_training{"rye train"};
    std::optional<FolderLock> lock; // taken before the folder is read
    if (first && std::filesystem::is_directory(o.out)) lock.emplace(o.out, as_training);
    const bool there = std::filesystem::exists(checkpoint_path(o.out));
    require(!first || !there || o.resume || o.overwrite, o.out.string(),
            "holds a run already; --resume continues it, --overwrite replaces it");
    require(!o.resume || !o.overwrite, "rye train",
            "--resume and --overwrite exclude each other");
    require(!o.resume || o.begin.empty(), "rye train",
            "--resume and --begin exclude each other: a run goes on from its own checkpoint");
    // Checks all inputs before writing anything.
    Start start = read_start(o);
    const std::string preset = start.state.config.preset;
    const RunSize size = run_size(start.state.config, start.state.subject, start.capture.width,
                                  start.capture.height);
    require_room(size, machine_memory(), o.config.empty() ? "--preset " + preset : o.config.string());
    check_perceptual_weights(o.perceptual_weights);
    static_cast<void>(share_of(start.state.config, ranks)); // throws if there are too few views
    const TrainedOn on = trained_on(o, start.state, start.capture, ranks);
    require(on.device || ranks == nullptr || ranks->threads() != nullptr, "--ranks", "got ",
            o.ranks, ", but stage 2 is trained on the CPU, where ranks are threads of one process: "
            "expected a number");
    const std::string mark = frames_mark(start.capture);
    const bool other_frames = o.resume && start.state.frames != mark;
    start.state.frames = mark;
    if (!o.resume) begin_mesh(o, start.state);
    if (first && !lock) {
        make_run_folder(o.out);
        lock.emplace(o.out, as_training);
        require(!std::filesystem::exists(checkpoint_path(o.out)), o.out.string(),
                "holds a run since a moment ago, of another training");
    }
    ignore_file_size_signal();
    std::optional<ViewedTraining> view;
    if (first && o.view >= 0) view.emplace(o.out, o.view);
    Trainer trainer(o, on.device, std::move(start.capture), std::move(start.state),
                    std::move(start.times),
                    o.resume ? Beginning::resumed
                    : there  ? Beginning::replacing
                             : Beginning::fresh,
                    ranks);
    // After all checks that may fail: an error is one line.
    if (first) tell(o, start, preset, {text_of(size), on.words});
    if (!o.resume) log_findings(start, trainer);
    if (!o.begin.empty()) trainer.begin_after(o.begin);
    if (other_frames) trainer.save(); // to match the frames now beside it
    for (const int signal : stop_signals) std::signal(signal, request_stop);
    if (view) std::cerr << "rye: note: shown at " << view->address() << "\n";
    const bool done = trainer.run();
    view.reset();
    if (!first) return done ? 0 : code_of_stop(stop_requested);
    if (o.json) std::cout << trainer.summary(done).dump(2) << "\n";
    else if (o.profile) print_profile(trainer.profile());
    if (done && !quiet(o))
        std::cout << "done: " << checkpoint_path(o.out).string() << "\npanels: "
                  << (o.out / "panels").string()
                  << " (truth, final, low resolution, face over white eyeballs, eyes alone)\n";
    return done ? 0 : code_of_stop(stop_requested);
}

/// Returns the options of a rank: only rank 0 speaks.
TrainOptions options_of(const TrainOptions& o, const Ranks& ranks) {
    TrainOptions own = o;
    own.quiet = own.quiet || ranks.rank() != 0;
    own.json = own.json && ranks.rank() == 0;
    return own;
}

/// Trains on ranks in threads of this process: on a device each, or on the CPU.
int train_in_threads(const TrainOptions& o, int size) {
    const bool on_devices = device_wish(o.device) != DeviceWish::cpu && device_count() > 0;
    require(!on_devices || size <= device_count(), "--ranks", "got ", size, ", there are ",
            device_count(), " devices");
    int code = 0;
    run_ranks(size, [&](ThreadGroup& group) {
        RanksInThreads ranks(group);
        if (on_devices) use_device(group.rank());
        const int own = train_as(options_of(o, ranks), &ranks);
        if (group.rank() == 0) code = own;
    });
    return code;
}

/// Trains on this process's rank of those that a launcher has started.
int train_as_process(const TrainOptions& o) {
    const LaunchedRank place = launched_by(o.ranks);
    RanksInProcesses ranks(o.out, place);
    try {
        if (const int devices = device_count(); devices > 0) use_device(place.local % devices);
        return train_as(options_of(o, ranks), &ranks);
    } catch (const std::exception& e) {
        ranks.leave(e.what());
        throw;
    }
}

int train(const TrainOptions& o) {
    if (o.print_config) {
        std::cout << to_json(config_of(o)).dump(2) << "\n";
        return 0;
    }
    require(!o.out.empty(), "rye train", "--out is missing, expected a folder for the run");
    set_threads(o.threads);
    if (is_launcher(o.ranks)) return train_as_process(o);
    const int ranks = parsed_ranks(o.ranks, "--ranks");
    return ranks == 1 ? train_as(o, nullptr) : train_in_threads(o, ranks);
}

} // namespace

void add_train(CLI::App& app) {
    auto options = std::make_shared<TrainOptions>();
    CLI::App* c = app.add_subcommand("train", "Train a gaze-redirectable head avatar from a capture");
    c->add_option("--capture", options->capture, "Folder of the capture (see `rye info`)")
        ->check(folder_check("the folder of a capture (`rye info` checks one)"));
    c->add_option("--out", options->out, "Folder of the run: checkpoint, log.jsonl, panels");
    c->add_option("--preset", options->preset,
                  "tiny: minutes on two cores; cpu: below an hour; gpu: 512 x 512 pixels, on a "
                  "large device; paper: the paper's method; paper-literal: its numbers as they "
                  "stand, whatever the capture's size, cameras and unit")
        ->check(CLI::IsMember(preset_names()))
        ->capture_default_str();
    add_device(*c, options->device,
               "Where stage 2 is trained; auto: a CUDA device where this build has kernels, a "
               "device is there and they are of the configuration's parts");
    c->add_option("--config", options->config,
                  "JSON file whose fields replace the preset's (see --print-config)");
    c->add_flag("--print-config", options->print_config,
                "Print the effective configuration, every field of it, and stop");
    c->add_option("--steps", options->steps, "Steps of stage 2, instead of the configuration's");
    c->add_option("--seed", options->seed, "Seed of all randomness: any whole number below 2^64")
        ->check(read_check(parsed_seed));
    add_memory(*c);
    add_threads(*c, options->threads, "Threads; results do not depend on it (0: all)");
    c->add_option("--perceptual-weights", options->perceptual_weights,
                  "VGG16 + LPIPS weights, a safetensors file that cmake/convert_lpips_weights.py writes; "
                  "without it the weight-free gradient-pyramid loss is used");
    c->add_option("--begin", options->begin,
                  "Folder of a run whose stage 1 is taken over: same capture, seed and fields that "
                  "stage 1 reads")
        ->check(folder_check("the folder of a run in stage 2"));
    c->add_flag("--resume", options->resume, "Go on from the run's checkpoint, bit for bit");
    c->add_flag("--overwrite", options->overwrite, "Replace a run that is in --out");
    c->add_flag("--profile", options->profile, "Print where the time went");
    c->add_flag("--json", options->json,
                "Print what was done, and the --profile, as JSON instead of progress");
    c->add_flag("--quiet", options->quiet, "No progress line");
    c->add_option("--view", options->view,
                  "Show the head while it trains, as `rye view` does, on this port of 127.0.0.1 (0: a "
                  "free one); checkpoints are shown as they are written")
        ->check(from_to(0, 65535));
    c->add_option("--ranks", options->ranks,
                  "Ranks that train together, each on its share of gaussians.views pictures a step: a "
                  "number of them in this process, each on a device of its own where there are some; "
                  "or torchrun, mpi or slurm where that starts a process for each")
        ->check(read_check([](const std::string& text, const std::string& who) {
            return is_launcher(text) ? 0 : parsed_ranks(text, who);
        }))
        ->capture_default_str();
    c->add_option("--rank-sum", options->rank_sum,
                  "How ranks on devices add up: tree, with the same bits for 1, 2, 4, ... ranks, or "
                  "nccl, in NCCL's own order, which promises none")
        ->check(CLI::IsMember({"tree", "nccl"}))
        ->capture_default_str();
    c->add_option_function<std::string>(
         "--device-memory",
         [options](const std::string& text) {
             options->device_memory = static_cast<double>(parsed_memory(text, "--device-memory"));
         },
         "The most memory of the device that stage 2 plans with: 512M, 8G (default: what is free); "
         "pictures that do not fit stay in the host's memory and are fetched beside the steps")
        ->check(read_check(parsed_memory));
    c->callback([options] {
        const int code = train(*options);
        if (code != 0) throw CLI::RuntimeError(code);
    });
}

} // namespace rye::trainer
