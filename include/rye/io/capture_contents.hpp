// SPDX-License-Identifier: Apache-2.0
/// rye/io/capture_contents.hpp: the names in a capture: capture.json, which is optional, and
/// the folders of images. Opens no array and no image. Faults name file, field and value.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <rye/io/bytes.hpp>
#include <rye/io/capture.hpp>
#include <rye/io/json.hpp>
#include <rye/core/error.hpp>

namespace rye {

namespace detail {

using NameSet = std::set<std::string>;

/// Largest capture.json that is read [bytes].
inline constexpr std::uint64_t max_description = 1ULL << 26U;

inline std::vector<std::string> sorted_names(const NameSet& names) {
    return {names.begin(), names.end()};
}

inline NameSet list_frames(const std::filesystem::path& folder) {
    const std::filesystem::path images = folder / "images";
    require(std::filesystem::is_directory(images), images.string(),
            "no such folder, expected it to hold one folder of images per frame");
    NameSet names;
    for (const auto& entry : std::filesystem::directory_iterator(images))
        if (entry.is_directory()) names.insert(entry.path().filename().string());
    require(!names.empty(), images.string(), "has no folders, expected one per frame");
    return names;
}

inline NameSet list_cameras(const std::filesystem::path& folder, const NameSet& frames) {
    NameSet ids;
    for (const std::string& frame : frames)
        for (const auto& entry : std::filesystem::directory_iterator(folder / "images" / frame)) {
            const std::string stem = entry.path().stem().string();
            if (stem.starts_with("image_") && !stem.starts_with("image_lowres_"))
                ids.insert(stem.substr(6));
        }
    require(!ids.empty(), (folder / "images").string(), "has no files named image_<camera>.jpg");
    return ids;
}

/// capture.json; each field is optional, and so is the file.
class CaptureDescription {
  public:
    CaptureDescription(const std::filesystem::path& path, std::uint64_t memory)
        : who_(path.string()) {
        if (!std::filesystem::exists(path)) return;
        const Bytes bytes = read_file(path, max_description);
        std::string_view text = as_text(bytes);
        if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);  // a mark of UTF-8
        require_utf8(text, who_);
        json_ = parse_json(text, who_, memory);
        require(json_.get<JsonObject>() != nullptr, who_, "expected an object");
    }

    bool has(std::string_view key) const { return json_.find(key) != nullptr; }
    /// Returns the field as JSON; empty if it is absent.
    std::string json(std::string_view key) const {
        const JsonValue* value = json_.find(key);
        return value == nullptr ? std::string() : json_text(*value);
    }
    /// Returns a text; empty if the field is absent or no text.
    std::string text(std::string_view key) const { return text_of(json_.find(key)); }
    std::string convention(std::string_view key) const {
        const JsonValue* all = json_.find("conventions");
        return all == nullptr ? std::string() : text_of(all->find(key));
    }
    /// Returns a list of names; empty if the field is absent.
    std::vector<std::string> names(const char* key) const {
        std::vector<std::string> out;
        const JsonValue* value = json_.find(key);
        if (value == nullptr) return out;
        const std::string who = who_ + ": " + key;
        const auto* list = value->get<JsonArray>();
        require(list != nullptr, who, "expected a list of names");
        NameSet seen;
        for (const JsonValue& item : *list) {
            const auto* name = item.get<std::string>();
            require(
                name != nullptr, who, "got ", [&] { return json_text(item); }, ", expected a name");
            // Names become path components.
            require(!name->empty() && name->find_first_of("/\\") == std::string::npos &&
                        *name != "..",
                    who, "got '", *name, "', expected a name without slashes");
            require(seen.insert(*name).second, who, "names '", *name, "' twice");
            out.push_back(*name);
        }
        return out;
    }
    const std::string& who() const { return who_; }

  private:
    static std::string text_of(const JsonValue* value) {
        const auto* text = value == nullptr ? nullptr : value->get<std::string>();
        return text == nullptr ? std::string() : *text;
    }

    std::string who_;
    JsonValue json_ = {nullptr};
};

/// Sets the lists of frames as capture.json has them.
inline void described_splits(const CaptureDescription& from, CaptureContents& c) {
    c.train = from.names("train_frames");
    c.test = from.names("test_frames");
    c.novel_gaze = from.names("novel_gaze_test_frames");
    c.independent_gaze = from.names("independent_gaze_test_frames");
    const NameSet train(c.train.begin(), c.train.end());
    for (const auto* list : {&c.test, &c.novel_gaze, &c.independent_gaze})
        for (const std::string& id : *list)
            require(!train.contains(id), from.who(), "frame '", id,
                    "' is in train_frames and in a list of test frames");
    require(!c.train.empty(), from.who(), "train_frames is empty, expected at least one frame");
}

/// Assigns the last frames to the tests, at least one of two or more.
inline void default_splits(const std::vector<std::string>& ids, CaptureContents& c) {
    const double share = c.options.test_fraction;
    require(
        share >= 0 && share < 1, "test_fraction", "got ", [&] { return std::to_string(share); },
        ", expected 0 to below 1");
    auto tests =
        static_cast<std::ptrdiff_t>(std::lround(static_cast<double>(ids.size()) * share));
    if (share > 0 && ids.size() > 1) tests = std::max<std::ptrdiff_t>(tests, 1);
    tests = std::min(tests, static_cast<std::ptrdiff_t>(ids.size()) - 1);
    c.train.assign(ids.begin(), ids.end() - tests);
    c.test.assign(ids.end() - tests, ids.end());
}

inline CaptureContents list_contents(const std::filesystem::path& folder,
                                     const CaptureOptions& options, Faults& faults) {
    namespace fs = std::filesystem;
    CaptureContents c;
    c.folder = folder;
    c.options = options;
    require(fs::is_directory(folder), folder.string(), "no such folder");
    require(fs::exists(folder / "cameras") || !fs::exists(folder / "transforms.json"),
            (folder / "transforms.json").string(),
            "a folder of photographs, expected a capture (folders images, cameras, params)");
    const CaptureDescription about(folder / "capture.json", options.memory / 8);
    c.subject = about.text("subject");
    c.expression_names = about.names("exp_names");
    c.images_over_black = options.content == ImageContent::automatic
                              ? about.convention("image").find("over black") != std::string::npos
                              : options.content == ImageContent::over_black;
    c.image_size = about.json("image_size");

    const NameSet on_disk = list_frames(folder);
    c.camera_ids = about.names("camera_ids");
    if (c.camera_ids.empty()) c.camera_ids = sorted_names(list_cameras(folder, on_disk));
    if (about.has("train_frames")) described_splits(about, c);
    else default_splits(sorted_names(on_disk), c);
    NameSet wanted;
    for (const auto* list : {&c.train, &c.test, &c.novel_gaze, &c.independent_gaze})
        wanted.insert(list->begin(), list->end());
    for (const std::string& id : on_disk)
        if (!wanted.contains(id))
            faults.warning(about.who() + ": frame '" + id + "' is in no list and is left out");
    c.frames = sorted_names(wanted);
    return c;
}

} // namespace detail

/// Lists a capture. Throws an Error if capture.json or the folder is not that of a capture.
inline CaptureContents capture_contents(const std::filesystem::path& folder,
                                        const CaptureOptions& options = {}) {
    CaptureContents contents;
    Faults faults(nullptr);
    faults.attempt([&] { contents = detail::list_contents(folder, options, faults); });
    return contents;
}

} // namespace rye
