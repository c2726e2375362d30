// SPDX-License-Identifier: Apache-2.0
#include "commands/compare_launch.hpp"

#include <algorithm>
#include <map>

#include <rye/core/checksum.hpp>
#include <rye/core/error.hpp>

#include "commands/completion.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

/// Returns a text with marks such as @out@ replaced.
std::string filled(std::string text, const std::map<std::string, std::string>& marks) {
    for (std::size_t at = 0; (at = text.find('@', at)) != std::string::npos;) {
        const std::size_t end = text.find('@', at + 1);
        const auto found =
            end == std::string::npos ? marks.end() : marks.find(text.substr(at + 1, end - at - 1));
        if (found == marks.end()) {
            ++at;
            continue;
        }
        text.replace(at, end + 1 - at, found->second);
        at += found->second.size();
    }
    return text;
}

/// Returns a text as a string of YAML, which JSON's are.
std::string yaml_word(const std::string& text) { return nlohmann::json(text).dump(); }

/// Returns numbers as "0-3,7".
std::string ranges(const std::vector<std::size_t>& numbers) {
    std::string text;
    for (std::size_t i = 0; i < numbers.size();) {
        std::size_t last = i;
        while (last + 1 < numbers.size() && numbers[last + 1] == numbers[last] + 1) ++last;
        text += (text.empty() ? "" : ",") + std::to_string(numbers[i]) +
                (last > i ? "-" + std::to_string(numbers[last]) : "");
        i = last + 1;
    }
    return text;
}

constexpr const char* sbatch_file = R"sh(#!/bin/sh
#SBATCH --job-name=@name@
#SBATCH --open-mode=append
#SBATCH --requeue
#SBATCH --signal=B:USR1@120
@lines@# One task of the plan beside this file; submit.sh hands it to Slurm. A task that fails goes back to
# the queue, and so does one whose time is up (USR1, 120 s before), after a checkpoint. One that is
# cancelled does not.
set -u
"${RYE:-@rye@}" compare --out @out@ --task "$SLURM_ARRAY_TASK_ID" \
    --threads "${SLURM_CPUS_PER_TASK:-1}" "$@" &
task=$!
time_is_up=no
trap 'kill -TERM "$task" 2> /dev/null' TERM
trap 'time_is_up=yes; kill -TERM "$task" 2> /dev/null' USR1
while :; do # a signal ends wait
    code=0
    wait "$task" || code=$?
    kill -0 "$task" 2> /dev/null || break
done
again=no
[ "$code" = 0 ] || [ "$code" = 143 ] || [ "${SLURM_RESTART_COUNT:-0}" -ge "${RETRIES:-2}" ] || again=yes
[ "$code" = 0 ] || [ $time_is_up = no ] || again=yes
[ $again = no ] || scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID"
exit "$code"
)sh";

constexpr const char* submit_file = R"sh(#!/bin/sh
# Submits the tasks that are not complete, once: nothing while earlier ones are in the queue. Runs
# that others take stage 1 from train that first. Words after it go to sbatch.
set -eu
cd @out@
stage_one=@stage_one@
tasks=@tasks@
if [ -z "$tasks" ]; then
    echo "all runs are complete"
    exit 0
fi
queued=$(squeue --noheader --name @name@ --user "$(id -un)" --format %A)
if [ -n "$queued" ]; then
    echo "its tasks are in the queue as @name@ already"
    exit 0
fi
mkdir -p jobs
first=
if [ -n "$stage_one" ]; then
    first=$(sbatch --parsable --output='jobs/%x_%a.txt' --array="$stage_one@at_once@" "$@" \
        slurm.sbatch --stage-one)
    first=${first%%;*}
    set -- "$@" --dependency="afterany:$first"
fi
all=$(sbatch --parsable --output='jobs/%x_%a.txt' --array="$tasks@at_once@" "$@" slurm.sbatch) || {
    [ -z "$first" ] || scancel "$first"
    exit 1
}
echo "submitted @count@ tasks as ${all%%;*}${first:+, after $first for stage 1}; their words: $PWD/jobs"
)sh";

constexpr const char* parallel_file = R"sh(#!/bin/sh
# Runs the tasks of the plan beside this file by GNU parallel, each up to three times, then makes the
# tables. Runs that others take stage 1 from train that first. Complete tasks end at once, so that
# this may be run any number of times. Words after it go to parallel.
set -eu
out=@out@
rye=${RYE:-@rye@}
jobs=@jobs@
threads=@threads@
if [ $threads = 0 ] && [ $jobs -gt 1 ]; then
    threads=$(($(nproc) / jobs))
    [ $threads -ge 1 ] || threads=1
fi
mkdir -p "$out/jobs"
tasks() { # NAME NUMBERS WORD, then words for parallel
    name=$1 numbers=$2 word=$3
    shift 3
    # A terminal's Ctrl-C leaves a minute for checkpoints. No --resume: it goes by line numbers, the
    # tasks by what there is.
    # shellcheck disable=SC2086 # lists of numbers, and of one word or none
    parallel --will-cite --quote --jobs $jobs --retries 3 --termseq TERM,60000,KILL,25 \
        --joblog "$out/jobs/$name.txt" @lines@"$@" \
        "$rye" compare --out "$out" --threads $threads --quiet --task {} $word ::: $numbers
}
stage_one=@stage_one@
[ -z "$stage_one" ] || tasks stage_one "$stage_one" --stage-one "$@" || true
tasks tasks "$(seq 0 @last@)" "" "$@" || true
exec "$rye" compare --out "$out" --collect
)sh";

constexpr const char* kubernetes_file =
    R"(# kubectl apply -f k8s.yaml; one pod a task of the plan beside this file, each tried three times.
# @image_note@
# @volume_note@
apiVersion: batch/v1
kind: Job
metadata:
  name: @name@
spec:
  completionMode: Indexed
  completions: @count@
  parallelism: @at_once@
  backoffLimitPerIndex: 2
  maxFailedIndexes: @count@
  podReplacementPolicy: Failed
  podFailurePolicy:
    rules:
      - action: Ignore
        onPodConditions:
          - type: DisruptionTarget
  template:
    spec:
      restartPolicy: Never
      terminationGracePeriodSeconds: 120
      containers:
        - name: rye
          image: @image@
          command: @command@
          resources:
            requests:
              cpu: "@threads@"
@memory@@limits@          volumeMounts:
            - name: shared
              mountPath: @mount@
      volumes:
        - name: shared
          persistentVolumeClaim:
            claimName: @claim@
)";

std::string joined(const std::vector<std::size_t>& numbers) {
    std::string text;
    for (const std::size_t n : numbers) text += (text.empty() ? "" : " ") + std::to_string(n);
    return text;
}

/// Returns a name for a queue: of this comparison alone.
std::string queue_name(const fs::path& out) {
    return "rye-" + checksum_text(crc32(as_bytes(out.string())));
}

std::vector<LauncherFile> slurm_files(const CompareOptions& o, const TaskNumbers& tasks,
                                      const LauncherPaths& paths) {
    std::string lines;
    if (o.threads > 0) lines += "#SBATCH --cpus-per-task=" + std::to_string(o.threads) + "\n";
    if (o.device == "cuda") lines += "#SBATCH --gres=gpu:1\n";
    for (const std::string& line : o.with) lines += "#SBATCH " + line + "\n";
    const std::map<std::string, std::string> marks{
        {"name", queue_name(paths.out)},
        {"lines", lines},
        {"rye", paths.program.string()},
        {"out", shell_word(paths.out.string())},
        {"tasks", shell_word(ranges(tasks.to_do))},
        {"count", std::to_string(tasks.to_do.size())},
        {"stage_one", shell_word(ranges(tasks.stage_one))},
        {"at_once", o.jobs_given ? "%" + std::to_string(o.jobs) : ""}};
    return {{"slurm.sbatch", filled(sbatch_file, marks)},
            {"submit.sh", filled(submit_file, marks), true}};
}

std::vector<LauncherFile> parallel_files(const CompareOptions& o, const TaskNumbers& tasks,
                                         const LauncherPaths& paths) {
    std::string lines;
    for (const std::string& line : o.with) lines += line + " ";
    return {{"parallel.sh",
             filled(parallel_file, {{"lines", lines},
                                    {"rye", paths.program.string()},
                                    {"out", shell_word(paths.out.string())},
                                    {"jobs", std::to_string(o.jobs)},
                                    {"threads", std::to_string(o.threads)},
                                    {"stage_one", shell_word(joined(tasks.stage_one))},
                                    {"last", std::to_string(tasks.all - 1)}}),
             true}};
}

std::vector<LauncherFile> kubernetes_files(const CompareOptions& o, const TaskNumbers& tasks,
                                           const LauncherPaths& paths) {
    std::map<std::string, std::string> words{{"image", ""}, {"volume", ""}, {"memory", ""}};
    for (const std::string& word : o.with) {
        const std::size_t equals = word.find('=');
        const auto found = words.find(word.substr(0, equals));
        require(equals != std::string::npos && equals + 1 < word.size() && found != words.end(),
                "--with", "got '", word,
                "', expected image=IMAGE, volume=CLAIM:FOLDER or memory=SIZE, as --emit k8s takes");
        found->second = word.substr(equals + 1);
    }
    const std::string volume = words["volume"];
    const std::size_t colon = volume.find(':');
    const fs::path mount = colon == std::string::npos ? "" : volume.substr(colon + 1);
    require(volume.empty() || (colon > 0 && mount.is_absolute()), "--with", "got 'volume=", volume,
            "', expected volume=CLAIM:FOLDER, the folder by its whole path");
    std::vector<fs::path> inside = paths.inputs;
    inside.push_back(paths.out);
    for (const fs::path& path : inside) {
        const fs::path within = mount.empty() ? "." : path.lexically_relative(mount);
        require(!within.empty() && *within.begin() != "..", "--with", "got 'volume=", volume,
                "', a folder that does not hold ", path.string(),
                ", expected one that pods and this machine have at the same path");
    }
    nlohmann::json command{"rye", "compare", "--out"};
    std::string path;
    for (const char c : paths.out.string()) path += c == '$' ? "$$" : std::string(1, c);
    const std::string threads = std::to_string(std::max(1, o.threads));
    for (const std::string& word : {path, std::string("--threads"), threads, std::string("--task"),
                                    std::string("$(JOB_COMPLETION_INDEX)")})
        command.push_back(word);
    const std::string memory = yaml_word(words["memory"]);
    const bool bounded = !words["memory"].empty(), cuda = o.device == "cuda";
    return {
        {"k8s.yaml",
         filled(kubernetes_file,
                {{"name", queue_name(paths.out)},
                 {"count", std::to_string(tasks.all)},
                 {"at_once", std::to_string(o.jobs_given ? o.jobs : tasks.all)},
                 {"image", yaml_word(words["image"].empty() ? "IMAGE" : words["image"])},
                 {"image_note", words["image"].empty()
                                    ? "IMAGE is to be filled in: one with rye in its PATH."
                                    : "The image has rye in its PATH."},
                 {"volume_note",
                  volume.empty()
                      ? "CLAIM is to be filled in: of a volume that many pods may write to, "
                        "with these paths."
                      : "Many pods may write to the volume (ReadWriteMany)."},
                 {"command", command.dump()},
                 {"threads", threads},
                 {"memory", bounded ? "              memory: " + memory + "\n" : ""},
                 {"limits", bounded || cuda
                                ? std::string("            limits:\n") +
                                      (bounded ? "              memory: " + memory + "\n" : "") +
                                      (cuda ? "              nvidia.com/gpu: 1\n" : "")
                                : ""},
                 {"mount",
                  yaml_word(mount.empty() ? paths.out.parent_path().string() : mount.string())},
                 {"claim", yaml_word(volume.empty() ? "CLAIM" : volume.substr(0, colon))}})}};
}

} // namespace

const std::vector<std::string>& launchers() {
    static const std::vector<std::string> names{"slurm", "parallel", "k8s"};
    return names;
}

std::vector<LauncherFile> launcher_files(const CompareOptions& o, const TaskNumbers& tasks,
                                         const LauncherPaths& paths) {
    const auto without = [](const fs::path& path, const char* characters, const char* words) {
        require(path.string().find_first_of(characters) == std::string::npos, "--emit",
                "got the path '", path.string(), "', expected one without ", words);
    };
    without(paths.out, "\n", "line breaks");
    without(paths.program, "\n\"`$\\", "line breaks and \" ` $ \\");
    if (o.emit == "parallel") without(paths.out, "{", "{, which parallel replaces");
    for (const std::string& line : o.with)
        require(!line.empty() && line.find('\n') == std::string::npos, "--with", "got '", line,
                "', expected words of one line");
    if (o.emit == "slurm") return slurm_files(o, tasks, paths);
    if (o.emit == "parallel") return parallel_files(o, tasks, paths);
    return kubernetes_files(o, tasks, paths);
}

std::string write_launcher(const CompareOptions& o, const std::vector<LauncherFile>& files) {
    fs::path path;
    for (const LauncherFile& file : files) {
        path = o.out / file.name;
        write_text(path, file.text);
        if (file.program)
            fs::permissions(path, fs::perms::owner_exec | fs::perms::group_exec,
                            fs::perm_options::add);
    }
    return (o.emit == "k8s" ? "kubectl apply -f " : "sh ") + path.string();
}

} // namespace rye::trainer
