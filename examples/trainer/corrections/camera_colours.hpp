// SPDX-License-Identifier: Apache-2.0
/// corrections/camera_colours.hpp: differences of a capture's cameras in gain and white balance, and of
/// its frames in exposure, found before a training from the colours of the same points of the head.
#pragma once

#include <vector>

#include "corrections/labels.hpp"
#include "data/capture.hpp"

namespace rye::trainer {

/// Finds each camera's gains of red, green and blue in linear light, whose product over cameras is
/// 1. If they are wrong, makes the capture remove them from its pictures, so that an avatar is
/// trained and measured in the colours of the mean camera. The colour at a landmark of a frame is a
/// product of skin, light and the camera's gain: two cameras differ there by their gains alone,
/// except for shine, which the median of many differences suppresses. Uses evenly chosen training
/// frames, and landmarks that a camera sees from the front, without eyes and mouth.
///
/// Then finds each frame's exposure, a factor of the light alike in all channels and cameras, whose
/// product over all frames, for training and test, is 1: the colour at a landmark in a camera is a
/// product of skin, exposure, and a light that stays where it is while the head turns. Wrong ones
/// are removed in the same way. Heads of one exposure seem 2 to 5 % apart. Captures of
/// more than 1200 frames are not judged, since all of their pictures would be read.
std::vector<LabelFinding> correct_colours(Capture& capture, const TrainConfig& config);

} // namespace rye::trainer
