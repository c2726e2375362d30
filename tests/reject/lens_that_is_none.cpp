// SPDX-License-Identifier: Apache-2.0
// A lens bends slopes; a number does not.
// expect: constraint|Distortion
#include <rye/geometry/camera.hpp>

#if REJECT
using Lens = float;
#else
using Lens = rye::BrownConrady<float>;
#endif

rye::Pinhole<float, Lens> camera() { return {}; }
