// SPDX-License-Identifier: Apache-2.0
/// c/device_by_square.cpp: kernels by the rules of Compatible3dgs, with Antialias::dilate.
#include "device_drawing.hpp"

namespace rye::c {

std::unique_ptr<DeviceDrawing> drawing_by_square(const AccuracyNumbers& numbers) {
    return std::make_unique<DrawingBy<Chosen<Compatible3dgs, Antialias::dilate>>>(numbers);
}

} // namespace rye::c
