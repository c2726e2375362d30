// SPDX-License-Identifier: Apache-2.0
// Stage 1's networks on the current device.
#include "device/mesh_networks.hpp"

#include <rye/backend/cuda/page_locked.hpp>

namespace rye::trainer {
namespace {

/// A stream that outlives the objects on it.
class OwnStream {
  public:
    OwnStream() {
        check_cuda(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking), "stage 1");
    }
    OwnStream(const OwnStream&) = delete;
    OwnStream& operator=(const OwnStream&) = delete;
    ~OwnStream() { static_cast<void>(cudaStreamDestroy(stream_)); }
    CudaStream get() const { return stream_; }

  private:
    cudaStream_t stream_ = nullptr;
};

/// Networks with a stream of their own.
class OnStream : OwnStream, public MeshNetworksOn<CudaDevice, StreamMemory, PageLockedMemory> {
  public:
    OnStream() : MeshNetworksOn(CudaDevice(), OwnStream::get()) {}
};

} // namespace

template <>
std::unique_ptr<MeshNetworks> mesh_networks<EIGEN_MAX_ALIGN_BYTES>() {
    return std::make_unique<OnStream>();
}

} // namespace rye::trainer
