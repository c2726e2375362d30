// SPDX-License-Identifier: Apache-2.0
/// training/steps.hpp: the numerical work of the trainer. Its source instantiates the
/// templates of rye for the policies of types.hpp, once, so that no other source has to.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "training/run.hpp"

namespace rye::trainer {

/// What one step reports: its losses by name, and the first parameter whose gradient was not finite
/// (the step was then not taken).
struct StepReport {
    std::vector<std::pair<std::string, double>> losses;  ///< "loss", the weighted sum, first
    Index vertices = 0;                                  ///< of the surface, in stage 1
    std::string bad_field;
    std::optional<Index> refused = {};  ///< how many steps in a row, where a device counts them
};

using Probe = std::function<void(const char*)>;  ///< called at the end of each part of a step

/// The lattice of stage 1 around the subject's head.
TetGrid<float> make_lattice(const TrainState& state);

class MeshNetworks;  ///< networks on a device (training/mesh_networks.hpp); here null: the host's

/// Fits the guidance mesh to a sphere, from the state's seed.
void pretrain_mesh(TrainState& state, MeshNetworks* networks = nullptr);

/// Fits its deformations to the landmarks of all training frames; see fit_deformation. Returns the
/// root mean square error that is left, canonical units. What the capture's names and shapes of
/// expressions tell of frames that it has not is used as mesh.fit_regions and fit_shapes say.
double fit_landmarks(TrainState& state, const Capture& capture);

/// How many Gaussians an avatar has.
struct AvatarSize {
    Index face, eyes;
};

/// Turns the guidance mesh into an avatar and the state into one of stage 2, step 0.
AvatarSize begin_avatar(TrainState& state, const TetGrid<float>& grid);

/// Memory that steps of one stage share.
class MeshStepper {
  public:
    /// `networks`, if any, must live as long.
    explicit MeshStepper(const TrainState& state, MeshNetworks* networks = nullptr);
    ~MeshStepper();
    /// Adds 1 to state.step; the rates are multiplied by `rate`.
    StepReport step(TrainState& state, const TetGrid<float>& grid, const MeshSample<float>& sample,
                    double rate, const Probe& probe);

  private:
    struct Memory;
    std::unique_ptr<Memory> memory_;
};

/// As MeshStepper, for stage 2, of the state's avatar or of the one by visual axes.
class AvatarSteps {
  public:
    virtual ~AvatarSteps() = default;
    virtual StepReport step(TrainState& state, const AvatarSample<float>& sample, double rate,
                            const Probe& probe) = 0;
};
/// `perceptual_weights`: a safetensors file for LPIPS, or empty for the weight-free loss. The state
/// must stay where it is.
std::unique_ptr<AvatarSteps> avatar_steps(TrainState& state,
                                          const std::filesystem::path& perceptual_weights);

/// Error if the file of weights, if any, cannot be read.
void check_perceptual_weights(const std::filesystem::path& perceptual_weights);

/// How far two RGB pictures of one size are apart.
using PictureDistance = std::function<double(const Image<float>&, const Image<float>&)>;
/// LPIPS by the weights of such a file; empty without one.
PictureDistance lpips_of(const std::filesystem::path& perceptual_weights);

/// What an avatar shows: the feature renders, and the image after super-resolution on white.
struct AvatarView {
    Image<float> final, face, eyes;  ///< feature renders; the last two if the streams were asked for
    Image<float> high;               ///< RGB
};

/// `camera` is of the full-size image. Here and below the state is one that is drawn (run.hpp).
AvatarView render_avatar(const TrainState& state, const Drivers<float>& drivers,
                         const Pinhole<float>& camera, bool streams = false);

/// The RGB image of driven Gaussians after super-resolution, on white; as render_avatar's.
Image<float> picture_of(const TrainState& state, const Gaussians<float>& driven,
                        const Pinhole<float>& camera);

/// The eyeballs as an avatar's own rig places and shows them.
struct PosedEyes {
    std::array<Vec3<double>, 2> centre; ///< world
    /// At the camera's size; channel e: the share of the pixel's colour that eyeball e's Gaussians
    /// have when the face's are before and beside them.
    Image<float> area;
};
PosedEyes posed_eyes(const TrainState& state, const Drivers<float>& drivers,
                     const Pinhole<float>& camera);
/// Their centres alone, world units.
std::array<Vec3<double>, 2> posed_centres(const TrainState& state, const Drivers<float>& drivers);

/// A picture as of render_avatar, and its eyes as of posed_eyes, of an avatar that is driven once.
struct ShownAvatar {
    Image<float> picture;
    PosedEyes eyes;
};
ShownAvatar shown_avatar(const TrainState& state, const Drivers<float>& drivers,
                         const Pinhole<float>& camera);

/// A picture of whole blocks of super-resolution without the columns and rows that these have
/// beyond the camera's.
Image<float> of_camera(Image<float> picture, const Pinhole<float>& camera);

/// The driven Gaussians of both streams in the world, the face's first.
Gaussians<float> driven_gaussians(const TrainState& state, const Drivers<float>& drivers);

/// RGB of a feature render (its first three channels).
Image<float> rgb_of(const Image<float>& feature);

/// SSIM over an area (1 x pixels).
double masked_ssim(const Image<float>& a, const Image<float>& b, const Columns<float>& area);

} // namespace rye::trainer
