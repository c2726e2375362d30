// SPDX-License-Identifier: Apache-2.0
/// viewing/page_files.hpp: files of the page that `rye view` serves, put into the program when it
/// is built.
#pragma once

#include <string_view>

namespace rye::trainer {

/// Returns a file of examples/gaze_page, or view.js, by its name; empty for another.
std::string_view page_file(std::string_view name);

} // namespace rye::trainer
