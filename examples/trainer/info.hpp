// SPDX-License-Identifier: Apache-2.0
/// examples/trainer/info.hpp: `rye info DIR`: what a capture holds, and what is wrong with it.
#pragma once

#include <string>

#include "capture.hpp"

namespace CLI {
class App;
}

namespace rye::trainer {

/// What the capture holds, in lines for a reader.
std::string describe(const Capture& capture);

/// Adds the command; it exits with 1 when the capture has errors.
void add_info(CLI::App& app);

} // namespace rye::trainer
