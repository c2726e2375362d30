// SPDX-License-Identifier: Apache-2.0
/// tests/support/tiny_mesh.hpp: a step of stage 1 in a lattice of a few cells.
#pragma once

#include <rye/backend/scalar.hpp>
#include <rye/train/initialize.hpp>
#include <rye/train/stage_mesh.hpp>

#include "tiny_avatar.hpp"

namespace rye::test {

/// A lattice of a few hundred vertices around the head.
inline TetGrid<double> tiny_grid() {
    return bcc_grid<double>(Vec3<double>(-1.6, -1.5, -1.5), Vec3<double>(1.6, 1.7, 1.7), 0.5);
}

/// The same in another scalar.
template <class T>
TetGrid<T> grid_in(const TetGrid<double>& g) {
    return {g.vertices.unaryExpr([](double x) { return T(static_cast<real_t<T>>(x)); }),
            g.topology};
}

/// A guidance mesh that has learned a sphere.
inline GuidanceMesh<double> tiny_mesh() {
    Draw draw;
    GuidanceMesh<double> m =
        GuidanceMesh<double>::init(tiny_config(), tiny_landmarks(draw), Random{3, 0});
    pretrain_sphere<double>(ScalarBackend<>{}, m, tiny_config(),
                            {Vec3<double>(0, 0.1, 0.1), 1.6, 60, 5e-3}, Random{4, 0});
    m.eye_offset.mlp.weight.back() = draw.columns(6, m.eye_offset.mlp.weight.back().cols(), 0.3);
    return m;
}

/// A frame of noise, seen twice.
template <class T>
MeshSample<T> tiny_sample() {
    Draw draw{{5, 0}};
    const auto columns = [&](Index rows, Index cols, double size, double middle) {
        return Columns<T>(draw.columns(rows, cols, size).unaryExpr([&](double x) {
            return T(static_cast<real_t<T>>(x + middle));
        }));
    };
    MeshSample<T> s;
    s.drivers = tiny_drivers<T>();
    s.landmarks = columns(3, 66, 0.5, 0.2);
    s.eye_displacement = columns(3, 2, 0.05, 0);
    for (int v = 0; v < 2; ++v) {
        MeshView<T> view;
        view.camera = tiny_camera(26 + v, 22).cast<real_t<T>>();
        view.truth = Image<T>(26 + v, 22, 3);
        view.truth.pixels = columns(3, view.truth.size(), 0.5, 0.5);
        view.mask = columns(1, view.truth.size(), 0.5, 0.5);
        view.visible = Columns<T>::Ones(1, view.truth.size());
        view.visible(0, 7) = T(0);
        s.views.push_back(view);
    }
    return s;
}

} // namespace rye::test
