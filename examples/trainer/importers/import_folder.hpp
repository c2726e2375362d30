// SPDX-License-Identifier: Apache-2.0
/// importers/import_folder.hpp: options and summary of an import, and the capture folder that it
/// writes, frame by frame. A frame counts as complete once import.json lists it; all files are
/// replaced atomically, so an interrupted import is continued and repeats no complete frame.
/// World, head and camera conventions of rye/io/capture.hpp.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json.hpp>

#include <rye/core/columns.hpp>
#include <rye/geometry/camera.hpp>

#include "data/capture.hpp"
#include "data/folder_lock.hpp"
#include "data/picture.hpp"

namespace rye::trainer {

/// Arguments of `rye import video`.
struct VideoImport {
    std::vector<std::filesystem::path> files; ///< videos, or folders of their tracks
    std::filesystem::path modules, landmarker, tracker; ///< video_tools.hpp
    std::filesystem::path dots; ///< that were looked at in the first video (data/gaze_dots.hpp), or empty
    int every = 0;       ///< which pictures of a video are tracked; 0: chosen by their number
    int frames = 120;    ///< most frames of the capture
    int size = 512;      ///< most pixels of a side of its pictures
    double focal = 0;    ///< focal length in pixels of the tracked pictures; 0: found
    double iris_mm = 11.7; ///< diameter of an iris
    /// Called after each picture that is tracked: pictures done, pictures of this video.
    std::function<void(int, int)> progress = [](int, int) {};
};

/// Arguments of `rye import`. The command rejects options of other kinds.
struct ImportOptions {
    std::filesystem::path source;      ///< folder or file, by kind
    std::filesystem::path out;         ///< folder of the capture
    std::filesystem::path gaze;        ///< gha: CSV or npz of gazes; empty: from the iris
    std::filesystem::path calibration; ///< xgaze: folder of cam00.xml to cam17.xml
    std::filesystem::path landmarks;   ///< vhap: file of 68 vertices; empty: FLAME's
    std::vector<int> eyeballs;         ///< vhap: first and last vertex, left, then right
    std::vector<double> normalization; ///< xgaze: focal length [px], distance [mm], side [px]
    bool allow_outside = false;        ///< true: named files may lie outside its folder
    VideoImport video;
    /// Called after each frame: frames done, frames of the source.
    std::function<void(int, int)> progress = [](int, int) {};
};

/// Report of an import: found, derived and missing inputs, in sentences.
struct ImportSummary {
    int frames = 0, cameras = 0;
    int written = 0;      ///< frames of this run; the others were complete before
    bool has_head = true; ///< false for a still scene
    std::vector<std::string> found, derived, missing;
    std::string text() const;
};

/// Picture of a frame. Empty images are not written.
struct ImportView {
    std::string camera;            ///< name of the camera
    Pinhole<double> pinhole;       ///< of the picture, after undistortion
    std::filesystem::path copy_of; ///< picture whose bytes are copied; else `picture`
    Image8 picture, mask, eyes, visible;
};

/// Head in a frame; a still scene has none.
struct ImportHead {
    std::vector<double> expression;
    Vec<double, 6> pose = Vec<double, 6>::Zero(); ///< axis-angle [rad], translation
    double scale = 1;                             ///< head to world
    Columns<double> landmarks;                    ///< 3 x 66 or 68, world
    Columns<double> vertices;                     ///< 3 x V, world; V may be 0
    bool has_gaze = false;
    std::array<CaptureEye, 2> eyes; ///< valid if has_gaze
};

/// Middle of the eyeballs in the head frame of heads that have no other one; its origin is then
/// near the middle of the head.
inline const Vec3<double> eyes_in_head(0, 0.35, 0.8);

struct ImportFrame {
    std::string id;
    std::optional<ImportHead> head;
    std::vector<ImportView> views;
};

/// Contents of import.json: the job, and the facts of each complete frame.
struct ImportRecord {
    nlohmann::ordered_json job;
    std::map<std::string, nlohmann::ordered_json> frames;
};

/// Reads the text of an import.json; `who` begins the messages. Throws an Error unless it has a job
/// and frames, whose facts are true, false or non-negative numbers.
ImportRecord parse_import_record(std::string_view text, const std::string& who);

class ImportFolder {
  public:
    using Json = nlohmann::ordered_json;

    /// Opens a new folder, or one that the same job began. `job` determines the result: kind,
    /// source, options. Throws an Error if the folder holds anything else, or another import
    /// has it.
    ImportFolder(const std::filesystem::path& out, const Json& job);

    bool has(const std::string& frame) const { return record_.frames.contains(frame); }
    /// Returns the facts stored with a complete frame.
    const Json& facts(const std::string& frame) const { return record_.frames.at(frame); }
    int complete() const { return static_cast<int>(record_.frames.size()); }

    /// Writes the files of views alone, for frames whose pictures do not fit into memory together.
    void write_views(const ImportFrame& frame) const;

    /// Writes all files of a frame, then lists it as complete with its facts.
    void write(const ImportFrame& frame, const Json& facts);

    /// Returns what was written so far as a capture with these training frames, by their names;
    /// nothing if a file of it has a fault, which the verdict will name.
    std::optional<Capture> read(const Json& train) const;

    /// Replaces gazes and eyeballs of all frames with a gaze by those of the capture.
    void write_eyes(const Capture& capture) const;

    /// Replaces a further file of the folder.
    void write_file(const std::string& name, const std::string& text) const;

    /// Writes capture.json: the description, and the summary under "import".
    void finish(Json description, const ImportSummary& summary);

  private:
    void save_progress() const;
    std::filesystem::path out_;
    ImportRecord record_;
    std::optional<FolderLock> lock_;
};

/// Importers of each kind of source; each throws an Error with file, field and value for a source
/// that is not of its kind.
ImportSummary import_vhap(const ImportOptions& options);
ImportSummary import_gha(const ImportOptions& options);
ImportSummary import_xgaze(const ImportOptions& options);
ImportSummary import_colmap(const ImportOptions& options);
ImportSummary import_transforms(const ImportOptions& options);
ImportSummary import_video(const ImportOptions& options);

/// Returns the power of ten that brings a head whose landmarks span this length to about 2 units.
double unit_factor(double landmark_span);

/// Returns a factor for people: "10", "0.001".
std::string factor_text(double x);

/// Returns the keys of a job common to all kinds: kind, and the source as an absolute path.
ImportFolder::Json import_job(const std::string& kind, const ImportOptions& options);

/// Returns the file that a source names, relative to `folder`. Throws an Error that begins with
/// `who` if its name leads outside ("../x.png", "/x.png"), unless the options allow it: an import
/// copies pictures, and someone else's source could name any on this machine.
std::filesystem::path named_file(const ImportOptions& options, const std::filesystem::path& folder,
                                 const std::filesystem::path& name, const std::string& who);

/// Throws an Error if a vector holds a number that is not finite.
void require_finite_numbers(const std::vector<double>& values, const std::string& who);

} // namespace rye::trainer
