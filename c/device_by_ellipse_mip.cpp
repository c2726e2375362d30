// SPDX-License-Identifier: Apache-2.0
/// c/device_by_ellipse_mip.cpp: kernels by the rules of Balanced, with Antialias::mip.
#include "device_drawing.hpp"

namespace rye::c {

std::unique_ptr<DeviceDrawing> drawing_by_ellipse_mip(const AccuracyNumbers& numbers) {
    return std::make_unique<DrawingBy<Chosen<Balanced, Antialias::mip>>>(numbers);
}

} // namespace rye::c
