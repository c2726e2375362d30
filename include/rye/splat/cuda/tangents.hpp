// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/tangents.hpp: directions in the inputs of a device's render, and the tangents of
/// Gaussians' screen numbers, by the projection on duals.
#pragma once

#include <rye/splat/cuda/lens.hpp>
#include <rye/splat/cuda/records.hpp>
#include <rye/splat/tangents.hpp>

namespace rye::detail {

/// A direction in the inputs of a device's render, and the images of its derivative. Arrays without
/// data, and a camera that is null, do not move.
template <Distortion D = NoDistortion>
struct DeviceDirection {
    DeviceGaussians<const float> gaussians = {}; ///< tangents, in the shapes of the Gaussians
    const Pinhole<float, D>* camera = nullptr;   ///< as RasterTangents has it, on the host
    DeviceImages images;                         ///< without a contributor; depth may be null
};

/// Computes the tangents of the screen numbers of visible Gaussians: SplatRecords, [N].
template <class A, class D>
struct ProjectTangentsKernel {
    using Number = Dual<float, 1>;
    static constexpr const char* name = "project tangents";
    static constexpr int threads = 128, blocks = 3;
    struct Shared {};
    DeviceGaussians<const float> g, tangent;
    DeviceLens<D, Number> lens;
    A accuracy;
    FrameMemory memory;
    SplatRecord* out;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        const auto base = static_cast<std::uint32_t>(block.index()) * threads;
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            if (i < memory.count && memory.spans[i].rows > 0) project_one(i);
        });
    }

  private:
    RYE_DEVICE static Number number(const DeviceColumns<const float>& x,
                                    const DeviceColumns<const float>& dx, Index at) {
        return dual_of<float>(x.data[at], dx.data != nullptr ? dx.data[at] : 0.0F);
    }
    RYE_DEVICE void project_one(std::uint32_t i) const {
        typename DeviceLens<D, Number>::Held held;
        lens.put(held);
        const auto mean = [&](int k) { return number(g.mean, tangent.mean, 3 * Index(i) + k); };
        const auto turn = [&](int k) {
            return number(g.rotation, tangent.rotation, 4 * Index(i) + k);
        };
        const auto scale = [&](int k) { return number(g.scale, tangent.scale, 3 * Index(i) + k); };
        const Shape<Number> shape{Vec3<Number>(mean(0), mean(1), mean(2)),
                                  Quat<Number>(turn(0), turn(1), turn(2), turn(3)),
                                  Vec3<Number>(scale(0), scale(1), scale(2))};
        const Projected<Number, A::antialias> s = project<A::antialias>(shape, held.projector);
        const Number opacity = kept_opacity(s, number(g.opacity, tangent.opacity, i));
        const Splat<Number> splat = make_splat(s, opacity, accuracy);
        out[i] = {{splat.x.d[0], splat.y.d[0], splat.ux.d[0], splat.vx.d[0]},
                  {splat.vy.d[0], splat.log2_opacity.d[0], splat.depth.d[0], splat.floor.d[0]}};
    }
};

/// The data of a direction that a walk reads and writes.
struct WalkedDirection {
    const SplatRecord* splats;          ///< [N] tangents
    DeviceColumns<const float> feature; ///< C x N tangents, or no data
    float cx, cy;                       ///< tangents of the principal point [px]
    DeviceImages images;
};

} // namespace rye::detail
