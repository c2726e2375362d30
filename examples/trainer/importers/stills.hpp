// SPDX-License-Identifier: Apache-2.0
/// importers/stills.hpp: a capture of one frame from calibrated photographs, each a camera. Lens
/// distortion is removed; smaller photographs are extended at the right and below, and `visible`
/// marks the pixels that a photograph has.
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

/// Imports photographs; `job` and `found` as in ImportFolder and ImportSummary. Throws an Error,
/// with the file, if a picture has another size than its camera.
ImportSummary import_stills(const std::vector<Still>& stills, const ImportFolder::Json& job,
                            const ImportOptions& options);

} // namespace rye::trainer
