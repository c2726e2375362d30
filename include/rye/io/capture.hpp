// SPDX-License-Identifier: Apache-2.0
/// rye/io/capture.hpp: a calibrated multi-view capture of a head, as read from a folder.
/// Lengths in the files' own world units (about 1 dm). Cameras are OpenCV, pixel centres +0.5.
/// Head frame: x subject's left, y up, z out of the face;
/// x_world = scale R(pose[:3]) x_head + pose[3:].
/// Eye 0 is the subject's left (x > 0), eye 1 the right.
/// Source: the folder of Gaussian Head Avatar (Xu et al., 2024), and rye's gaze.npz and eye masks.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <rye/io/image8.hpp>
#include <rye/io/problem.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/memory.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/math/srgb.hpp>

namespace rye {

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

/// How a capture is read.
struct CaptureOptions {
    double test_fraction = 0.2;               ///< last frames kept for tests, without capture.json
    ImageContent content = ImageContent::automatic;
    std::uint64_t memory = default_memory;    ///< of a file's arrays [bytes]; an eighth for JSON
};

/// Names of a capture, from capture.json and folder listings, without opening an array or an
/// image.
struct CaptureContents {
    std::filesystem::path folder;
    CaptureOptions options;                     ///< by which it was listed, and its frames are read
    std::string subject;                        ///< from capture.json, may be empty
    std::vector<std::string> camera_ids;
    std::vector<std::string> expression_names;  ///< empty if capture.json does not name them
    std::vector<std::string> frames;            ///< of all lists, sorted
    std::vector<std::string> train, test, novel_gaze, independent_gaze;
    bool images_over_black = true;
    std::string image_size;  ///< capture.json's, as JSON; empty if it has none
};

/// Returns the six landmarks around an eye, as columns of CaptureFrame::landmarks. In iBUG's order
/// the lids on the image's left, 36 to 41, are the subject's right eye.
constexpr std::array<int, 6> eye_landmarks(int eye) {
    return eye == 0 ? std::array<int, 6>{42, 43, 44, 45, 46, 47}
                    : std::array<int, 6>{36, 37, 38, 39, 40, 41};
}

/// Returns the landmarks common to both of Gaussian Head Avatar's sets, 66 of 66 or 68: all except
/// the lip corners 48 and 54. Throws an Error that begins with `who` for another number.
inline Columns<double> common_landmarks(const Columns<double>& all, const std::string& who) {
    if (all.cols() == 66) return all;
    require(all.cols() == 68, who, "got ", all.cols(), " landmarks, expected 66 or 68");
    Columns<double> kept(3, 66);
    kept << all.leftCols(48), all.middleCols(49, 5), all.rightCols(13);
    return kept;
}

/// Capture without its pixels: labels, cameras and names of files.
struct CaptureLabels {
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
    /// Factor of the linear light of each frame, which image() removes; empty if unknown.
    std::vector<double> frame_exposures;
    std::vector<CorrectedCamera> corrected_cameras; ///< replaced where views had the wrong numbers

    int frame_count() const { return static_cast<int>(frames.size()); }
    int camera_count() const { return static_cast<int>(camera_ids.size()); }
    int expression_width() const {
        return frames.empty() ? 0 : static_cast<int>(frames.front().expression.size());
    }
    /// Returns true if every frame has gazes.
    bool has_gaze() const {
        return std::all_of(frames.begin(), frames.end(), [](const auto& f) { return f.has_gaze; });
    }
    /// Returns true if every frame has the centres of both eyes.
    bool has_centres() const {
        return std::all_of(frames.begin(), frames.end(),
                           [](const auto& f) { return f.has_centres; });
    }
    const CaptureFrame& frame(int f) const {
        RYE_ASSERT(f >= 0 && f < frame_count(), "CaptureLabels::frame: frame out of range");
        return frames[static_cast<std::size_t>(f)];
    }
    const CaptureView& view(int frame, int camera) const {
        RYE_ASSERT(frame >= 0 && frame < frame_count() && camera >= 0 && camera < camera_count(),
                   "CaptureLabels::view: frame or camera out of range");
        return views[static_cast<std::size_t>(frame) * camera_ids.size() +
                     static_cast<std::size_t>(camera)];
    }
    const Pinhole<double>& camera(int f, int c) const { return view(f, c).camera; }
    /// Returns a view; throws an Error if the camera missed the frame.
    const CaptureView& present_view(int f, int c) const {
        const CaptureView& v = view(f, c);
        require(v.present, folder.string(), "camera ", camera_ids[static_cast<std::size_t>(c)],
                " has no frame ", frame(f).id);
        return v;
    }
};

/// Reads pictures: the size by a path, and pixels in 1 or 3 channels. read() may return a reference
/// that holds until the next call, or something that converts to one while it lives.
template <class P>
concept PictureReader = requires(P& pictures, const std::filesystem::path& path) {
    { pictures.header(path) } -> std::convertible_to<ImageHeader>;
    { pictures.read(path, 3) } -> std::convertible_to<const Image8&>;
};

namespace detail {

/// Divides a picture of 8 bits by gains, in linear light.
inline void take_out(const Vec3<double>& gains, Image<float>& rgb) {
    std::array<std::array<float, 256>, 3> table{};
    for (std::size_t c = 0; c < 3; ++c)
        for (std::size_t v = 0; v < 256; ++v) {
            const double light = linear_from_srgb(static_cast<double>(v) / 255);
            table[c][v] = static_cast<float>(
                std::min(1.0, srgb_from_linear(light / gains[static_cast<Index>(c)])));
        }
    for (Index i = 0; i < rgb.pixels.size(); ++i) {
        float& x = rgb.pixels.data()[i];
        x = table[static_cast<std::size_t>(i % 3)][static_cast<std::size_t>(
            std::lround(255.0F * x))];
    }
}

} // namespace detail

/// Capture whose images are decoded on demand by P. Several threads may read it if they may read P.
template <PictureReader P>
struct CaptureOf : CaptureLabels {
    mutable P pictures{};

    CaptureOf() = default;
    CaptureOf(CaptureLabels labels, P reader)
        : CaptureLabels(std::move(labels)), pictures(std::move(reader)) {}

    /// Returns 3 channels in [0, 1], sRGB as stored, premultiplied over black: add (1 - mask) *
    /// background.
    Image<float> image(int frame, int camera) const {
        Image<float> rgb = to_float(pictures.read(present_view(frame, camera).image, 3));
        Vec3<double> gains = Vec3<double>::Ones();
        if (!camera_gains.empty()) gains = camera_gains[static_cast<std::size_t>(camera)];
        if (!frame_exposures.empty()) gains *= frame_exposures[static_cast<std::size_t>(frame)];
        if (gains != Vec3<double>::Ones()) detail::take_out(gains, rgb);
        if (!images_over_black) {
            const Image<float> alpha = mask(frame, camera);
            rgb.pixels.array().rowwise() *= alpha.pixels.row(0).array();
        }
        return rgb;
    }
    /// Returns 1 channel in [0, 1]: coverage of the pixel by the subject.
    Image<float> mask(int frame, int camera) const {
        return to_float(pictures.read(present_view(frame, camera).mask, 1));
    }
    /// Returns 2 channels, 0 or 1: pixels of the visible left and right eyeball; zeros without an
    /// eye mask.
    Image<float> eye_mask(int frame, int camera) const {
        const CaptureView& v = present_view(frame, camera);
        Image<float> eyes(width, height, 2);
        if (v.eye_mask.empty()) return eyes;
        const auto& held = pictures.read(v.eye_mask, 1);
        const Image8& labels = held;
        for (std::size_t i = 0; i < labels.values.size(); ++i) {
            const int value = labels.values[i];
            if (value % 85 != 0) // a string for each pixel would take most of the time
                throw Error(v.eye_mask.string() + ": got the value " + std::to_string(value) +
                            ", expected 0 (none), 85 (left), 170 (right) or 255 (reserved)");
            if (value == 85 || value == 170) eyes.pixels(value / 85 - 1, static_cast<Index>(i)) = 1;
        }
        return eyes;
    }
    /// Returns 1 channel in [0, 1]: 0 where the image is padded; ones without a visible file.
    Image<float> visible(int frame, int camera) const {
        const CaptureView& v = present_view(frame, camera);
        if (v.visible.empty()) return Image<float>(width, height, 1, 1.0f);
        return to_float(pictures.read(v.visible, 1));
    }
};

} // namespace rye
