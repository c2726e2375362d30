// SPDX-License-Identifier: Apache-2.0
/// data/capture.hpp: a calibrated multi-view capture of a head, read from a folder.
/// Lengths in the files' own world units (about 1 dm). Cameras are OpenCV, pixel centres +0.5.
/// Head frame: x subject's left, y up, z out of the face;
/// x_world = scale R(pose[:3]) x_head + pose[3:].
/// Eye 0 is the subject's left (x > 0), eye 1 the right.
/// Source: the folder of Gaussian Head Avatar (Xu et al., 2024), and rye's gaze.npz and eye masks.
#pragma once

#include <array>
#include <filesystem>
#include <list>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/geometry/camera.hpp>

#include "data/picture.hpp"

namespace rye::trainer {

/// A fault of a capture, in one sentence that names file, field and value.
struct Problem {
    enum class Severity { warning, error };
    Severity severity = Severity::error;
    std::string message;
};

/// Data of one eye in one frame, from gaze.npz.
struct CaptureEye {
    Vec3<double> optical = Vec3<double>::UnitZ();  ///< unit optical axis, head frame
    std::optional<Vec3<double>> optical_world;     ///< the same in the world, if the file has it
    std::optional<Vec3<double>> visual;            ///< unit visual axis, head frame
    std::optional<Vec3<double>> centre;            ///< centre of rotation, world
    std::optional<Vec2<double>> kappa;             ///< optical - visual (yaw, pitch) [deg]
    std::optional<double> radius;                  ///< of the sclera, world units
    std::optional<double> limbus_radius;           ///< rim of the iris, world units
    std::optional<double> iris_plane;              ///< iris lies near centre + iris_plane * optical
};

/// Moment common to all cameras.
struct CaptureFrame {
    std::string id;                 ///< name of its folders
    std::vector<float> expression;  ///< exp_coeff, any width, the same in all frames
    Vec<double, 6> pose = Vec<double, 6>::Zero();  ///< axis-angle [rad], translation
    double scale = 1;                              ///< head to world
    Columns<double> landmarks;                     ///< 3 x 66, world: iBUG without 48 and 54
    Columns<double> vertices;                      ///< 3 x V, world; V may be 0
    std::array<CaptureEye, 2> eyes;                ///< valid if has_gaze
    bool has_gaze = false;                         ///< gaze.npz exists
    bool has_centres = false;                      ///< gaze.npz has both eye centres
};

/// Frame as seen by one camera. Paths of missing optional files are empty.
struct CaptureView {
    Pinhole<double> camera;  ///< of the full-size image
    std::filesystem::path image, mask, eye_mask, visible;
    bool present = false;    ///< false: this camera missed this frame
};

/// Camera whose numbers are wrong, and the numbers that replace them.
struct CorrectedCamera {
    std::string camera;
    Pinhole<double> wrong, right;
};

/// Content of an image file outside the mask.
enum class ImageContent {
    automatic,   ///< over_black if capture.json says so, else photograph
    over_black,  ///< premultiplied: black where the mask is 0
    photograph,  ///< background; multiplied by the mask on reading
};

struct CaptureOptions {
    double test_fraction = 0.2;               ///< last frames kept for tests, without capture.json
    std::size_t cache_bytes = std::size_t(1) << 30U;  ///< limit on decoded 8-bit images
    ImageContent content = ImageContent::automatic;
};

/// Names of a capture, from capture.json and folder listings, without opening an array or an
/// image.
struct CaptureContents {
    std::filesystem::path folder;
    std::string subject;                        ///< from capture.json, may be empty
    std::vector<std::string> camera_ids;
    std::vector<std::string> expression_names;  ///< empty if capture.json does not name them
    std::vector<std::string> frames;            ///< of all lists, sorted
    std::vector<std::string> train, test, novel_gaze, independent_gaze;
    bool images_over_black = true;
    std::string image_size;  ///< capture.json's, as JSON; empty if it has none
};

/// Returns the landmarks common to both of Gaussian Head Avatar's sets, 66 of 66 or 68: all except
/// the lip corners 48 and 54. Throws an Error that begins with `who` for another number.
Columns<double> common_landmarks(const Columns<double>& all, const std::string& who);

/// Cache of decoded 8-bit images that evicts the least recently used first.
class ImageCache {
public:
    explicit ImageCache(std::size_t budget = std::size_t(1) << 30U) : budget_(budget) {}
    ImageCache(ImageCache&&) = default;
    ImageCache& operator=(ImageCache&&) = default;

    /// Returns the image of `path` in `channels`, read unless cached; valid until the next call.
    const Image8& get(const std::filesystem::path& path, int channels);
    std::size_t bytes() const { return bytes_; }

private:
    struct Entry {
        std::string key;
        Image8 image;
    };
    std::size_t budget_;
    std::size_t bytes_ = 0;
    std::list<Entry> entries_;  // most recently used first
    std::map<std::string, std::list<Entry>::iterator> by_key_;
};

/// Capture whose images are decoded on demand and cached: not for concurrent use by several
/// threads.
struct Capture {
    std::filesystem::path folder;
    std::string subject;                      ///< from capture.json, may be empty
    std::vector<std::string> camera_ids;
    std::vector<std::string> expression_names;  ///< empty if capture.json does not name them
    std::vector<CaptureFrame> frames;
    std::vector<CaptureView> views;           ///< frames x cameras, a frame's views adjacent
    std::vector<int> train, test, novel_gaze, independent_gaze;  ///< indices of frames
    int width = 0;                            ///< of the full-size images [px]
    int height = 0;
    bool images_over_black = true;            ///< of the files; image() is always over black
    bool has_eye_masks = false;               ///< true if every present view has one
    /// Factors of the linear light of red, green and blue for each camera, which image() removes;
    /// empty if unknown.
    std::vector<Vec3<double>> camera_gains;
    std::vector<CorrectedCamera> corrected_cameras; ///< replaced where views had the wrong numbers

    int frame_count() const { return static_cast<int>(frames.size()); }
    int camera_count() const { return static_cast<int>(camera_ids.size()); }
    int expression_width() const {
        return frames.empty() ? 0 : static_cast<int>(frames.front().expression.size());
    }
    bool has_gaze() const;       ///< true if every frame has it
    bool has_centres() const;    ///< true if every frame has them
    const CaptureView& view(int frame, int camera) const;
    const Pinhole<double>& camera(int f, int c) const { return view(f, c).camera; }

    /// Returns 3 channels in [0, 1], sRGB as stored, premultiplied over black: add (1 - mask) *
    /// background.
    Image<float> image(int frame, int camera) const;
    /// Returns 1 channel in [0, 1]: coverage of the pixel by the subject.
    Image<float> mask(int frame, int camera) const;
    /// Returns 2 channels, 0 or 1: pixels of the visible left and right eyeball; zeros without an
    /// eye mask.
    Image<float> eye_mask(int frame, int camera) const;
    /// Returns 1 channel in [0, 1]: 0 where the image is padded; ones without a visible file.
    Image<float> visible(int frame, int camera) const;

    mutable ImageCache cache;
};

/// Returns the six landmarks around an eye, as columns of CaptureFrame::landmarks. In iBUG's order
/// the lids on the image's left, 36 to 41, are the subject's right eye.
constexpr std::array<int, 6> eye_landmarks(int eye) {
    return eye == 0 ? std::array<int, 6>{42, 43, 44, 45, 46, 47}
                    : std::array<int, 6>{36, 37, 38, 39, 40, 41};
}

/// Returns the contents; throws an Error if capture.json or the folder is not that of a capture.
CaptureContents read_contents(const std::filesystem::path& folder,
                              const CaptureOptions& options = {});

/// Reads one frame for these cameras, without pixels; opens no file of another frame or camera. All
/// of its views may be absent. Reports faults as read_capture does.
Capture read_capture_frame(const CaptureContents& contents, const std::string& frame,
                           const std::vector<std::string>& cameras,
                           const CaptureOptions& options = {},
                           std::vector<Problem>* problems = nullptr);

/// Reads a camera_<name>.npz; its size is not in it. Throws an Error that names file and field.
Pinhole<double> read_capture_camera(const std::filesystem::path& path);

/// Reads everything except the pixels. Without `problems` throws the first fault as an Error;
/// otherwise adds every fault to the list and returns the rest.
Capture read_capture(const std::filesystem::path& folder, const CaptureOptions& options = {},
                     std::vector<Problem>* problems = nullptr);

} // namespace rye::trainer
