// SPDX-License-Identifier: Apache-2.0
#include "importers/stills.hpp"

#include <algorithm>
#include <cctype>
#include <set>

#include <rye/core/error.hpp>

#include "data/threads.hpp"
#include "importers/face_geometry.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = ImportFolder::Json;

const std::string only_frame = "0000";

std::string size_text(int width, int height) {
    return std::to_string(width) + " x " + std::to_string(height);
}

/// Returns names of cameras, distinct and without slashes: that of each picture without its ending,
/// with its folder if two pictures have the same name.
std::vector<std::string> camera_names(const std::vector<Still>& stills) {
    std::vector<std::string> names;
    std::set<std::string> used, stems;
    for (const Still& s : stills) stems.insert(s.image.stem().string());
    const bool with_folder = stems.size() < stills.size();
    for (const Still& s : stills) {
        std::string name = s.image.stem().string();
        if (with_folder) name.insert(0, s.image.parent_path().filename().string() + "_");
        for (char& c : name)
            if (std::isalnum(static_cast<unsigned char>(c)) == 0 && c != '-') c = '_';
        // "image_lowres_..." is a half-size image of Gaussian Head Avatar.
        if (name.starts_with("lowres_")) name.insert(0, "photo_");
        std::string distinct = name;
        for (int i = 2; !used.insert(distinct).second; ++i)
            distinct = name + "_" + std::to_string(i);
        names.push_back(distinct);
    }
    return names;
}

/// Returns a larger image of zeros with the image in the upper left corner.
Image8 extended_to(const Image8& image, ImageSize size) {
    if (image.values.empty() || (image.width == size.width && image.height == size.height))
        return image;
    const auto channels = static_cast<std::size_t>(image.channels);
    const auto row = static_cast<std::size_t>(image.width) * channels;
    const auto wide = static_cast<std::size_t>(size.width) * channels;
    Image8 out{size.width, size.height, image.channels,
               std::vector<std::uint8_t>(wide * static_cast<std::size_t>(size.height))};
    for (std::size_t y = 0; y < static_cast<std::size_t>(image.height); ++y)
        std::copy_n(image.values.begin() + static_cast<std::ptrdiff_t>(y * row), row,
                    out.values.begin() + static_cast<std::ptrdiff_t>(y * wide));
    return out;
}

/// Returns the last channel of an image with alpha.
Image8 alpha_of(const Image8& image) {
    Image8 alpha = plain_image(image.width, image.height, 0);
    const auto channels = static_cast<std::size_t>(image.channels);
    for (std::size_t i = 0; i < alpha.values.size(); ++i)
        alpha.values[i] = image.values[i * channels + channels - 1];
    return alpha;
}

ImportView view_of(const Still& still, const std::string& name, ImageSize size) {
    ImportView view;
    view.camera = name;
    view.pinhole = still.photograph.camera;
    const Image8 stored = read_image8(still.image);
    const Pinhole<double>& camera = still.photograph.camera;
    require(
        stored.width == camera.width && stored.height == camera.height, still.image.string(),
        "got ", [&] { return size_text(stored.width, stored.height); }, " pixels, expected ",
        [&] { return size_text(camera.width, camera.height); }, " as its camera has");
    if (!still.mask.empty()) {
        view.mask = read_image8(still.mask, 1);
        require(
            view.mask.width == stored.width && view.mask.height == stored.height,
            still.mask.string(), "got ",
            [&] { return size_text(view.mask.width, view.mask.height); }, " pixels, expected ",
            [&] { return size_text(stored.width, stored.height); }, " as the picture has");
    } else if (stored.channels == 2 || stored.channels == 4) {
        view.mask = alpha_of(stored);
    }
    const bool extended = size.width != stored.width || size.height != stored.height;
    const bool bent = still.photograph.bent();
    if (!bent && !extended && stored.channels != 2 && stored.channels != 4) {
        view.copy_of = still.image;
        return view;
    }
    view.picture = read_image8(still.image, 3);
    if (bent) {
        if (!view.mask.values.empty())
            view.mask = straightened(view.mask, camera, still.photograph.lens).picture;
        Straightened s = straightened(view.picture, camera, still.photograph.lens);
        view.picture = std::move(s.picture);
        view.visible = std::move(s.visible);
    } else if (extended) {
        view.visible = plain_image(stored.width, stored.height, 255);
    }
    for (Image8* image : {&view.picture, &view.mask, &view.visible})
        *image = extended_to(*image, size);
    view.pinhole.width = size.width;
    view.pinhole.height = size.height;
    return view;
}

/// Returns a transforms.json of the capture's pinholes, for `rye render --cameras` and other
/// programs.
std::string transforms_text(const std::vector<Still>& stills, const std::vector<std::string>& names,
                            const fs::path& out, ImageSize size) {
    Json json = {{"camera_model", "PINHOLE"}, {"w", size.width}, {"h", size.height}};
    json["frames"] = Json::array();
    for (std::size_t i = 0; i < stills.size(); ++i) {
        const Pinhole<double>& c = stills[i].photograph.camera;
        const Mat3<double> axes = c.camera_from_world.rotation.transpose();
        const Vec3<double> centre = c.centre();
        Json matrix = Json::array();
        for (Index r = 0; r < 3; ++r) // OpenGL's y and z are opposite
            matrix.push_back({axes(r, 0), -axes(r, 1), -axes(r, 2), centre[r]});
        matrix.push_back({0, 0, 0, 1});
        std::string picture = "images/" + only_frame + "/image_" + names[i] + ".png";
        if (!fs::exists(out / picture)) picture.replace(picture.size() - 3, 3, "jpg");
        json["frames"].push_back({{"file_path", picture},
                                  {"fl_x", c.fx},
                                  {"fl_y", c.fy},
                                  {"cx", c.cx},
                                  {"cy", c.cy},
                                  {"transform_matrix", matrix}});
    }
    return json.dump(1) + "\n";
}

} // namespace

ImportSummary import_stills(const std::vector<Still>& stills, const Json& job,
                            const ImportOptions& options) {
    const std::vector<std::string> names = camera_names(stills);
    ImageSize size{0, 0};
    int bent = 0, masks = 0, smaller = 0;
    for (const Still& s : stills) {
        require(fs::is_regular_file(s.image), s.image.string(),
                "no such file, expected a picture of the source");
        size.width = std::max(size.width, s.photograph.camera.width);
        size.height = std::max(size.height, s.photograph.camera.height);
        bent += s.photograph.bent() ? 1 : 0;
    }
    for (const Still& s : stills) {
        const ImageHeader header = read_image_header(s.image);
        masks += !s.mask.empty() || header.channels == 2 || header.channels == 4 ? 1 : 0;
        smaller += header.width != size.width || header.height != size.height ? 1 : 0;
    }
    ImportFolder folder(options.out, job);
    ImportSummary summary;
    summary.frames = 1;
    summary.has_head = false;
    summary.cameras = static_cast<int>(stills.size());
    if (!folder.has(only_frame)) {
        ImportFrame frame{only_frame, {}, {}};
        // One picture at a time: a photograph has tens of megapixels.
        for (std::size_t i = 0; i < stills.size(); ++i) {
            ImportFrame one{only_frame, {}, {}};
            one.views.push_back(view_of(stills[i], names[i], size));
            folder.write_views(one);
            options.progress(static_cast<int>(i + 1), summary.cameras);
        }
        folder.write(frame, Json::object());
        summary.written = 1;
    }
    summary.found = {std::to_string(stills.size()) + " pictures and cameras, " +
                     std::to_string(masks) + " masks"};
    if (bent > 0)
        summary.derived.push_back(std::to_string(bent) +
                                  " pictures straightened from their lens to pinholes");
    if (smaller > 0)
        summary.derived.push_back(std::to_string(smaller) + " pictures extended to " +
                                  size_text(size.width, size.height) + " pixels (`visible`)");
    summary.missing = {
        "pose, expression, landmarks, gaze and eye masks of a head: for an avatar "
        "track it with VHAP and use `rye import vhap`"};
    if (masks < summary.cameras)
        summary.missing.insert(
            summary.missing.begin(),
            std::to_string(summary.cameras - masks) + " masks of the subject (mask_<camera>.png)");
    folder.write_file("transforms.json", transforms_text(stills, names, options.out, size));
    folder.finish({{"subject", options.source.filename().string()},
                   {"image_size", {size.width, size.height}},
                   {"train_frames", {only_frame}},
                   {"camera_ids", names},
                   {"conventions",
                    {{"image", "photographs; multiplied by the mask when read"},
                     {"world", "that of the source"}}}},
                  summary);
    return summary;
}

} // namespace rye::trainer
