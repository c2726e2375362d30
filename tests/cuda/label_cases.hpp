// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/label_cases.hpp: labels refined by a device's pictures and derivatives against the
/// host's, for the emulated device and a real one.
#pragma once

#include <doctest/doctest.h>

#include <rye/train/cuda/label_drawing.hpp>
#include <rye/train/host_label_drawing.hpp>
#include <rye/train/refine_labels.hpp>

#include "../support/effect_sets.hpp"
#include "../support/hostile.hpp"
#include "avatar_cases.hpp"

namespace rye::test {

/// A frame of the tiny avatar whose labels are off as a tracker's are.
struct LabelScene {
    AvatarCase<AllEffects> of{avatar_of_all(), drivers_of_all()};
    LabelUnknowns unknowns;
    VecX<double> error;
    Drivers<float, AllEffects> label;
    std::vector<LabelView<float>> views;

    LabelScene() {
        unknowns.expression = {0, 2};
        error.resize(12);
        error << 0.07, 0, -0.04, 0.05, 0.007, -0.007, 0.003, 0.01, -0.006, 0.004, 0.06, -0.05;
        label = moved_drivers(of.drivers, unknowns, error);
        HostLabelDrawing host(ScalarBackend<Serial>{}, of.avatar, of.config, of.roles);
        host.drive(of.drivers);
        for (int v = 0; v < 2; ++v) {
            LabelView<float> view;
            view.camera = tiny_camera(26 - 4 * v, 22).cast<float>();
            view.camera.cx += static_cast<float>(v);
            view.background = Vec3<float>(0.2F, 0.5F, 1.0F);
            view.truth = host.picture(view);
            view.weight = noise<float>(1, view.truth.cols(), 5).cwiseMax(0.0F);
            views.push_back(view);
        }
    }
};

/// Pictures, derivatives, their sums and the labels that they lead to.
template <class Policy, class Device>
void labels_refined(const Device& device, const CudaQueue& queue) {
    const LabelScene s;
    const auto& c = s.of;
    HostLabelDrawing host(ScalarBackend<Serial>{}, c.avatar, c.config, c.roles);
    DeviceLabelDrawing<AllEffects, Device, Policy> own(device, queue,
                                                       {c.avatar, c.config, c.roles});
    RefineSettings settings;
    settings.difference = 1; // where rounding hardly counts
    LabelRefiner by_host(Serial{}, host, s.unknowns, settings);
    LabelRefiner by_device(Serial{}, own, s.unknowns, settings);
    const VecX<double> x = VecX<double>::Constant(12, 0.3);
    for (const LabelView<float>& view : s.views) {
        std::vector<Index> pixels;
        for (Index p = 1; p < view.truth.cols(); p += 2) pixels.push_back(p);
        const Columns<float> truth = by_host.jacobian(s.label, view, pixels, x);
        const Columns<float> found = by_device.jacobian(s.label, view, pixels, x);
        CHECK((own.picture(view) - host.picture(view)).cwiseAbs().maxCoeff() < 2e-5F);
        for (Index k = 0; k < truth.cols(); ++k) {
            CAPTURE(k);
            CHECK(truth.col(k).norm() > 1e-3F);
            CHECK((found.col(k) - truth.col(k)).norm() < 5e-4F * truth.col(k).norm());
        }
        const auto n = static_cast<Index>(pixels.size());
        const WeighedColours colours{pixels, noise<double>(3, n, 6), noise<double>(3, n, 7)};
        Columns<double> columns(3 * n, truth.cols() + 1);
        columns.leftCols(truth.cols()) = found.cast<double>();
        columns.leftCols(truth.cols()).array().colwise() *= colours.scale.reshaped().array();
        columns.col(truth.cols()) = colours.residual.reshaped();
        const Columns<double> product = columns.transpose() * columns;
        const Columns<double> sums = own.sums(view, colours);
        CHECK((sums - product).norm() < 1e-12 * product.norm());
        CHECK(sums == own.sums(view, colours));
    }
    LabelRefiner host_again(Serial{}, host, s.unknowns);
    LabelRefiner again(Serial{}, own, s.unknowns);
    const RefinedLabels truth = host_again.refine(s.label, s.views);
    const RefinedLabels found = again.refine(s.label, s.views);
    CHECK(truth.residual < 0.1 * truth.first_residual);
    CHECK(found.residual < 0.1 * found.first_residual);
    const VecX<double> sigma = s.unknowns.sigma();
    CHECK((found.change + s.error).cwiseQuotient(sigma).cwiseAbs().maxCoeff() < 0.05);
    CHECK((found.change - truth.change).cwiseQuotient(sigma).cwiseAbs().maxCoeff() < 0.02);
    CHECK((found.sigma - truth.sigma).cwiseQuotient(truth.sigma).cwiseAbs().maxCoeff() < 0.05);
    CHECK(own.bytes() > 0);
}

/// An avatar that is not finite draws nothing that could be a photograph.
template <class Policy, class Device>
void labels_refused(const Device& device, const CudaQueue& queue) {
    LabelScene s;
    s.of.avatar.face.position(1, 3) = std::nanf("");
    DeviceLabelDrawing<AllEffects, Device, Policy> own(device, queue,
                                                       {s.of.avatar, s.of.config, s.of.roles});
    LabelRefiner refiner(Serial{}, own, s.unknowns);
    CHECK_FAULT(refiner.refine(s.label, s.views), "the avatar at the frame's label is not finite");
    s.unknowns.expression = {3};
    CHECK_FAULT(LabelRefiner(Serial{}, own, s.unknowns),
                "got expression coefficient 3, expected 0 to 2");
}

} // namespace rye::test
