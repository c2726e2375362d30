// SPDX-License-Identifier: Apache-2.0
/// rye/train/label_drawing.hpp: what LabelRefiner (train/refine_labels.hpp) draws a frame with and
/// differentiates it by the labels, on the host (train/host_label_drawing.hpp) or on a device
/// (train/cuda/label_drawing.hpp).
#pragma once

#include <concepts>
#include <vector>

#include <rye/interactive/drive_work.hpp>
#include <rye/train/label_unknowns.hpp>

namespace rye {

/// Colours of a photograph that count, with their part in the normal equations.
struct WeighedColours {
    std::vector<Index> pixels;
    Columns<double> scale;    ///< 3 x pixels, factors of the derivatives
    Columns<double> residual; ///< 3 x pixels, render minus photograph, scaled
};

/// Draws an avatar by labels, and differentiates its pictures by them.
/// `drive` takes the labels of the pictures that follow.
/// `differentiate` takes labels, too, and keeps the driven Gaussians' derivatives by n unknowns
/// until the next call: differences to those by `moved`, one for each unknown, over `apart`.
/// `picture` returns colours, 3 x pixels; NaN if a Gaussian is not finite.
/// `jacobian` returns the derivatives of the last picture's colours, which was of this view: three
/// rows (channels) for each pixel named, a column per unknown.
/// `sums` returns sums of products of the columns of that, scaled, and of the residual after them,
/// (n + 1) x (n + 1).
template <class D>
concept LabelDrawing = requires(D& d, const typename D::Labels& labels,
                                const std::vector<typename D::Labels>& moved,
                                const LabelView<typename D::Number>& view,
                                const WeighedColours& colours) {
    d.drive(labels);
    d.differentiate(labels, moved, 1.0);
    { d.picture(view) } -> std::convertible_to<const Columns<typename D::Number>&>;
    { d.jacobian(view, colours.pixels) } -> std::same_as<Columns<typename D::Number>>;
    { d.sums(view, colours) } -> std::same_as<Columns<double>>;
    { d.expression_width() } -> std::convertible_to<Index>;
};

/// Effects whose labels are refined: two eyes that turn, a head pose and an expression.
template <class E>
concept RefinedEffects = KeptFromFrameToFrame<E> && eye_turns<E, 0> && eye_turns<E, 1> &&
    has_effect<E, HeadPose> && has_effect<E, ReadsHeadPose> && has_effect<E, ReadsExpression>;

} // namespace rye
