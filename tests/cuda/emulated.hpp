// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/emulated.hpp: what tests launch kernels with where the host emulates the device. The
/// same cases run on a device by on_device.hpp.
#pragma once

#include <rye/backend/cuda/emulation.hpp>

namespace rye::test {

inline HostMemory host_memory;
inline const CudaQueue host_queue{nullptr, host_memory};

/// Orders in which the threads of a phase may run: a missing barrier shows.
inline constexpr PhaseOrder phase_orders[] = {PhaseOrder::forward, PhaseOrder::backward,
                                              PhaseOrder::shuffled};

} // namespace rye::test
