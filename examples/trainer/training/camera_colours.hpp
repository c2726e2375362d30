// SPDX-License-Identifier: Apache-2.0
/// training/camera_colours.hpp: how cameras of a capture differ in gain and white balance, found
/// before a training from what several of them see of the same points of the head.
#pragma once

#include "data/capture.hpp"
#include "training/labels.hpp"

namespace rye::trainer {

/// Finds each camera's gains of red, green and blue in linear light, whose product over cameras is
/// 1, and lets the capture take them out of its pictures where they are wrong, so that an avatar
/// is trained, and measured, in the colours of the mean camera. Colours at a landmark of a frame
/// are those of its skin and light, and the camera's gain: what two cameras see there differs by
/// their gains alone, but for shine, of which the median differences of many are free. Of training
/// frames, evenly chosen; landmarks that a camera sees from the front, without eyes and mouth.
LabelFinding correct_colours(Capture& capture, const TrainConfig& config);

} // namespace rye::trainer
