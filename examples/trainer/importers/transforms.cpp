// SPDX-License-Identifier: Apache-2.0
/// Imports photographs with a transforms.json, as nerfstudio, instant-ngp and Blender's data sets
/// have it: camera to world in OpenGL axes. The world is kept.
#include <rye/core/error.hpp>

#include "data/json.hpp"
#include "importers/stills.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = ImportFolder::Json;

/// The file, or with the ending that Blender's data sets leave out.
fs::path picture_of(const fs::path& file) {
    if (!fs::exists(file))
        for (const char* suffix : {".png", ".jpg", ".jpeg"})
            if (fs::path with = file.string() + suffix; fs::exists(with)) return with;
    return file;
}

} // namespace

ImportSummary import_transforms(const ImportOptions& options) {
    const Json job = import_job("transforms", options);
    const fs::path file =
        fs::is_directory(options.source) ? options.source / "transforms.json" : options.source;
    require(fs::exists(file), file.string(),
            "no such file, expected transforms.json of photographs (nerfstudio, instant-ngp)");
    Json json = read_json<Json>(file);
    const std::string name = file.string();
    require(json.is_object() && json.contains("frames") && json.at("frames").is_array() &&
                !json.at("frames").empty(),
            name + ": frames", "is missing or empty, expected a list of photographs");
    std::vector<Still> stills;
    for (std::size_t i = 0; i < json.at("frames").size(); ++i) {
        Json& frame = json.at("frames").at(i);
        const std::string who = name + ": frame " + std::to_string(i);
        require(
            frame.is_object() && frame.contains("file_path") && frame.at("file_path").is_string(),
            who + ": file_path", "is missing, expected the path of a picture");
        Still still;
        const auto named = [&](const char* key) {
            return named_file(options, file.parent_path(), frame.at(key).get<std::string>(),
                              who + ": " + key);
        };
        still.image = picture_of(named("file_path"));
        require(fs::is_regular_file(still.image), still.image.string(),
                "no such file, named by file_path of " + who);
        if (frame.contains("mask_path")) {
            require(frame.at("mask_path").is_string(), who + ": mask_path",
                    "got " + frame.at("mask_path").dump() + ", expected a path");
            still.mask = named("mask_path");
            require(fs::is_regular_file(still.mask), still.mask.string(),
                    "no such file, named by mask_path of " + who);
        }
        if (!json.contains("w") && !frame.contains("w")) {
            const ImageHeader size = read_image_header(still.image);
            frame["w"] = size.width;
            frame["h"] = size.height;
        }
        stills.push_back(std::move(still));
    }
    const std::vector<Photograph> photographs = parse_photographs(json.dump(), name);
    for (std::size_t i = 0; i < stills.size(); ++i) stills[i].photograph = photographs[i];
    return import_stills(stills, job, options);
}

} // namespace rye::trainer
