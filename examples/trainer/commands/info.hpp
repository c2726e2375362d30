// SPDX-License-Identifier: Apache-2.0
/// commands/info.hpp: text description of a capture. The command is `rye info DIR`; it exits with 1
/// if the capture has errors.
#pragma once

#include <string>

#include "data/capture.hpp"

namespace rye::trainer {

/// Returns the contents of the capture as lines of text.
std::string describe(const Capture& capture);

} // namespace rye::trainer
