// SPDX-License-Identifier: Apache-2.0
/// `rye compare`: trains and evaluates lists of configurations by `rye train` and `rye evaluate`,
/// for several seeds and captures, and writes their tables. Keeps existing results.
#include <algorithm>
#include <cstdio>
#include <iostream>
#include <map>
#include <memory>
#include <span>
#include <thread>

#include <CLI/CLI.hpp>

#include <rye/capture/atomic_file.hpp>

#include "commands/child_jobs.hpp"
#include "commands/commands.hpp"
#include "commands/compare_tables.hpp"
#include "commands/options.hpp"
#include "data/config_difference.hpp"
#include "data/checksums.hpp"
#include "data/experiments.hpp"
#include "data/folder_lock.hpp"
#include "data/json.hpp"
#include "data/system.hpp"
#include "training/begun.hpp"
#include "training/device_choice.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

struct CompareOptions {
    std::vector<std::string> tables, captures, seeds;
    fs::path list, out, config, perceptual_weights;
    std::string preset, split = "test", device = "auto", memory;
    std::optional<std::int64_t> steps;
    int jobs = 1, threads = 0;
    bool json = false, quiet = false, print_list = false;
};

void write_text(const fs::path& path, const std::string& text) {
    write_atomic(path, std::as_bytes(std::span(text)));
}

/// Configuration, seed and capture, which rows of several tables may share.
struct PlannedRun {
    fs::path folder, capture_folder;
    std::string capture, name; ///< for messages
    TrainConfig config;
    std::string failure;
    const PlannedRun* first = nullptr; ///< run whose stage 1 it shares; null: its own
    bool ended = false;                ///< true also if there was nothing to do
};

class Comparison {
  public:
    explicit Comparison(const CompareOptions& o) : o_(o) {
        experiments_ = experiments();
        for (Experiment& e : experiments_) {
            ExperimentSettings settings{o.preset, base(), "", 1};
            settings.base_source = o.config.empty() ? "--steps" : o.config.string();
            configure(e, settings);
        }
    }
    const std::vector<Experiment>& all() const { return experiments_; }

    /// Runs the command; returns the exit code.
    int run() {
        require(!o_.out.empty(), "rye compare",
                "--out is missing, expected a folder for runs and tables");
        plan();
        std::error_code fault;
        fs::create_directories(o_.out, fault);
        require(!fault, o_.out.string(), "cannot be made: ", [&] { return fault.message(); });
        // Children hold it too, so that it waits for a training whose parent was killed.
        const FolderLock lock(o_.out, {"rye compare", 30, true});
        for (const auto& [folder, run] : runs_) check_there(run);
        share_stage_one();
        std::vector<ChildJob> jobs;
        std::vector<PlannedRun*> of_job;
        for (const fs::path& folder : order_) {
            PlannedRun& run = runs_.at(folder);
            run.ended = is_complete(run);
            if (run.ended) continue;
            jobs.push_back(job_of(run));
            of_job.push_back(&run);
        }
        const auto own =
            std::count_if(jobs.begin(), jobs.end(), [](const ChildJob& job) { return !job.ready; });
        say(std::to_string(runs_.size()) + " runs, " + std::to_string(jobs.size()) +
            " of them to do, " + std::to_string(o_.jobs) + " at once; stage 1 is trained for " +
            std::to_string(own));
        write_tables(false);
        std::size_t done = 0;
        const int signal =
            run_children(jobs, o_.jobs, [&](std::size_t i, const ChildResult& result) {
                PlannedRun& run = *of_job[i];
                run.ended = true;
                const std::string place =
                    "[" + std::to_string(++done) + "/" + std::to_string(jobs.size()) + "] ";
                if (result.code == 0) {
                    write_text(complete_path(run), checked_text(completion(), -1));
                    say(place + run.name + ": " +
                        std::to_string(static_cast<std::int64_t>(result.seconds)) + " s");
                } else {
                    run.failure = result.message.empty()
                                      ? "ended with code " + std::to_string(result.code)
                                      : result.message;
                    std::cerr << "rye compare: " << place << run.name << ": " << run.failure
                              << "\n";
                }
                write_tables(false);
            });
        if (signal != 0) {
            std::cerr << "rye compare: stopped; the same command goes on\n";
            return code_of_stop(signal);
        }
        write_tables(true);
        if (o_.json) std::cout << json().dump(2) << "\n";
        const auto failed = std::count_if(runs_.begin(), runs_.end(),
                                          [](const auto& r) { return !r.second.failure.empty(); });
        require(failed == 0, o_.out.string(), failed, " of ", runs_.size(),
                " runs failed; the tables name them, and their last words are in log.txt.errors "
                "of their folders");
        return 0;
    }

  private:
    std::vector<Experiment> experiments() const {
        std::vector<Experiment> all;
        for (const std::string& table : o_.tables) all.push_back(built_in_experiment(table));
        if (!o_.list.empty()) all.push_back(read_experiment(o_.list));
        require(!all.empty(), "rye compare",
                "got neither --table nor --list, expected a table to make");
        for (std::size_t i = 0; i < all.size(); ++i)
            for (std::size_t k = 0; k < i; ++k)
                require(all[i].name != all[k].name, "rye compare", "got two tables named '",
                        all[i].name, "'");
        return all;
    }

    /// Returns the fields that --config and --steps give all rows.
    Json base() const {
        Json json;
        if (!o_.config.empty()) json = read_json<Json>(o_.config, JsonComments::skipped);
        if (o_.steps) json["gaussians"]["steps"] = *o_.steps;
        return json;
    }

    std::vector<fs::path> captures_of(const Experiment& e) const {
        std::vector<fs::path> captures = e.captures;
        if (!o_.captures.empty()) captures.assign(o_.captures.begin(), o_.captures.end());
        require(!captures.empty(), "rye compare",
                "--capture is missing, expected the folder of a capture");
        for (const fs::path& c : captures)
            require(fs::is_directory(c), e.name, "field 'captures': got '", c.string(),
                    "', which is no folder");
        return captures;
    }

    std::vector<std::uint64_t> seeds_of(const Experiment& e) const {
        std::vector<std::uint64_t> seeds = e.seeds;
        if (!o_.seeds.empty()) seeds.clear();
        for (const std::string& s : o_.seeds) seeds.push_back(parsed_seed(s, "--seeds"));
        if (seeds.empty()) seeds = {1, 2, 3};
        return seeds;
    }

    static std::string name_of(const fs::path& capture) {
        fs::path whole = fs::weakly_canonical(capture);
        if (!whole.has_filename()) whole = whole.parent_path();
        return folder_name(whole.filename().string());
    }

    /// Returns the folder of a row's run.
    fs::path folder_of(const std::string& capture, const ExperimentRow& row,
                       std::uint64_t seed) const {
        return o_.out / "runs" / capture / row.run / ("seed_" + std::to_string(seed));
    }

    void plan() {
        std::map<std::string, fs::path> names;
        for (const Experiment& e : experiments_)
            for (const std::uint64_t seed : seeds_of(e))
                for (const fs::path& capture : captures_of(e)) {
                    const std::string name = name_of(capture);
                    const fs::path whole = fs::weakly_canonical(capture);
                    const auto [known, fresh] = names.try_emplace(name, whole);
                    require(fresh || known->second == whole, "--capture",
                            "got two captures named '", name, "': ", known->second.string(),
                            " and ", whole.string());
                    for (const ExperimentRow& row : e.rows) {
                        PlannedRun run{folder_of(name, row, seed),
                                       capture,
                                       name,
                                       row.name + ", " + name + ", seed " + std::to_string(seed),
                                       row.effective,
                                       ""};
                        run.config.seed = seed;
                        const auto [there, added] = runs_.try_emplace(run.folder, run);
                        if (added) order_.push_back(run.folder);
                        require(to_json(there->second.config) == to_json(run.config), e.name,
                                "row '", row.name, "': its run '", row.run,
                                "' is that of another table, whose configuration differs: ", [&] {
                                    return first_difference(to_json(run.config),
                                                            to_json(there->second.config));
                                });
                    }
                }
    }

    /// Throws an Error if the folder holds a run of another configuration.
    void check_there(const PlannedRun& run) const {
        const fs::path config = run.folder / "config.json";
        if (!fs::exists(checkpoint_path(run.folder)) || !fs::exists(config)) return;
        TrainConfig there = preset("paper-literal"); // of fields that the file lacks
        from_json(read_json<Json>(config), config.string(), there);
        TrainConfig wanted = run.config;
        if (wanted.gaussians.auto_doublings) { // a run has their number
            wanted.gaussians.auto_doublings = there.gaussians.auto_doublings;
            wanted.gaussians.upsampler.doublings = there.gaussians.upsampler.doublings;
        }
        const std::string difference = first_difference(to_json(there), to_json(wanted));
        require(difference.empty(), config.string(), difference,
                ", as this table has it; name another --out, or remove that run");
    }

    /// Lets runs that agree in all fields that stage 1 reads share it: that of the first run that
    /// has one, or else of the first run.
    void share_stage_one() {
        std::map<std::string, std::vector<PlannedRun*>> groups;
        for (const fs::path& folder : order_) {
            PlannedRun& run = runs_.at(folder);
            // Runs without kernels have the CPU's stage 1.
            const bool on_device =
                has_device_kernels() && o_.device != "cpu" && without_kernels(run.config).empty();
            groups[run.capture + (on_device ? " on a device " : " ") +
                   stage_one_fields(run.config).dump()]
                .push_back(&run);
        }
        for (const auto& [key, group] : groups) {
            const auto found = std::find_if(group.begin(), group.end(), [](const PlannedRun* r) {
                return has_stage_one(r->folder);
            });
            PlannedRun* const first = found == group.end() ? group.front() : *found;
            for (PlannedRun* run : group)
                if (run != first) run->first = first;
        }
    }

    fs::path evaluation_folder(const fs::path& run) const {
        return run / ("evaluation_" + o_.split);
    }
    fs::path complete_path(const PlannedRun& run) const {
        return evaluation_folder(run.folder) / "complete.json";
    }
    Json completion() const { return {{"perceptual_weights", o_.perceptual_weights.string()}}; }

    static Json read_checked(const fs::path& path) {
        return parse_checked_json(as_text(read_file(path, max_json_bytes)), path.string());
    }
    bool is_complete(const PlannedRun& run) const {
        const fs::path path = complete_path(run);
        return fs::exists(path) && fs::exists(checkpoint_path(run.folder)) &&
               read_checked(path) == completion();
    }

    ChildJob job_of(const PlannedRun& run) const {
        std::error_code fault;
        fs::create_directories(run.folder, fault);
        require(!fault, run.folder.string(), "cannot be made: ", [&] { return fault.message(); });
        const fs::path config = run.folder / "wanted.json";
        write_text(config, to_json(run.config).dump(2) + "\n");
        const int all = static_cast<int>(std::thread::hardware_concurrency());
        const std::string threads = std::to_string(
            o_.threads > 0 || o_.jobs == 1 ? o_.threads : std::max(1, all / o_.jobs));
        std::vector<std::string> train{"train",
                                       "--capture",
                                       run.capture_folder.string(),
                                       "--out",
                                       run.folder.string(),
                                       "--quiet",
                                       "--threads",
                                       threads};
        std::vector<std::string> evaluate{"evaluate",
                                          "--run",
                                          run.folder.string(),
                                          "--capture",
                                          run.capture_folder.string(),
                                          "--split",
                                          o_.split,
                                          "--out",
                                          evaluation_folder(run.folder).string(),
                                          "--threads",
                                          threads};
        if (o_.device != "auto")
            for (std::vector<std::string>* words : {&train, &evaluate})
                words->insert(words->end(), {"--device", o_.device});
        if (!o_.memory.empty())
            for (std::vector<std::string>* words : {&train, &evaluate})
                words->insert(words->end(), {"--memory", o_.memory});
        const bool resumes = fs::exists(checkpoint_path(run.folder));
        if (resumes)
            train.push_back("--resume");
        else
            train.insert(train.end(), {"--preset", run.config.preset, "--config", config.string()});
        if (!o_.perceptual_weights.empty())
            for (std::vector<std::string>* words : {&train, &evaluate})
                words->insert(words->end(),
                              {"--perceptual-weights", o_.perceptual_weights.string()});
        ChildJob job{run.name, {train, evaluate}, run.folder / "log.txt"};
        if (!resumes && run.first != nullptr)
            job.ready = [first = run.first](ChildJob& own) {
                const bool there = has_stage_one(first->folder);
                if (there)
                    own.commands.front().insert(own.commands.front().end(),
                                                {"--begin", first->folder.string()});
                return there || first->ended; // failed: this run trains its own
            };
        return job;
    }

    std::vector<ComparedRun> results_of(const Experiment& e) const {
        std::vector<ComparedRun> all;
        for (std::size_t row = 0; row < e.rows.size(); ++row)
            for (const fs::path& capture : captures_of(e))
                for (const std::uint64_t seed : seeds_of(e)) {
                    const std::string name = name_of(capture);
                    const PlannedRun& run = runs_.at(folder_of(name, e.rows[row], seed));
                    ComparedRun c{row,     name,       seed, evaluation_folder(run.folder),
                                  nullptr, run.failure};
                    if (run.failure.empty() && is_complete(run))
                        c.results = read_results(evaluation_folder(run.folder));
                    all.push_back(c);
                }
        return all;
    }

    void write_tables(bool last) const {
        for (const Experiment& e : experiments_) {
            const std::vector<ComparedRun> results = results_of(e);
            const ExperimentTables tables(e, results);
            std::string text = tables.markdown();
            if (last)
                for (const fs::path& capture : captures_of(e))
                    text += write_sheet(e, results, name_of(capture));
            write_text(o_.out / (e.name + ".md"), text);
            write_text(o_.out / (e.name + ".csv"), tables.csv());
            write_text(o_.out / (e.name + "_runs.csv"), tables.runs_csv());
            if (last && !o_.json)
                std::cout << text << "\n" << (o_.out / (e.name + ".md")).string() << "\n";
        }
    }

    /// Writes the sheet; returns the table's text about it, or nothing without a picture.
    std::string write_sheet(const Experiment& e, const std::vector<ComparedRun>& results,
                            const std::string& capture) const {
        const ContactSheet sheet = contact_sheet(e, results, capture, "evaluate_" + o_.split);
        if (sheet.picture.size() == 0) return "";
        const std::string file = e.name + "_" + capture + ".png";
        write_png(o_.out / file, sheet.picture);
        std::string columns, frames;
        for (const std::string& c : sheet.columns) columns += (columns.empty() ? "" : ", ") + c;
        for (const std::string& f : sheet.frames) frames += (frames.empty() ? "" : ", ") + f;
        return "\n![" + e.title + ", " + capture + "](" + file + ")\n\nFrom the left: " + columns +
               ". From the top: " + frames + ".\n";
    }

    Json json() const {
        Json all = Json::array();
        for (const Experiment& e : experiments_)
            all.push_back(ExperimentTables(e, results_of(e)).json());
        return {{"split", o_.split}, {"experiments", all}};
    }

    void say(const std::string& line) const {
        if (!o_.quiet && !o_.json) std::cout << line << "\n" << std::flush;
    }

    const CompareOptions& o_;
    std::vector<Experiment> experiments_;
    std::map<fs::path, PlannedRun> runs_;
    std::vector<fs::path> order_;
};

int compare(const CompareOptions& o) {
    Comparison comparison(o);
    if (!o.print_list) return comparison.run();
    require(comparison.all().size() == 1, "--print-list", "got ", comparison.all().size(),
            " tables, expected one");
    std::cout << to_json(comparison.all().front()).dump(2) << "\n";
    return 0;
}

} // namespace

void add_compare(CLI::App& app) {
    auto o = std::make_shared<CompareOptions>();
    CLI::App* c = app.add_subcommand(
        "compare", "Train configurations side by side and tabulate what they are worth");
    c->add_option("--table", o->tables,
                  "Built-in list of configurations: gaze mechanisms, losses, deformation by gaze; "
                  "more than one with commas")
        ->delimiter(',')
        ->check(CLI::IsMember(built_in_experiments()));
    c->add_option("--list", o->list, "JSON file of a list of configurations (see --print-list)")
        ->check(CLI::ExistingFile);
    c->add_option("--capture", o->captures, "Folder of a capture; more than one with commas")
        ->delimiter(',');
    c->add_option("--out", o->out, "Folder for runs and tables; what is there is kept");
    c->add_option("--seeds", o->seeds, "Seeds, with commas (default: those of the list, or 1,2,3)")
        ->check(read_check(parsed_seed))
        ->delimiter(',');
    c->add_option("--preset", o->preset, "Preset of all rows (default: that of the list, or cpu)")
        ->check(CLI::IsMember(preset_names()));
    c->add_option("--config", o->config,
                  "JSON file whose fields all rows have, unless the row replaces them");
    c->add_option("--steps", o->steps, "Steps of stage 2 of all rows");
    c->add_option("--split", o->split, "Frames to measure")
        ->check(CLI::IsMember({"test", "train", "novel", "independent"}))
        ->capture_default_str();
    add_device(
        *c, o->device,
        "Where stage 2 is trained and runs are drawn, as for `rye train` and `rye evaluate`");
    c->add_option("--jobs", o->jobs, "Runs at once")
        ->check(from_to(1, 64))
        ->capture_default_str();
    add_memory(*c);
    const CLI::Option* const memory = c->get_option("--memory");
    add_threads(*c, o->threads, "Threads of each run (0: the machine's, shared by the jobs)");
    c->add_option("--perceptual-weights", o->perceptual_weights,
                  "VGG16 + LPIPS weights, a safetensors file, for training and for LPIPS");
    c->add_flag("--json", o->json, "Print the tables as JSON instead of Markdown");
    c->add_flag("--quiet", o->quiet, "No line for each run that ends");
    c->add_flag("--print-list", o->print_list,
                "Print the list as JSON, as --list reads it, and stop");
    c->callback([o, memory] {
        if (memory->count() > 0) o->memory = memory->as<std::string>();
        const int code = compare(*o);
        if (code != 0) throw CLI::RuntimeError(code);
    });
}

} // namespace rye::trainer
