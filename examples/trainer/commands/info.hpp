// SPDX-License-Identifier: Apache-2.0
/// commands/info.hpp: text description of a capture. The command is `rye info DIR`; it exits with 1
/// when the capture has errors.
#pragma once

#include <string>

#include "data/capture.hpp"

namespace rye::trainer {

/// The contents of the capture as lines of text.
std::string describe(const Capture& capture);

} // namespace rye::trainer
