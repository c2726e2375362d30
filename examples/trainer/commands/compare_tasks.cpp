// SPDX-License-Identifier: Apache-2.0
#include "commands/compare_tasks.hpp"

#include <algorithm>
#include <chrono>
#include <iostream>
#include <map>
#include <memory>
#include <set>
#include <thread>
#include <utility>

#include <rye/core/checksum.hpp>

#include "commands/options.hpp"
#include "data/checksums.hpp"
#include "data/claim.hpp"
#include "data/json_fields.hpp"
#include "data/noted_stops.hpp"
#include "training/begun.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr int plan_version = 1;

fs::path plan_path(const fs::path& out) { return out / "plan.json"; }
fs::path failed_path(const PlannedRun& run) { return run.folder / "failed.json"; }

/// Returns what a plan says of a run.
Json task_json(const ComparePlan& plan, const PlannedRun& run) {
    return {{"run", run.folder.lexically_relative(plan.options().out).generic_string()},
            {"config", checksum_text(crc32(as_bytes(to_json(run.config).dump())))}};
}

/// Gives the runs the order of a file's tasks. Throws an Error, which ends in `advice`, if these
/// are others.
void order_as(ComparePlan& plan, const Json& file, const std::string& who,
              const std::string& advice) {
    const Json& tasks = json_list(file, "tasks", who, "a list of tasks");
    std::map<std::string, PlannedRun*> rest;
    for (PlannedRun* run : plan.runs()) rest[task_json(plan, *run).at("run")] = run;
    std::vector<PlannedRun*> order;
    for (std::size_t i = 0; i < tasks.size(); ++i) {
        const std::string where = who + ": tasks[" + std::to_string(i) + "]";
        const std::string name = json_text(tasks[i], "run", "", where);
        const auto found = rest.find(name);
        require(found != rest.end(), where, "got '", name, "', which is no run of the list",
                advice);
        require(task_json(plan, *found->second) == tasks[i], where, "the configuration of '", name,
                "' is not that of the list", advice);
        order.push_back(found->second);
        rest.erase(found);
    }
    require(rest.empty(), who + ": tasks", "got ", order.size(), " runs, expected ",
            plan.runs().size(), ", as the list has", advice);
    plan.order(order);
}

Json read_plan_file(const fs::path& path) {
    Json json = parse_checked_json(as_text(read_file(path, max_json_bytes)), path.string());
    require(
        json.is_object() && json.contains("version") && json.at("version") == plan_version,
        path.string(), "field 'version': got ",
        [&] { return json.is_object() ? json_excerpt(json.value("version", Json())) : "none"; },
        ", expected ", plan_version);
    return json;
}

/// Returns why a run failed; empty if it did not.
std::string failure_of(const PlannedRun& run) {
    const fs::path path = failed_path(run);
    std::error_code none;
    if (!fs::exists(path, none)) return "";
    const Json json = parse_checked_json(as_text(read_file(path, max_json_bytes)), path.string());
    return json_text(json, "reason", "without a reason", path.string());
}

/// Returns what keeps a run from the tables; empty if it is complete.
std::string unfinished(const ComparePlan& plan, const PlannedRun& run) {
    try {
        const auto holder = claimed_by(run.folder); // before the rest, which it may complete
        if (plan.is_complete(run)) {
            read_results(plan.evaluation_folder(run.folder));
            return "";
        }
        if (holder) return "running, by " + *holder;
        const std::string failure = failure_of(run);
        if (!failure.empty()) return failure;
    } catch (const Error& e) {
        return e.what();
    }
    return fs::exists(checkpoint_path(run.folder)) ? "not trained to its end" : "not begun";
}

/// Waits until the run that trains this one's stage 1 has it, or will not have it: it failed, or
/// nobody works on it for longer than a claim is believed. Returns false if asked to stop.
bool await_stage_one(const PlannedRun& run, const std::function<bool()>& go_on) {
    if (run.first == nullptr || fs::exists(checkpoint_path(run.folder))) return true;
    const PlannedRun& first = *run.first;
    auto seen = Clock::now();
    while (!has_stage_one(first.folder) && !fs::exists(failed_path(first)) &&
           Clock::now() - seen < ClaimTimes().patience) {
        if (claimed_by(first.folder)) seen = Clock::now();
        if (!go_on()) return false;
        std::this_thread::sleep_for(std::chrono::milliseconds(300));
    }
    return true;
}

int stopped(int signal) {
    std::cerr << "rye compare: stopped; the same task goes on\n";
    return code_of_stop(signal);
}

void say(const CompareOptions& o, const PlannedRun& run, const std::string& words) {
    if (!o.quiet) std::cout << run.name << ": " << words << "\n" << std::flush;
}

/// Trains and measures a run that is claimed; returns the exit code, throws an Error with the
/// reason of a failure.
int run_claimed(const ComparePlan& plan, const PlannedRun& run, Claim& claim) {
    const CompareOptions& o = plan.options();
    const bool begun = o.stage_one && has_stage_one(run.folder);
    if (begun || plan.is_complete(run)) {
        say(o, run, begun ? "has its stage 1 already" : "is complete already");
        return 0;
    }
    plan.check_there(run);
    std::error_code ignored;
    fs::remove(failed_path(run), ignored);
    {
        const NotedStops stops;
        if (!await_stage_one(run, [&] { return claim.renew() && stops.signal() == 0; }) &&
            stops.signal() != 0)
            return stopped(stops.signal());
    }
    std::optional<ChildResult> result;
    bool lost = false, enough = false;
    const int signal = run_children(
        {plan.job_of(run)}, 1, [&](std::size_t, const ChildResult& r) { result = r; },
        [&] {
            lost = !claim.renew();
            enough = o.stage_one && has_stage_one(run.folder);
            return lost || enough;
        });
    require(!lost, "this process",
            "it showed no sign of life for so long that another one took the run over");
    if (result && result->code == 0) {
        plan.complete(run);
        say(o, run, std::to_string(static_cast<std::int64_t>(result->seconds)) + " s");
        return 0;
    }
    if (enough) {
        say(o, run, "has its stage 1");
        return 0;
    }
    if (!result) return stopped(signal);
    throw Error(result->message.empty() ? "ended with code " + std::to_string(result->code)
                                        : result->message);
}

} // namespace

TaskNumbers number_tasks(ComparePlan& plan) {
    plan.share_stage_one();
    std::set<const PlannedRun*> firsts;
    for (const PlannedRun* run : plan.runs()) firsts.insert(run->first);
    const fs::path path = plan_path(plan.options().out);
    if (fs::exists(path)) { // its numbers stay: tasks may wait for their turn
        order_as(plan, read_plan_file(path), path.string(),
                 ": the plan is another's; name another --out, or remove it and its tasks");
    } else {
        std::vector<PlannedRun*> order = plan.runs();
        std::stable_partition(order.begin(), order.end(),
                              [&](const PlannedRun* run) { return firsts.contains(run); });
        plan.order(order);
    }
    TaskNumbers numbers;
    numbers.all = plan.runs().size();
    for (std::size_t i = 0; i < numbers.all; ++i) {
        const PlannedRun* const run = plan.runs()[i];
        if (plan.is_complete(*run)) continue;
        numbers.to_do.push_back(i);
        if (firsts.contains(run) && !has_stage_one(run->folder)) numbers.stage_one.push_back(i);
    }
    return numbers;
}

void write_plan(const ComparePlan& plan) {
    const CompareOptions& o = plan.options();
    Json experiments = Json::array(), tasks = Json::array();
    for (Experiment e : plan.lists().experiments) {
        e.captures = plan.captures_of(e);
        for (fs::path& c : e.captures) c = whole_path(c);
        e.seeds = plan.seeds_of(e);
        experiments.push_back({{"name", e.name}, {"list", to_json(e)}});
    }
    for (const PlannedRun* run : plan.runs()) tasks.push_back(task_json(plan, *run));
    const fs::path& weights = o.perceptual_weights;
    write_text(
        plan_path(o.out),
        checked_text({{"version", plan_version},
                      {"experiments", experiments},
                      {"base", plan.lists().base},
                      {"split", o.split},
                      {"device", o.device},
                      {"memory", o.memory},
                      {"threads", o.threads},
                      {"perceptual_weights", weights.empty() ? "" : whole_path(weights).string()},
                      {"tasks", tasks}},
                     1));
}

ComparePlan read_plan(const CompareOptions& given) {
    const fs::path path = plan_path(given.out);
    const std::string who = path.string();
    require(fs::exists(path), who, "is not there, expected the --out of `rye compare --emit`",
            given.collect ? ", or --table or --list" : "");
    const Json json = read_plan_file(path);
    CompareOptions o = given;
    CompareLists lists;
    for (const Json& e : json_list(json, "experiments", who, "a list of tables")) {
        const std::string name = json_text(e, "name", "", who + ": experiments");
        require(e.contains("list"), who, "field 'experiments': one has no list");
        lists.experiments.push_back(parse_experiment(e.at("list").dump(), path / (name + ".json")));
    }
    lists.base = json.value("base", Json());
    lists.base_source = who + ": base";
    o.split = json_text(json, "split", o.split, who);
    o.device = json_text(json, "device", o.device, who);
    o.memory = json_text(json, "memory", o.memory, who);
    o.perceptual_weights = json_text(json, "perceptual_weights", "", who);
    const double threads = json_number(json, "threads", 0, who);
    require(threads >= 0 && threads <= most_threads, who + ": threads", "got ", threads,
            ", expected 0 to ", most_threads);
    if (o.threads == 0) o.threads = static_cast<int>(threads);
    ComparePlan plan(o, lists);
    plan.add_runs();
    plan.share_stage_one();
    order_as(plan, json, who, ": by a rye of other presets; that one has to run it");
    return plan;
}

int run_task(const CompareOptions& given) {
    const ComparePlan plan = read_plan(given);
    const std::size_t number = static_cast<std::size_t>(*given.task);
    require(number < plan.runs().size(), "--task", "got ", number, ", expected 0 to ",
            plan.runs().size() - 1, ", as ", plan_path(given.out).string(), " has");
    const PlannedRun& run = *plan.runs()[number];
    std::error_code fault;
    fs::create_directories(run.folder, fault);
    require(!fault, run.folder.string(), "cannot be made: ", [&] { return fault.message(); });
    std::unique_ptr<Claim> claim;
    {
        const NotedStops stops;
        bool told = false;
        claim = Claim::take(run.folder, [&](const std::string& holder) {
            if (!std::exchange(told, true)) say(given, run, "waits for " + holder);
            return stops.signal() == 0;
        });
        if (!claim) return stopped(stops.signal());
    }
    try {
        return run_claimed(plan, run, *claim);
    } catch (const Error& e) {
        if (claim->renew()) // otherwise it is another's
            write_text(failed_path(run),
                       checked_text({{"reason", e.what()}, {"process", process_words()}}, -1));
        throw Error("rye compare: " + run.name + ": " + e.what());
    }
}

int collect(ComparePlan& plan) {
    std::size_t missing = 0;
    for (PlannedRun* run : plan.runs()) {
        run->failure = unfinished(plan, *run);
        run->ended = run->failure.empty();
        if (run->ended) continue;
        ++missing;
        if (!plan.options().quiet)
            std::cerr << "rye compare: " << run->name << ": " << run->failure << "\n";
    }
    write_tables(plan, true);
    if (plan.options().json) std::cout << tables_json(plan).dump(2) << "\n";
    if (missing != 0)
        std::cerr << "rye compare: " << missing << " of " << plan.runs().size()
                  << " runs are not in the tables\n";
    return missing == 0 ? 0 : 1;
}

} // namespace rye::trainer
