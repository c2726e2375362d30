// SPDX-License-Identifier: Apache-2.0
/// importers/stills.hpp: a capture of one frame from calibrated photographs, each a camera. Lenses
/// are straightened; smaller photographs are extended at the right and below, and `visible` marks
/// what a photograph does not have.
#pragma once

#include <filesystem>
#include <vector>

#include "data/photographs.hpp"
#include "importers/import_folder.hpp"

namespace rye::trainer {

struct Still {
    std::filesystem::path image, mask; ///< mask may be empty
    Photograph photograph;
};

/// Imports photographs; `job` and `found` as in ImportFolder and ImportSummary. Throws Error, with
/// the file, where a picture has another size than its camera.
ImportSummary import_stills(const std::vector<Still>& stills, const ImportFolder::Json& job,
                            const ImportOptions& options);

} // namespace rye::trainer
