// SPDX-License-Identifier: Apache-2.0
/// evaluation/evaluation.hpp: measurements of `rye evaluate` on one view: image quality over head,
/// face and eyes, and the gaze error by the paper's protocol: an estimator on the render against
/// the same estimator on the photograph.
///
/// The photograph, not the run, decides which eyes count: those with min_eye_pixels or more in the
/// capture's eye mask. Each of them counts in every mean; if no iris is found, the error is
/// missed_degrees.
#pragma once

#include <array>
#include <cmath>
#include <functional>
#include <memory>
#include <vector>

#include <nlohmann/json.hpp>

#include "corrections/gaze_estimator.hpp"
#include "corrections/reflections.hpp"
#include "drawing/avatar_drawer.hpp"

namespace rye::trainer {

/// Error of an eye in which no iris is found: the mean angle between a direction and a random one
/// on the sphere, so that showing no iris never pays off [deg].
inline constexpr double missed_degrees = 90;

/// Half the width of the lids' margins, where 1 unit is 100 mm [mm].
inline constexpr double lid_margin_mm = 1.5;

/// Mean of the measured values.
struct Mean {
    double sum = 0;
    int count = 0;
    void add(double x) { sum += x, ++count; }
    void add(const Mean& m) { sum += m.sum, count += m.count; }
    /// Returns the mean; NaN of nothing.
    double value() const { return count > 0 ? sum / count : std::nan(""); }
    /// Returns the mean; null of nothing.
    nlohmann::ordered_json json() const;
};

/// Image quality over one area.
struct Quality {
    Mean psnr;       ///< over the area's pixels [dB], at most 99
    Mean psnr_full;  ///< over the picture, white outside the area [dB], at most 99
    Mean ssim;       ///< over the area, white outside it
    void add(const Quality& q);
    nlohmann::ordered_json json() const;
};

/// Gaze errors in one kind of pictures, over the eyes that count.
struct GazeErrors {
    Mean to_photograph;  ///< estimate against the estimate on the photograph [deg]
    Mean where_found;    ///< to_photograph, if the iris is found on both [deg]
    Mean to_label;       ///< estimate against the capture's optical axis [deg]
    Mean to_label_where_found;  ///< to_label, if the iris is found here [deg]
    int found = 0;       ///< number of eyes whose iris is found
    /// Adds an eye that counts. Estimates and the label are unit vectors in the head's frame.
    void add(const std::optional<GazeEstimate>& here, const std::optional<GazeEstimate>& photograph,
             const Vec3<double>& label);
    void add(const GazeErrors& g);
    nlohmann::ordered_json json() const;
};

/// Gaze errors for one source of the estimator's geometry, over all compared pictures.
struct GazeTable {
    GazeErrors photograph;  ///< its to_label is the estimator's own error
    GazeErrors render;      ///< avatar with the frame's gaze: the paper's figure
    GazeErrors rest;        ///< control: with the gaze at rest
    GazeErrors nearest;     ///< control: with each eye at its nearest training gaze
    void add(const GazeTable& t);
    nlohmann::ordered_json json() const;
};

struct ViewResult {
    Quality head, face, eyes;
    /// Quality over the rectangles of `eyes`, with the capture's eyeballs painted white in both
    /// pictures: the quality of the skin around the eyes.
    Quality eye_skin;
    Quality eyeballs;      ///< over the visible eyeballs of the capture
    /// Quality over the pixels of `eyes` less than lid_margin_mm from the lines of a visible eye's
    /// lids, through its landmarks, corners included.
    Quality lid_margins;
    Mean lpips;            ///< over the picture, white outside the head; empty without weights
    /// Rectangle around `eyes` of one view: x, y, width, height [px]; width 0 without visible eyes.
    std::array<int, 4> eyes_box{};
    int eyes_in_view = 0;  ///< two
    int eyes_visible = 0;  ///< number of eyes that count
    /// Errors if the estimator is given the capture's eyeball centre, radii and eye mask of the
    /// frame, the same for each picture.
    GazeTable measured;
    /// Errors if the estimator is given the run's own geometry: the eyeballs of its rig, posed by
    /// the frame's drivers, and the pixels of its own eyeball Gaussians. Uses no label of the frame
    /// except its drivers.
    GazeTable own;
    Reflections reflections; ///< what the corneas mirror
    void add(const ViewResult& v);
    nlohmann::ordered_json json() const;
};

/// Inputs of the estimator for the eyes of one view.
struct EyesOfView {
    std::array<EyeballGeometry, 2> ball;
    Image<float> area;      ///< channel e: 0.5 or more where eyeball e is visible
    double area_error = 0;  ///< largest error of the area's rim [radii of the eyeball]
};

/// View of a capture.
struct MeasuredView {
    int frame, camera;
    bool pictured = false; ///< true if its pictures are wanted
};

/// Evaluation of views of a drawn run (run.hpp). The state and the capture must outlive it.
class Evaluation {
  public:
    /// `lpips` returns LPIPS of two pictures; if it is empty, none is measured. `dilation`: of the
    /// capture's pictures [px^2].
    Evaluation(AvatarDrawer drawer, const Capture& capture, PictureDistance lpips = {},
               double dilation = trained_dilation)
        : drawer_(std::move(drawer)),
          state_(drawer_.state()),
          capture_(capture),
          lpips_(std::move(lpips)),
          dilation_(dilation) {}

    /// Receiver of a view's photograph, render, and render with the gaze at rest, by the view's
    /// index.
    using TakePicture = std::function<void(std::size_t, const Image<float>&)>;

    /// Returns the results of these views, measured in parallel on the program's threads; the same
    /// for any number of threads. `take` is called concurrently. Drawing and LPIPS, which take the
    /// memory of a frame each, run one at a time.
    std::vector<ViewResult> views(const std::vector<MeasuredView>& which,
                                  const TakePicture& take) const;

    /// Returns the result of one view; `picture` receives photograph, render, and render with the
    /// gaze at rest.
    ViewResult view(int frame, int camera, Image<float>& picture) const;

    /// Returns the eyes by the capture's labels, or by the run's rig if the capture has none.
    EyesOfView measured_eyes(int frame, int camera) const;
    /// Returns the eyes by the run's rig and its own Gaussians, drawn on the CPU.
    EyesOfView own_eyes(const Drivers<float>& drivers, const Pinhole<double>& camera) const;

  private:
    struct Render;
    struct Renders;
    struct Measured;

    EyesOfView labelled_eyes(int frame, Image<float> mask) const;
    EyesOfView eyes_of(const Drivers<float>& drivers, PosedEyes posed) const;
    Renders renders(const MeasuredView& v) const;
    Measured measured(const MeasuredView& v, Renders shown) const;
    Vec3<float> nearest_training_gaze(const Vec3<float>& gaze, std::size_t eye) const;

    AvatarDrawer drawer_;
    const TrainState& state_;
    const Capture& capture_;
    PictureDistance lpips_;
    double dilation_;
};

} // namespace rye::trainer
