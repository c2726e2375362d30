// SPDX-License-Identifier: Apache-2.0
/// commands/info_json.hpp: what `rye info --json` prints; docs/program.md has its schema.
#pragma once

#include <vector>

#include <nlohmann/json.hpp>

#include "data/capture.hpp"

namespace rye::trainer {

/// The contents of a capture, and the problems that reading and checking it found.
nlohmann::ordered_json info_json(const Capture& capture, const std::vector<Problem>& problems);

} // namespace rye::trainer
