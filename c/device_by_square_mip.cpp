// SPDX-License-Identifier: Apache-2.0
/// c/device_by_square_mip.cpp: kernels by the rules of Compatible3dgs, with Antialias::mip.
#include "device_drawing.hpp"

namespace rye::c {

std::unique_ptr<DeviceDrawing> drawing_by_square_mip(const AccuracyNumbers& numbers) {
    return std::make_unique<DrawingBy<Chosen<Compatible3dgs, Antialias::mip>>>(numbers);
}

} // namespace rye::c
