// SPDX-License-Identifier: Apache-2.0
// Files by which Slurm, GNU parallel and Kubernetes start the tasks of a comparison.
#include "commands/compare_launch.hpp"

#include <doctest/doctest.h>

#include "../support/hostile.hpp"

using namespace rye::trainer;

namespace {

const TaskNumbers nine_tasks{{0, 1, 2, 5, 7, 8}, {0, 2}, 9};
const LauncherPaths shared_paths{"/shared/it's out", "/opt/rye", {"/shared/cap"}};

CompareOptions asked_for(const std::string& launcher, std::vector<std::string> with = {}) {
    CompareOptions o;
    o.emit = launcher;
    o.with = std::move(with);
    return o;
}

void script_has(const std::string& text, const std::string& words) {
    INFO(text);
    CHECK_MESSAGE(text.find(words) != std::string::npos, words);
}

} // namespace

TEST_CASE("launchers: Slurm gets the tasks to do, with threads, a device and the user's lines") {
    CompareOptions o = asked_for("slurm", {"--partition=x", "--mem=8G"});
    o.threads = 4, o.device = "cuda", o.jobs = 3, o.jobs_given = true;
    const std::vector<LauncherFile> files = launcher_files(o, nine_tasks, shared_paths);
    REQUIRE(files.size() == 2);
    CHECK(files[0].name == "slurm.sbatch");
    script_has(files[0].text,
               "\n#SBATCH --cpus-per-task=4\n#SBATCH --gres=gpu:1\n"
               "#SBATCH --partition=x\n#SBATCH --mem=8G\n#");
    script_has(files[0].text, "compare --out '/shared/it'\\''s out' --task");
    script_has(files[1].text, "stage_one='0,2'\ntasks='0-2,5,7-8'\n");
    script_has(files[1].text, "--array=\"$tasks%3\"");
    const std::string plain = launcher_files(asked_for("slurm"), nine_tasks, shared_paths)[0].text;
    CHECK(plain.find("gres") == std::string::npos);
    CHECK(plain.find("cpus") == std::string::npos);
}

TEST_CASE("launchers: GNU parallel gets all tasks, which end at once where they are complete") {
    const std::string text =
        launcher_files(asked_for("parallel", {"--sshlogin a,b"}), nine_tasks, shared_paths)[0].text;
    script_has(text, "stage_one='0 2'\n");
    script_has(text, "seq 0 8");
    script_has(text, "--sshlogin a,b \"$@\"");
}

TEST_CASE("launchers: Kubernetes gets an image, and a volume that holds all paths") {
    const auto text = [](std::vector<std::string> with) {
        return launcher_files(asked_for("k8s", std::move(with)), nine_tasks, shared_paths)[0].text;
    };
    script_has(text({}), "# IMAGE is to be filled in");
    script_has(text({}), "completions: 9\n  parallelism: 9\n");
    const std::string filled = text({"image=r/rye:1", "volume=data:/shared", "memory=8Gi"});
    script_has(filled, "image: \"r/rye:1\"");
    script_has(filled, "claimName: \"data\"");
    script_has(filled, "mountPath: \"/shared\"");
    script_has(filled, "              memory: \"8Gi\"\n");
    CHECK(filled.find("IMAGE") == std::string::npos);
    CHECK_FAULT(text({"volume=data:/elsewhere"}),
                "--with: got 'volume=data:/elsewhere', a folder that does not hold /shared/cap");
    CHECK_FAULT(text({"volume=data"}), "expected volume=CLAIM:FOLDER");
    CHECK_FAULT(text({"volume=:/shared"}), "expected volume=CLAIM:FOLDER");
    CHECK_FAULT(text({"image="}), "--with: got 'image=', expected image=IMAGE");
    CHECK_FAULT(text({"--partition=x"}), "--with: got '--partition=x', expected image=IMAGE");
}

TEST_CASE("launchers: words and paths that would break a script are refused") {
    CHECK_FAULT(launcher_files(asked_for("slurm", {"--mem=8G\nrm"}), nine_tasks, shared_paths),
                "of one line");
    CHECK_FAULT(launcher_files(asked_for("slurm", {""}), nine_tasks, shared_paths),
                "--with: got ''");
    LauncherPaths other = shared_paths;
    other.program = "/a$b/rye";
    CHECK_FAULT(launcher_files(asked_for("slurm"), nine_tasks, other),
                "--emit: got the path '/a$b/rye'");
    other = shared_paths;
    other.out = "/a{}";
    CHECK_FAULT(launcher_files(asked_for("parallel"), nine_tasks, other),
                "--emit: got the path '/a{}'");
    other.out = "/a\nb";
    CHECK_FAULT(launcher_files(asked_for("slurm"), nine_tasks, other),
                "expected one without line breaks");
}
