// SPDX-License-Identifier: Apache-2.0
/// Imports cameras and pictures of a COLMAP model (colmap_model.hpp).
#include <algorithm>
#include <string>

#include <rye/core/error.hpp>

#include "importers/colmap_model.hpp"
#include "importers/stills.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

struct ModelFolder {
    fs::path path;
    ColmapFormat format;
};

ModelFolder model_folder(const fs::path& source) {
    for (const fs::path& folder : {source / "sparse" / "0", source / "sparse", source}) {
        const auto has = [&](const char* suffix) {
            return fs::exists(folder / (std::string("cameras") + suffix)) &&
                   fs::exists(folder / (std::string("images") + suffix));
        };
        if (has(".bin")) return {folder, ColmapFormat::binary};
        if (has(".txt")) return {folder, ColmapFormat::text};
    }
    throw Error(source.string() +
                ": has no cameras.bin and images.bin, nor .txt, in sparse/0, sparse or itself; "
                "expected a COLMAP model");
}

} // namespace

ImportSummary import_colmap(const ImportOptions& options) {
    const ImportFolder::Json job = import_job("colmap", options);
    const ModelFolder folder = model_folder(options.source);
    const auto file = [&](const char* stem) {
        const bool binary = folder.format == ColmapFormat::binary;
        return folder.path / (std::string(stem) + (binary ? ".bin" : ".txt"));
    };
    const ColmapCameras cameras =
        parse_colmap_cameras(read_file(file("cameras")), folder.format, file("cameras").string());
    std::vector<ColmapPicture> pictures =
        parse_colmap_pictures(read_file(file("images")), folder.format, file("images").string());
    require(!pictures.empty(), file("images").string(), "has no pictures, expected one or more");
    std::sort(pictures.begin(), pictures.end(),
              [](const ColmapPicture& a, const ColmapPicture& b) { return a.name < b.name; });
    std::vector<Still> stills;
    for (const ColmapPicture& p : pictures) {
        const auto camera = cameras.find(p.camera);
        require(camera != cameras.end(), file("images").string() + ": " + p.name, "got the camera ",
                p.camera, ", expected one of the ", cameras.size(), " of ",
                [&] { return file("cameras").string(); });
        Still still;
        still.photograph = camera->second;
        still.photograph.file = p.name;
        still.photograph.camera.camera_from_world = p.camera_from_world;
        const std::string who = file("images").string() + ": the picture '" + p.name + "'";
        still.image = named_file(options, options.source, fs::path("images") / p.name, who);
        require(fs::is_regular_file(still.image), still.image.string(),
                "no such file, expected the picture '", p.name, "' of ",
                [&] { return file("images").string(); });
        // COLMAP's own names of masks.
        const fs::path mask =
            named_file(options, options.source, fs::path("masks") / (p.name + ".png"), who);
        if (fs::exists(mask)) still.mask = mask;
        stills.push_back(std::move(still));
    }
    return import_stills(stills, job, options);
}

} // namespace rye::trainer
