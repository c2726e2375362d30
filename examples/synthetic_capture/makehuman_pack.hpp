// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/makehuman_pack.hpp: MakeHuman's base mesh as a head model that `ict_head`
/// reads: the arrays of ICT-FaceKit's pack, in its frame and its unit, a tenth of ours.
#pragma once

#include <filesystem>
#include <string>

#include <rye/io/npz.hpp>

namespace rye::trainer {

/// A head model as an npz and the names.json beside it.
struct HeadPack {
    NpzArrays arrays;
    std::string names; ///< JSON
};

/// Packs head and neck of MakeHuman's folder, which has base.obj and targets/, plain or as .gz.
/// Throws an Error that names the file and the line for a missing or damaged one.
HeadPack pack_makehuman(const std::filesystem::path& folder);

} // namespace rye::trainer
