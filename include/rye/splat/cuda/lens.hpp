// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/lens.hpp: a Projector as the argument of a kernel. Its own members without an
/// address are laid out differently by nvcc's two halves (seen in nvcc 13.0: 80 bytes more on the
/// device), so its numbers travel plainly and are put together again there.
#pragma once

#include <rye/gaussian/project.hpp>

namespace rye {

namespace detail {

/// The numbers T of a lens that bends.
template <class D, class T>
struct LensNumbers {
    D distortion;
    T fold;

    explicit LensNumbers(const Projector<T, D>& p)
        : distortion(p.distortion),
          fold(p.reach.fold) {}
    RYE_HD void put(Projector<T, D>& p) const {
        p.distortion = distortion;
        p.reach.fold = fold;
    }
};
template <class T>
struct LensNumbers<NoDistortion, T> {
    explicit LensNumbers(const Projector<T, NoDistortion>&) {}
    RYE_HD void put(Projector<T, NoDistortion>&) const {}
};

} // namespace detail

/// A camera as kernels take it: projection and lens D in plain numbers T, floats or duals of them.
template <class D, class T = float>
struct DeviceLens {
    T rotation[9], translation[3];
    T fx, fy, x_low, x_high, y_low, y_high, near_depth, dilation;
    detail::LensNumbers<D, T> lens;

    explicit DeviceLens(const Projector<T, D>& p)
        : fx(p.fx),
          fy(p.fy),
          x_low(p.x_low),
          x_high(p.x_high),
          y_low(p.y_low),
          y_high(p.y_high),
          near_depth(p.near_depth),
          dilation(p.dilation),
          lens(p) {
        for (int k = 0; k < 9; ++k) rotation[k] = p.camera_from_world.rotation.data()[k];
        for (int k = 0; k < 3; ++k) translation[k] = p.camera_from_world.translation[k];
    }

    /// Memory of a Projector, which is put together from numbers.
    union Held {
        Projector<T, D> projector;
        RYE_HD Held() {}
    };
    RYE_HD void put(Held& to) const {
        Projector<T, D>& p = to.projector;
        for (int k = 0; k < 9; ++k) p.camera_from_world.rotation.data()[k] = rotation[k];
        for (int k = 0; k < 3; ++k) p.camera_from_world.translation[k] = translation[k];
        p.fx = fx;
        p.fy = fy;
        p.x_low = x_low;
        p.x_high = x_high;
        p.y_low = y_low;
        p.y_high = y_high;
        p.near_depth = near_depth;
        p.dilation = dilation;
        lens.put(p);
    }
};

/// A lens D whose numbers are in device memory when a kernel runs.
template <class D>
struct LensInMemory {};

/// Such a camera: where its numbers are.
template <class D, class T>
struct DeviceLens<LensInMemory<D>, T> {
    using Held = typename DeviceLens<D, T>::Held;
    const DeviceLens<D, T>* at;

    RYE_HD void put(Held& to) const { at->put(to); }
};

} // namespace rye
