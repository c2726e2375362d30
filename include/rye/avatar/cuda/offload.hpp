// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/offload.hpp: stage 1 by an OffloadBackend: the lattice's signed distances. The
/// device is sent points and gives back one number of each: codes and the other outputs of the
/// network, a hundred times as much, never leave it.
#pragma once

#include <rye/avatar/guidance_mesh.hpp>
#include <rye/nn/cuda/offload.hpp>

namespace rye {

// Documented in guidance_mesh.hpp.
template <class T, EffectSet E, OffloadsNetworks B>
Columns<T> signed_distances(const B& backend, const GuidanceMesh<T, E>& mesh,
                            const AvatarConfig& config, const Columns<T>& points) {
    if constexpr (std::same_as<T, float> &&
                  std::same_as<detail::EncodingOf<E>, PositionalEncoding>) {
        if (backend.networks->takes(mesh.geometry.shape, points.cols()))
            return backend.networks->first_output(backend.threads, mesh.geometry, points,
                                                  config.frequencies);
    }
    return detail::signed_distances_by_blocks(backend, mesh, config, points);
}

} // namespace rye
