// SPDX-License-Identifier: Apache-2.0
/// commands/info.hpp: a capture in words. The command is `rye info DIR`; it exits with 1
/// when the capture has errors.
#pragma once

#include <string>

#include "data/capture.hpp"

namespace rye::trainer {

/// What the capture holds, in lines for a reader.
std::string describe(const Capture& capture);

} // namespace rye::trainer
