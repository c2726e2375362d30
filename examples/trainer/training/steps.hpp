// SPDX-License-Identifier: Apache-2.0
/// training/steps.hpp: the steps of both stages, and what each begins with.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include <rye/train/face_smoothness.hpp>
#include <rye/train/thread_group.hpp>

#include "corrections/found_kappa.hpp"
#include "corrections/lights.hpp"
#include "model/run.hpp"

namespace rye {
struct FittedLids; // train/fit_lids.hpp
}

namespace rye::trainer {

/// Result of a step: its losses by name, and the first parameter whose gradient was not finite (the
/// step was then not taken).
struct StepReport {
    std::vector<std::pair<std::string, double>> losses;  ///< "loss", the weighted sum, first
    Index vertices = 0;                                  ///< of the surface, in stage 1
    std::string bad_field;
    std::optional<Index> refused = {};  ///< number of steps in a row, if a device counts them
    bool asked = false;                 ///< true if a rank asked all of them to stop
};

using Probe = std::function<void(const char*)>;  ///< called at the end of each part of a step

/// Returns the lattice of stage 1 around the subject's head.
TetGrid<float> make_lattice(const TrainState& state);

class MeshNetworks;  ///< on a device (device/mesh_networks.hpp); below, null means the host's

/// Fits the guidance mesh to a sphere, from the state's seed.
void pretrain_mesh(TrainState& state, MeshNetworks* networks = nullptr);

/// Result of fit_landmarks, canonical units.
struct FittedLandmarks {
    double rms = 0;   ///< remaining error of a coordinate, root mean square
    double noise = 0; ///< landmark_noise() of a coordinate, which mixed frames are freed from
};

/// Fits the guidance mesh's deformations to the landmarks of all training frames; see
/// fit_deformation. Uses the names and shapes of the capture's expressions for those that it does
/// not show, as mesh.fit_regions and fit_shapes say.
FittedLandmarks fit_landmarks(TrainState& state, const Capture& capture,
                              MeshNetworks* networks = nullptr);

/// Number of Gaussians of an avatar.
struct AvatarSize {
    Index face, eyes;
};

/// Turns the guidance mesh into an avatar with these lights and, if its gazes are visual axes, this
/// kappa, and the state into one of stage 2, step 0.
AvatarSize begin_avatar(TrainState& state, const TetGrid<float>& grid,
                        const FoundLights& lights = {}, const FoundKappa& kappa = {});

/// Returns the neighbours of the face's Gaussians at the positions where stage 2 begins: the same
/// for every state of that stage, as they are of the guidance mesh, which it keeps. Empty, and
/// nothing is done, if no weight asks for them.
FaceNeighbours first_neighbours(const TrainState& state);

/// Fits the expression's networks of the state's avatar to lids that close (fit_lids), by
/// gaussians.lid_steps; nothing is done without names of coefficients that close lids.
FittedLids close_lids(TrainState& state, const Capture& capture);

/// Steps of stage 1, with the memory that they share.
class MeshStepper {
  public:
    /// `networks`, if any, must outlive it.
    explicit MeshStepper(const TrainState& state, MeshNetworks* networks = nullptr);
    ~MeshStepper();
    /// Takes a step and adds 1 to state.step; the learning rates are multiplied by `rate`.
    StepReport step(TrainState& state, const TetGrid<float>& grid, const MeshSample<float>& sample,
                    double rate, const Probe& probe);

  private:
    struct Memory;
    std::unique_ptr<Memory> memory_;
};

/// Steps of stage 2, of the state's avatar or of its compared one.
class AvatarSteps {
  public:
    virtual ~AvatarSteps() = default;
    /// Takes a step of one picture and adds 1 to state.step.
    virtual StepReport step(TrainState& state, const AvatarSample<float>& sample, double rate,
                            const Probe& probe) = 0;
    /// Adds a picture to the step under way, of `all` of all ranks.
    virtual void add(const AvatarSample<float>& sample, Index all, const Probe& probe) = 0;
    /// Takes the step of the pictures that were added, by all ranks of a group (null: one), and
    /// adds 1 to state.step.
    virtual StepReport take(TrainState& state, ThreadGroup* group, double rate,
                            const Probe& probe) = 0;
};
/// Returns the steps of stage 2. `perceptual_weights`: a safetensors file for LPIPS, or empty for
/// the weight-free loss. The state must not move.
std::unique_ptr<AvatarSteps> avatar_steps(TrainState& state,
                                          const std::filesystem::path& perceptual_weights);

} // namespace rye::trainer
