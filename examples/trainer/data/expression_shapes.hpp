// SPDX-License-Identifier: Apache-2.0
/// data/expression_shapes.hpp: displacements by the expression coefficients of a capture's face
/// model, from the optional file expression_shapes.npz.
#pragma once

#include <string>

#include <rye/io/bytes.hpp>

#include "data/capture.hpp"

namespace rye::trainer {

/// Returns E x 3 L, the displacement (e, 3 l + axis) by a coefficient of 1 in the head frame, for
/// the landmarks of frame_landmarks; empty without the file. Throws an Error for a file that does
/// not fit the capture or has numbers that are not finite.
Columns<double> expression_shapes(const Capture& capture);
/// Returns the same for the sparse landmarks and every stride-th vertex (chosen_landmarks).
Columns<double> expression_shapes(const Capture& capture, Index stride);
/// Returns the same from the bytes of the file, for these numbers of coefficients and of a frame's
/// vertices, of which every stride-th is taken (0: as by frame_landmarks); `who` begins the
/// messages.
Columns<double> parse_expression_shapes(ByteSpan bytes, const std::string& who, Index expression,
                                        Index vertices, Index stride = 0);

} // namespace rye::trainer
