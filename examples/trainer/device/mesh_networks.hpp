// SPDX-License-Identifier: Apache-2.0
/// device/mesh_networks.hpp: the networks of stage 1 on a device, without CUDA's types: a unit of
/// nvcc has the kernels, the rest of a step is compiled with the program. Types of Eigen are passed
/// between units of two compilers: their alignment is part of the symbol's name, so that units that
/// differ in it do not link.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include <rye/avatar/cuda/offload.hpp>
#include <rye/backend/scalar.hpp>
#include <rye/train/cuda/fit_deformation.hpp>

#include "model/types.hpp"

namespace rye::trainer {

/// Interface of an OffloadBackend to networks on a device; see NetworkOffload.
class MeshNetworks {
  public:
    virtual ~MeshNetworks() = default;
    virtual bool takes(const MlpShape& shape, Index points) const = 0;
    virtual Columns<float> forward(const ProgramThreads& threads, const Mlp<float>& m,
                                   const ColumnsView<float>& points, const VecX<float>& frame,
                                   MlpTrace<float>* trace) = 0;
    virtual Columns<float> first_output(const ProgramThreads& threads, const Mlp<float>& m,
                                        const ColumnsView<float>& points, int frequencies) = 0;
    virtual void vjp(const ProgramThreads& threads, const Mlp<float>& m, Index pass,
                     const ColumnsView<float>& g_out, const MlpGradient<float, LeakyRelu>& g) = 0;
    virtual OffloadCounts counts() const = 0;
    virtual void count_host_forward() = 0;
    virtual void count_host_vjp() = 0;

    /// Does what fit_deformation does on the device. Returns nothing, and does nothing, if the
    /// networks are too large for the tiles.
    virtual std::optional<double> fit(const ProgramThreads& threads, Mesh& mesh,
                                      const LandmarkStage& stage,
                                      const std::vector<MeshSample<float>>& frames,
                                      const DeformationFit& settings) = 0;
};

/// Backend on the program's threads, with networks on a device.
using MeshBackend = OffloadBackend<TrainBackend, MeshNetworks>;

/// Tiles with two bf16 planes per float: with one the surface would be off by hundredths of a cell
/// (docs/cuda.md).
using MeshTiles = MlpTiles<2, 256, 128>;

/// Networks on a Device, with their memory and staging.
template <class Device, DeviceMemory Memory, DeviceMemory Staging>
class MeshNetworksOn : public MeshNetworks {
  public:
    MeshNetworksOn(const Device& device, CudaStream stream)
        : device_(device),
          queue_{stream, memory_},
          networks_(device, queue_, staging_) {}

    bool takes(const MlpShape& shape, Index points) const override {
        return networks_.takes(shape, points);
    }
    Columns<float> forward(const ProgramThreads& threads, const Mlp<float>& m,
                           const ColumnsView<float>& points, const VecX<float>& frame,
                           MlpTrace<float>* trace) override {
        return networks_.forward(threads, m, points, frame, trace);
    }
    Columns<float> first_output(const ProgramThreads& threads, const Mlp<float>& m,
                                const ColumnsView<float>& points, int frequencies) override {
        return networks_.first_output(threads, m, points, frequencies);
    }
    void vjp(const ProgramThreads& threads, const Mlp<float>& m, Index pass,
             const ColumnsView<float>& g_out, const MlpGradient<float, LeakyRelu>& g) override {
        networks_.vjp(threads, m, pass, g_out, g);
    }
    OffloadCounts counts() const override { return networks_.counts(); }
    void count_host_forward() override { networks_.count_host_forward(); }
    void count_host_vjp() override { networks_.count_host_vjp(); }
    std::optional<double> fit(const ProgramThreads& threads, Mesh& mesh,
                              const LandmarkStage& stage,
                              const std::vector<MeshSample<float>>& frames,
                              const DeformationFit& settings) override {
        if (!DeviceDeformationFit<MeshEffects, Device, MeshTiles>::fits(mesh)) return {};
        return fit_deformation_on<MeshTiles>(device_, queue_, ScalarBackend{threads}, mesh, stage,
                                             frames, settings);
    }

  private:
    Device device_;
    Memory memory_;
    CudaQueue queue_;
    Staging staging_;
    NetworkOffload<Device, MeshTiles> networks_;
};

/// Returns networks on the current device, or null if the host's are to be used. Throws an Error
/// without a device, and in a build without kernels.
template <int alignment = EIGEN_MAX_ALIGN_BYTES>
std::unique_ptr<MeshNetworks> mesh_networks();

} // namespace rye::trainer
