// SPDX-License-Identifier: Apache-2.0
/// training/evaluation.hpp: what `rye evaluate` measures of one view: image quality over
/// head, face and eyes, and the gaze error by the paper's protocol, an estimator on the render
/// against the same on the photograph.
///
/// The photograph decides which eyes count, not the run: those of which the capture's eye mask
/// leaves the estimator min_eye_pixels or more. Each of them counts in every mean; where no iris is
/// found, the error is missed_degrees.
#pragma once

#include <array>
#include <cmath>
#include <functional>
#include <memory>
#include <mutex>
#include <vector>

#include <nlohmann/json.hpp>

#include "training/drawing.hpp"
#include "training/gaze_estimator.hpp"

namespace rye::trainer {

/// The error of an eye in which no iris is found: the mean angle between a direction and one drawn
/// at random from the sphere, so that it is never better to show no iris.
inline constexpr double missed_degrees = 90;

/// A mean of what could be measured.
struct Mean {
    double sum = 0;
    int count = 0;
    void add(double x) { sum += x, ++count; }
    void add(const Mean& m) { sum += m.sum, count += m.count; }
    /// NaN of nothing.
    double value() const { return count > 0 ? sum / count : std::nan(""); }
    /// null of nothing.
    nlohmann::ordered_json json() const;
};

/// Image quality over one area.
struct Quality {
    Mean psnr;       ///< over the area's pixels [dB], 99 at most
    Mean psnr_full;  ///< over the picture, white outside the area [dB], 99 at most
    Mean ssim;       ///< over the area, white outside it
    void add(const Quality& q);
    nlohmann::ordered_json json() const;
};

/// The gaze in one kind of pictures, over the eyes that count.
struct GazeErrors {
    Mean to_photograph;  ///< estimate against that on the photograph [deg]
    Mean where_found;    ///< the same, of the eyes whose iris is found on both
    Mean to_label;       ///< estimate against the capture's optical axis [deg]
    Mean to_label_where_found;  ///< the same, of the eyes whose iris is found here
    int found = 0;       ///< eyes whose iris is found
    /// Adds an eye that counts. The estimates and the label are unit vectors in the head's frame.
    void add(const std::optional<GazeEstimate>& here, const std::optional<GazeEstimate>& photograph,
             const Vec3<double>& label);
    void add(const GazeErrors& g);
    nlohmann::ordered_json json() const;
};

/// One way to give the estimator its geometry, over all the pictures that are compared.
struct GazeTable {
    GazeErrors photograph;  ///< its to_label is what the estimator itself is off by
    GazeErrors render;      ///< the avatar with the frame's gaze: the figure of the paper
    GazeErrors rest;        ///< control: with the gaze at rest
    GazeErrors nearest;     ///< control: with each eye at its nearest training gaze
    void add(const GazeTable& t);
    nlohmann::ordered_json json() const;
};

struct ViewResult {
    Quality head, face, eyes;
    /// Of the same rectangles as `eyes`, with the capture's eyeballs painted white on both
    /// pictures: what the skin around the eyes is worth.
    Quality eye_skin;
    Mean lpips;            ///< over the picture, white outside the head; without weights nothing
    /// Of one view: x, y, width, height [px] around `eyes`; widths of 0 without visible eyes.
    std::array<int, 4> eyes_box{};
    int eyes_in_view = 0;  ///< two
    int eyes_visible = 0;  ///< those that count
    /// The estimator is given the capture's eyeball centre, radii and eye mask of this frame, and on
    /// each picture the same.
    GazeTable measured;
    /// The estimator is given what the run itself shows: the eyeballs of its rig, posed by the frame's
    /// drivers, and the pixels that its own eyeball Gaussians make up. No label of the frame but the
    /// drivers is read.
    GazeTable own;
    void add(const ViewResult& v);
    nlohmann::ordered_json json() const;
};

/// Inputs of the estimator: the eyes of one view.
struct EyesOfView {
    std::array<EyeballGeometry, 2> ball;
    Image<float> area;      ///< channel e: 0.5 or more where eyeball e is visible
    double area_error = 0;  ///< how far its rim may be off [radii of the eyeball]
};

/// A view of a capture.
struct MeasuredView {
    int frame, camera;
    bool pictured = false; ///< whether its pictures are wanted
};

/// Measures views of a run that is drawn (run.hpp). The state and the capture must outlive it.
class Evaluation {
  public:
    /// `lpips` gives the LPIPS of two pictures; without it there is none.
    Evaluation(AvatarDrawer drawer, const Capture& capture, PictureDistance lpips = {})
        : drawer_(std::move(drawer)),
          state_(drawer_.state()),
          capture_(capture),
          lpips_(std::move(lpips)) {}

    /// Photograph, render, and render with the gaze at rest of a view, by its place among the
    /// views.
    using TakePicture = std::function<void(std::size_t, const Image<float>&)>;

    /// These views, as many at once as the program has threads, in any order; the same results for
    /// any number of threads. `take` is called on them, at once. What draws and LPIPS, which have
    /// the memory of a frame each, are one at a time.
    std::vector<ViewResult> views(const std::vector<MeasuredView>& which,
                                  const TakePicture& take) const;

    /// One view; `picture` receives photograph, render, and render with the gaze at rest.
    ViewResult view(int frame, int camera, Image<float>& picture) const;

    /// By the capture's labels; by the run's rig where the capture has no label.
    EyesOfView measured_eyes(int frame, int camera) const;
    /// By the run's rig and its own Gaussians, drawn on the CPU.
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
    /// Of the capture, whose images are not for several threads at once.
    std::unique_ptr<std::mutex> reading_ = std::make_unique<std::mutex>();
};

} // namespace rye::trainer
