// SPDX-License-Identifier: Apache-2.0
/// commands/compare_tasks.hpp: a comparison whose runs other programs start, each as one task, on
/// machines that share a file system. OUT/plan.json has the lists and numbers the tasks; a task's
/// folder has its claim (data/claim.hpp) and, after a failure, failed.json.
#pragma once

#include <string>
#include <vector>

#include "commands/compare_plan.hpp"

namespace rye::trainer {

/// Tasks of plan.json, by their numbers.
struct TaskNumbers {
    std::vector<std::size_t> to_do;     ///< not complete
    std::vector<std::size_t> stage_one; ///< whose stage 1 others take, and that have none yet
    std::size_t all = 0;
};

/// Numbers the runs: as OUT/plan.json does if it is there, or else those first that others take
/// stage 1 from. Throws an Error if it has other tasks.
TaskNumbers number_tasks(ComparePlan& plan);

/// Writes plan.json, of runs that are numbered.
void write_plan(const ComparePlan& plan);

/// Returns the plan of OUT/plan.json, with its runs; options that are not in it are `given`'s.
/// Throws an Error for a damaged file, and for one of a program with other presets.
ComparePlan read_plan(const CompareOptions& given);

/// Trains and measures a run of the plan, from where it is, or its stage 1 alone; waits while
/// another process does, and while another run trains the stage 1 that it takes. Returns the exit
/// code; throws an Error, after it has noted it in the folder, if the run fails.
int run_task(const CompareOptions& given);

/// Makes the tables of what is complete; returns 0 if all runs are, otherwise 1.
int collect(ComparePlan& plan);

} // namespace rye::trainer
