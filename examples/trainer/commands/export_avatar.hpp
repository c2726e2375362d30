// SPDX-License-Identifier: Apache-2.0
/// commands/export_avatar.hpp: `rye export --out NAME.avatar`: the whole avatar in one file.
#pragma once

#include <filesystem>
#include <string>

namespace rye::trainer {

struct AvatarExportOptions {
    std::filesystem::path run, capture, out; ///< capture may be empty: the one trained on
    std::string frame, camera;               ///< ids; empty: as `rye redirect` chooses
    bool full_precision = false;             ///< F32 everywhere
    std::filesystem::path lights;            ///< of --lights; may be empty
};

/// Writes the file and prints its name and size.
void export_avatar(const AvatarExportOptions& options);

} // namespace rye::trainer
