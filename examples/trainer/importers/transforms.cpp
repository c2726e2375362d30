// SPDX-License-Identifier: Apache-2.0
/// Imports photographs with a transforms.json, as in nerfstudio, instant-ngp and Blender's data
/// sets: camera to world in OpenGL axes. The world is kept.
#include <rye/core/error.hpp>

#include "data/json_fields.hpp"
#include "importers/stills.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = ImportFolder::Json;

/// Returns the file, or the file with the ending that Blender's data sets omit.
fs::path picture_of(const fs::path& file) {
    if (!fs::is_regular_file(file))
        for (const char* suffix : {".png", ".jpg", ".jpeg"})
            if (fs::path with = file.string() + suffix; fs::is_regular_file(with)) return with;
    return file;
}

/// Returns the given file; for a folder its transforms.json, or else those of Blender's data sets,
/// which divide one list into three.
std::vector<fs::path> files_of(const fs::path& source) {
    if (!fs::is_directory(source)) return {source};
    const fs::path all = source / "transforms.json";
    if (fs::exists(all)) return {all};
    std::vector<fs::path> parts;
    for (const char* part : {"train", "val", "test"})
        if (fs::path file = source / ("transforms_" + std::string(part) + ".json");
            fs::exists(file))
            parts.push_back(std::move(file));
    require(!parts.empty(), all.string(),
            "no such file, expected transforms.json of photographs (nerfstudio, instant-ngp), or "
            "transforms_train.json (Blender's data sets)");
    return parts;
}

/// Returns the file; throws an Error if it does not exist.
fs::path existing(const fs::path& file, const std::string& key, const std::string& who) {
    require(fs::is_regular_file(file), file.string(), "no such file, named by ", key, " of ", who);
    return file;
}

void add_stills(const ImportOptions& options, const fs::path& file, std::vector<Still>& stills) {
    Json json = read_json<Json>(file);
    const std::string name = file.string();
    require(json.is_object() && json.contains("frames") && json.at("frames").is_array() &&
                !json.at("frames").empty(),
            name + ": frames", "is missing or empty, expected a list of photographs");
    const std::size_t first = stills.size();
    for (std::size_t i = 0; i < json.at("frames").size(); ++i) {
        Json& frame = json.at("frames").at(i);
        const std::string who = name + ": frame " + std::to_string(i);
        require(frame.is_object() && frame.contains("file_path"), who + ": file_path",
                "is missing, expected the path of a picture");
        Still still;
        const auto of = [&](const char* key) {
            const fs::path picture = named_file(options, file.parent_path(),
                                                json_text(frame, key, "", who), who + ": " + key);
            return existing(picture_of(picture), key, who);
        };
        still.image = of("file_path");
        if (frame.contains("mask_path")) still.mask = of("mask_path");
        // Blender's data sets do not state the size of the pictures.
        if (!json.contains("w") && !frame.contains("w")) {
            const ImageHeader size = read_image_header(still.image);
            frame["w"] = size.width;
            frame["h"] = size.height;
        }
        stills.push_back(std::move(still));
    }
    const std::vector<Photograph> photographs = parse_photographs(json.dump(), name);
    for (std::size_t i = 0; i < photographs.size(); ++i)
        stills[first + i].photograph = photographs[i];
}

} // namespace

ImportSummary import_transforms(const ImportOptions& options) {
    const Json job = import_job("transforms", options);
    std::vector<Still> stills;
    for (const fs::path& file : files_of(options.source)) add_stills(options, file, stills);
    return import_stills(stills, job, options);
}

} // namespace rye::trainer
