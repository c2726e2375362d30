// SPDX-License-Identifier: Apache-2.0
/// c/device_by_ellipse.cpp: kernels by the rules of Balanced, with Antialias::dilate.
#include "device_drawing.hpp"

namespace rye::c {

std::unique_ptr<DeviceDrawing> drawing_by_ellipse(const AccuracyNumbers& numbers) {
    return std::make_unique<DrawingBy<Chosen<Balanced, Antialias::dilate>>>(numbers);
}

} // namespace rye::c
