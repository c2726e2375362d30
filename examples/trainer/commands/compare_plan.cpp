// SPDX-License-Identifier: Apache-2.0
#include "commands/compare_plan.hpp"

#include <algorithm>
#include <span>
#include <thread>

#include <rye/io/atomic_file.hpp>

#include "commands/options.hpp"
#include "data/checksums.hpp"
#include "data/config_difference.hpp"
#include "data/json_fields.hpp"
#include "device/choice.hpp"
#include "training/begun.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

Json completion(const CompareOptions& o) {
    return {{"perceptual_weights", o.perceptual_weights.string()}};
}

} // namespace

fs::path whole_path(const fs::path& path) { return fs::absolute(path).lexically_normal(); }

void write_text(const fs::path& path, const std::string& text) {
    write_atomic(path, std::as_bytes(std::span(text)));
}

CompareLists lists_of(const CompareOptions& o) {
    CompareLists lists;
    std::vector<Experiment>& all = lists.experiments;
    for (const std::string& table : o.tables) all.push_back(built_in_experiment(table));
    if (!o.list.empty()) all.push_back(read_experiment(o.list));
    require(!all.empty(), "rye compare",
            "got neither --table nor --list, expected a table to make");
    for (std::size_t i = 0; i < all.size(); ++i)
        for (std::size_t k = 0; k < i; ++k)
            require(all[i].name != all[k].name, "rye compare", "got two tables named '",
                    all[i].name, "'");
    if (!o.config.empty()) lists.base = read_json<Json>(o.config, JsonComments::skipped);
    if (o.steps) lists.base["gaussians"]["steps"] = *o.steps;
    lists.base_source = o.config.empty() ? "--steps" : o.config.string();
    return lists;
}

ComparePlan::ComparePlan(CompareOptions options, CompareLists lists)
    : o_(std::move(options)),
      lists_(std::move(lists)) {
    for (Experiment& e : lists_.experiments)
        configure(e, {o_.preset, lists_.base, lists_.base_source, 1});
}

std::vector<fs::path> ComparePlan::captures_of(const Experiment& e) const {
    std::vector<fs::path> captures = e.captures;
    if (!o_.captures.empty()) captures.assign(o_.captures.begin(), o_.captures.end());
    require(!captures.empty(), "rye compare",
            "--capture is missing, expected the folder of a capture");
    for (const fs::path& c : captures)
        require(fs::is_directory(c), e.name, "field 'captures': got '", c.string(),
                "', which is no folder");
    return captures;
}

std::vector<std::uint64_t> ComparePlan::seeds_of(const Experiment& e) const {
    std::vector<std::uint64_t> seeds = e.seeds;
    if (!o_.seeds.empty()) seeds.clear();
    for (const std::string& s : o_.seeds) seeds.push_back(parsed_seed(s, "--seeds"));
    if (seeds.empty()) seeds = {1, 2, 3};
    return seeds;
}

std::string name_of(const fs::path& capture) {
    fs::path whole = fs::weakly_canonical(capture);
    if (!whole.has_filename()) whole = whole.parent_path();
    return folder_name(whole.filename().string());
}

fs::path ComparePlan::folder_of(const std::string& capture, const ExperimentRow& row,
                                std::uint64_t seed) const {
    return o_.out / "runs" / capture / row.run / ("seed_" + std::to_string(seed));
}

PlannedRun& ComparePlan::run_of(const std::string& capture, const ExperimentRow& row,
                                std::uint64_t seed) {
    return runs_.at(folder_of(capture, row, seed));
}

void ComparePlan::add_runs() {
    std::map<std::string, fs::path> names;
    for (const Experiment& e : lists_.experiments)
        for (const std::uint64_t seed : seeds_of(e))
            for (const fs::path& capture : captures_of(e)) {
                const std::string name = name_of(capture);
                const fs::path whole = fs::weakly_canonical(capture);
                const auto [known, fresh] = names.try_emplace(name, whole);
                require(fresh || known->second == whole, "--capture", "got two captures named '",
                        name, "': ", known->second.string(), " and ", whole.string());
                for (const ExperimentRow& row : e.rows) {
                    PlannedRun run{folder_of(name, row, seed),
                                   capture,
                                   name,
                                   row.name + ", " + name + ", seed " + std::to_string(seed),
                                   row.effective,
                                   ""};
                    run.config.seed = seed;
                    const auto [there, added] = runs_.try_emplace(run.folder, run);
                    if (added) order_.push_back(&there->second);
                    require(to_json(there->second.config) == to_json(run.config), e.name, "row '",
                            row.name, "': its run '", row.run,
                            "' is that of another table, whose configuration differs: ", [&] {
                                return first_difference(to_json(run.config),
                                                        to_json(there->second.config));
                            });
                }
            }
}

void ComparePlan::check_there(const PlannedRun& run) const {
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

void ComparePlan::share_stage_one() {
    std::map<std::string, std::vector<PlannedRun*>> groups;
    for (PlannedRun* const planned : order_) {
        PlannedRun& run = *planned;
        run.first = nullptr;
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

fs::path ComparePlan::evaluation_folder(const fs::path& run) const {
    return run / ("evaluation_" + o_.split);
}

fs::path ComparePlan::complete_path(const PlannedRun& run) const {
    return evaluation_folder(run.folder) / "complete.json";
}

bool ComparePlan::is_complete(const PlannedRun& run) const {
    const fs::path path = complete_path(run);
    if (!fs::exists(path) || !fs::exists(checkpoint_path(run.folder))) return false;
    const Json json = parse_checked_json(as_text(read_file(path, max_json_bytes)), path.string());
    // Tasks name the file by its whole path, wherever they run.
    const fs::path weights = json_text(json, "perceptual_weights", "", path.string());
    return weights == o_.perceptual_weights ||
           (!weights.empty() && !o_.perceptual_weights.empty() &&
            whole_path(weights) == whole_path(o_.perceptual_weights));
}

void ComparePlan::complete(const PlannedRun& run) const {
    write_text(complete_path(run), checked_text(completion(o_), -1));
}

ChildJob ComparePlan::job_of(const PlannedRun& run) const {
    std::error_code fault;
    fs::create_directories(run.folder, fault);
    require(!fault, run.folder.string(), "cannot be made: ", [&] { return fault.message(); });
    const fs::path config = run.folder / "wanted.json";
    write_text(config, to_json(run.config).dump(2) + "\n");
    const int all = static_cast<int>(std::thread::hardware_concurrency());
    const std::string threads =
        std::to_string(o_.threads > 0 || o_.jobs == 1 ? o_.threads : std::max(1, all / o_.jobs));
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
            words->insert(words->end(), {"--perceptual-weights", o_.perceptual_weights.string()});
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

} // namespace rye::trainer
