// SPDX-License-Identifier: Apache-2.0
#include "training/density.hpp"

#include "model/types.hpp"

namespace rye::trainer {

DensityChange change_face(TrainState& state) {
    const auto change = [&](auto& avatar, auto& adam) {
        return change_density(train_backend(), avatar, adam, state.config.gaussians.density);
    };
    if (state.compared) return change(state.compared->avatar, state.compared->adam);
    return change(state.avatar, state.avatar_adam);
}

} // namespace rye::trainer
