// SPDX-License-Identifier: Apache-2.0
/// model/run.hpp: the state of a training run and its checkpoint. A checkpoint holds parameters,
/// optimiser state, step and configuration; it is replaced whole or not at all. Nothing in it
/// depends on the clock, the number of threads or the run's own path.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include <rye/io/bytes.hpp>
#include <rye/nn/adam.hpp>

#include "data/config.hpp"
#include "data/samples.hpp"
#include "model/compared.hpp"

namespace rye::trainer {

enum class Stage { mesh, avatar };

/// State that the next step depends on.
struct TrainState {
    Stage stage = Stage::mesh;
    Index step = 0;          ///< steps done in this stage
    TrainConfig config;
    std::string capture;     ///< the capture's folder, as given
    std::string frames;      ///< frames_mark of the run's frames; empty for a run without them
    Subject subject;
    std::vector<int> train_frames;  ///< columns of delta_pose
    /// view_directions() of the capture; set by a training alone.
    Columns<double> view_directions = {};
    Mesh mesh;
    Adam<Mesh> mesh_adam;
    Avatar avatar;           ///< empty in stage 1
    Adam<Avatar> avatar_adam;
    /// Used instead of these two by a run with another gaze mechanism than rotation. In a drawn
    /// state it has no optimiser's moments, and `avatar` is all of it except the mechanism.
    std::optional<ComparedTraining> compared;
};

inline std::filesystem::path checkpoint_path(const std::filesystem::path& run) {
    return run / "checkpoint.safetensors";
}

/// Returns an avatar whose networks have the shapes of the state's configuration and mesh, with a
/// correction for each of its frames, and without Gaussians.
Avatar avatar_shape(const TrainState& state);

/// Replaces the checkpoint. Throws an Error, before anything is written, if a number of the state
/// is not finite: such a checkpoint could not be read again.
void save_checkpoint(const std::filesystem::path& run, const TrainState& state);

/// Returns the checkpoint of a run. Throws an Error that names file and field for anything missing,
/// of another version or shape, out of range or not finite. Allocates no more than a few times the
/// size of the file.
TrainState load_checkpoint(const std::filesystem::path& run);
/// Returns the checkpoint in these bytes, as load_checkpoint; `who` begins the messages.
TrainState parse_checkpoint(ByteSpan bytes, const std::string& who);

/// Returns a run whose second stage has taken a step, to be drawn; otherwise throws an Error that
/// names the command that continues it.
TrainState load_trained(const std::filesystem::path& run);

/// Returns a state that draws the same pictures but cannot be trained: without the mesh and the
/// optimisers' moments.
TrainState drawn_state(const TrainState& state);

/// Returns the drivers, whose gazes are of the run's gaze_axis, with optical axes in their place.
OpticalDrivers<float> optical_drivers(const TrainState& state, const Drivers<float>& drivers);

} // namespace rye::trainer
