// SPDX-License-Identifier: Apache-2.0
/// commands/compare_launch.hpp: files by which other programs start the tasks of a comparison:
/// Slurm, GNU parallel, and Kubernetes.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "commands/compare_tasks.hpp"

namespace rye::trainer {

/// Programs that `rye compare --emit` knows.
const std::vector<std::string>& launchers();

/// Text of a file of a launcher.
struct LauncherFile {
    std::string name, text;
    bool program = false; ///< may be executed
};

/// The paths that the files name, whole.
struct LauncherPaths {
    std::filesystem::path out, program;
    std::vector<std::filesystem::path> inputs; ///< that tasks read
};

/// Returns the files of the launcher in the options. Throws an Error for words of --with that it
/// does not take, and for paths that it cannot hold.
std::vector<LauncherFile> launcher_files(const CompareOptions& options, const TaskNumbers& tasks,
                                         const LauncherPaths& paths);

/// Writes the files into OUT; returns the command that starts the tasks.
std::string write_launcher(const CompareOptions& options, const std::vector<LauncherFile>& files);

} // namespace rye::trainer
