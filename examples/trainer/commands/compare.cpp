// SPDX-License-Identifier: Apache-2.0
/// `rye compare`: trains and evaluates lists of configurations by `rye train` and `rye evaluate`,
/// for several seeds and captures, and writes their tables. Keeps existing results. Runs them
/// itself, or lets other programs start them as tasks.
#include <algorithm>
#include <iostream>
#include <memory>

#include <CLI/CLI.hpp>

#include "commands/commands.hpp"
#include "commands/compare_launch.hpp"
#include "commands/compare_plan.hpp"
#include "commands/compare_tasks.hpp"
#include "commands/options.hpp"
#include "data/claim.hpp"
#include "data/folder_lock.hpp"
#include "data/system.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

void say(const CompareOptions& o, const std::string& line) {
    if (!o.quiet && !o.json) std::cout << line << "\n" << std::flush;
}

/// Makes OUT and locks it, against others that plan there.
FolderLock locked(const fs::path& out) {
    std::error_code fault;
    fs::create_directories(out, fault);
    require(!fault, out.string(), "cannot be made: ", [&] { return fault.message(); });
    // Children hold it too, so that it waits for a training whose parent was killed.
    return FolderLock(out, {"rye compare", 30, true});
}

/// Writes the plan and the files of the program that starts its tasks.
int emit(ComparePlan& plan) {
    const CompareOptions& o = plan.options();
    plan.add_runs();
    LauncherPaths paths{whole_path(o.out), program_file(), {}};
    for (const PlannedRun* r : plan.runs()) paths.inputs.push_back(whole_path(r->capture_folder));
    if (!o.perceptual_weights.empty()) paths.inputs.push_back(whole_path(o.perceptual_weights));
    launcher_files(o, number_tasks(plan), paths); // what is wrong, before anything is written
    const FolderLock lock = locked(o.out);
    for (const PlannedRun* r : plan.runs()) plan.check_there(*r);
    const TaskNumbers tasks = number_tasks(plan);
    write_plan(plan);
    const std::string start = write_launcher(o, launcher_files(o, tasks, paths));
    say(o, std::to_string(tasks.all) + " runs, " + std::to_string(tasks.to_do.size()) +
               " of them to do: " + start);
    return 0;
}

/// Runs all that is to do as child processes.
int run(ComparePlan& plan) {
    const CompareOptions& o = plan.options();
    plan.add_runs();
    const FolderLock lock = locked(o.out);
    for (const PlannedRun* r : plan.runs()) {
        plan.check_there(*r);
        if (const auto holder = claimed_by(r->folder))
            throw Error(r->folder.string() + ": is in use by a task, " + *holder +
                        "; wait until it has ended, or --collect what there is");
    }
    plan.share_stage_one();
    std::vector<ChildJob> jobs;
    std::vector<PlannedRun*> of_job;
    for (PlannedRun* r : plan.runs()) {
        r->ended = plan.is_complete(*r);
        if (r->ended) continue;
        jobs.push_back(plan.job_of(*r));
        of_job.push_back(r);
    }
    const auto own =
        std::count_if(jobs.begin(), jobs.end(), [](const ChildJob& job) { return !job.ready; });
    say(o, std::to_string(plan.runs().size()) + " runs, " + std::to_string(jobs.size()) +
               " of them to do, " + std::to_string(o.jobs) + " at once; stage 1 is trained for " +
               std::to_string(own));
    write_tables(plan, false);
    std::size_t done = 0;
    const int signal = run_children(jobs, o.jobs, [&](std::size_t i, const ChildResult& result) {
        PlannedRun& r = *of_job[i];
        r.ended = true;
        const std::string place =
            "[" + std::to_string(++done) + "/" + std::to_string(jobs.size()) + "] ";
        if (result.code == 0) {
            plan.complete(r);
            say(o, place + r.name + ": " +
                       std::to_string(static_cast<std::int64_t>(result.seconds)) + " s");
        } else {
            r.failure = result.message.empty() ? "ended with code " + std::to_string(result.code)
                                               : result.message;
            std::cerr << "rye compare: " << place << r.name << ": " << r.failure << "\n";
        }
        write_tables(plan, false);
    });
    if (signal != 0) {
        std::cerr << "rye compare: stopped; the same command goes on\n";
        return code_of_stop(signal);
    }
    write_tables(plan, true);
    if (o.json) std::cout << tables_json(plan).dump(2) << "\n";
    const auto failed = std::count_if(plan.runs().begin(), plan.runs().end(),
                                      [](const PlannedRun* r) { return !r->failure.empty(); });
    require(failed == 0, o.out.string(), failed, " of ", plan.runs().size(),
            " runs failed; the tables name them, and their last words are in log.txt.errors "
            "of their folders");
    return 0;
}

/// Adds the options of tasks that other programs start.
void add_tasks(CLI::App& c, CompareOptions& o) {
    CLI::Option* const emit =
        c.add_option("--emit", o.emit,
                     "Train nothing: write OUT/plan.json, which numbers the runs as tasks, and "
                     "what starts them on many machines; --jobs bounds how many at once")
            ->check(CLI::IsMember(launchers()));
    c.add_option("--with", o.with,
                 "Words for the program of --emit: an option of sbatch or parallel, image=IMAGE, "
                 "volume=CLAIM:FOLDER or memory=SIZE of Kubernetes; more than once")
        ->expected(1)
        ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll)
        ->needs(emit);
    CLI::Option* const task =
        c.add_option("--task", o.task,
                     "Train and measure one run of OUT/plan.json, from where it is")
            ->check(from_to(0, 1000000));
    c.add_flag("--stage-one", o.stage_one, "Its stage 1 alone")->needs(task);
    c.add_flag("--collect", o.collect,
               "Make the tables of what is there, also while tasks run, and name what is missing "
               "(exit code 1); without a list that of OUT/plan.json");
}

/// Throws an Error if the command line has an option that is not among these.
void require_only(const CLI::App& c, const std::string& mode,
                  const std::vector<std::string>& others, const std::string& expected) {
    for (const CLI::Option* option : c.get_options()) {
        const std::string name = option->get_name();
        require(option->count() == 0 || name == mode ||
                    std::find(others.begin(), others.end(), name) != others.end(),
                mode, "got ", name, " too, expected ", expected);
    }
}

/// Throws an Error for options that do not go with each other.
void require_together(const CLI::App& c, const CompareOptions& o) {
    if (o.task)
        require_only(c, "--task", {"--out", "--threads", "--quiet", "--stage-one"},
                     "only --out, --threads, --quiet and --stage-one: OUT/plan.json has the rest");
    else if (o.collect && o.tables.empty() && o.list.empty())
        require_only(c, "--collect", {"--out", "--json", "--quiet"},
                     "only --out, --json and --quiet, or a list (--table, --list)");
    const auto exclude = [&](const char* mode, std::initializer_list<const char*> others) {
        for (const char* other : others)
            require(c.get_option(mode)->count() == 0 || c.get_option(other)->count() == 0, mode,
                    "got ", other, " too: they exclude each other");
    };
    exclude("--collect", {"--emit", "--jobs", "--threads", "--print-list"});
    exclude("--emit", {"--json", "--print-list"});
}

int compare(const CompareOptions& o) {
    const auto with_out = [&](const char* what) {
        require(!o.out.empty(), "rye compare", "--out is missing, expected a folder ", what);
    };
    const bool lists = !o.tables.empty() || !o.list.empty();
    if (o.task || (o.collect && !lists)) {
        with_out("with a plan.json, of `rye compare --emit`");
        if (o.task) return run_task(o);
        ComparePlan plan = read_plan(o);
        return collect(plan);
    }
    ComparePlan plan(o, lists_of(o));
    if (o.print_list) {
        const std::vector<Experiment>& all = plan.lists().experiments;
        require(all.size() == 1, "--print-list", "got ", all.size(), " tables, expected one");
        std::cout << to_json(all.front()).dump(2) << "\n";
        return 0;
    }
    with_out("for runs and tables");
    if (!o.collect) return o.emit.empty() ? run(plan) : emit(plan);
    plan.add_runs();
    require(fs::is_directory(o.out), "--out", "got '", o.out.string(),
            "', which is no folder, expected one with runs");
    return collect(plan);
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
    c->add_option("--jobs", o->jobs, "Runs at once")->check(from_to(1, 64))->capture_default_str();
    add_memory(*c);
    add_threads(*c, o->threads, "Threads of each run (0: the machine's, shared by the jobs)");
    c->add_option("--perceptual-weights", o->perceptual_weights,
                  "VGG16 + LPIPS weights, a safetensors file, for training and for LPIPS");
    c->add_flag("--json", o->json, "Print the tables as JSON instead of Markdown");
    c->add_flag("--quiet", o->quiet, "No line for each run that ends");
    c->add_flag("--print-list", o->print_list,
                "Print the list as JSON, as --list reads it, and stop");
    add_tasks(*c, *o);
    c->callback([c, o] {
        if (const CLI::Option* memory = c->get_option("--memory"); memory->count() > 0)
            o->memory = memory->as<std::string>();
        require_together(*c, *o);
        o->jobs_given = c->get_option("--jobs")->count() > 0;
        const int code = compare(*o);
        if (code != 0) throw CLI::RuntimeError(code);
    });
}

} // namespace rye::trainer
