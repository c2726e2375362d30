// SPDX-License-Identifier: Apache-2.0
/// commands/info_json.hpp: output of `rye info --json`; docs/program.md has its schema.
#pragma once

#include <vector>

#include <nlohmann/json.hpp>

#include "data/capture.hpp"

namespace rye::trainer {

/// Returns the contents of a capture, and the problems that reading and checking it found.
nlohmann::ordered_json info_json(const Capture& capture, const std::vector<Problem>& problems);

} // namespace rye::trainer
