// SPDX-License-Identifier: Apache-2.0
#include "training/mesh_steps.hpp"

namespace rye::trainer {

void pretrain_mesh_on(MeshNetworks& networks, TrainState& state) {
    pretrain_mesh_by(MeshBackend(train_backend(), networks), state);
}

StepReport mesh_step_on(MeshNetworks& networks, MeshMemory& memory, TrainState& state,
                        const MeshStepInput& in) {
    return mesh_step_by(MeshBackend(train_backend(), networks), memory, state, in);
}

} // namespace rye::trainer
