// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/runtime.hpp: CUDA's runtime beside launches: its errors, graphs of work, its
/// pool of memory. Under nvcc only.
#pragma once

#if defined(__CUDACC__)

#include <cuda_runtime.h>

#include <memory>
#include <utility>

#include <rye/backend/cuda.hpp>

namespace rye {

/// Throws unless a call of CUDA's succeeded.
inline void check_cuda(cudaError_t got, const char* who) {
    if (got == cudaSuccess) return;
    std::string what = std::string(who) + ": got " + cudaGetErrorName(got) + " (" +
                       cudaGetErrorString(got) + "), expected cudaSuccess";
    if (got == cudaErrorIllegalAddress || got == cudaErrorLaunchFailure ||
        got == cudaErrorECCUncorrectable || got == cudaErrorHardwareStackError)
        what += "; the device's context is lost, with all that was in its memory";
    throw Error(what);
}

/// Work that was put on a stream once, to be launched again as a whole.
class CudaGraph {
  public:
    CudaGraph() = default;
    CudaGraph(CudaGraph&& other) noexcept : exec_(std::exchange(other.exec_, nullptr)) {}
    CudaGraph& operator=(CudaGraph&& other) noexcept {
        std::swap(exec_, other.exec_);
        return *this;
    }
    ~CudaGraph() {
        if (exec_ != nullptr) cudaGraphExecDestroy(exec_);
    }

    /// Returns the graph of the work that f puts on the queue's stream. f must not wait nor ask for
    /// memory.
    template <class F>
    static CudaGraph of(const CudaQueue& queue, const F& f) {
        CudaGraph r;
        check_cuda(cudaStreamBeginCapture(queue.stream, cudaStreamCaptureModeThreadLocal), "graph");
        cudaGraph_t graph = nullptr;
        try {
            f();
        } catch (...) {
            static_cast<void>(cudaStreamEndCapture(queue.stream, &graph));
            if (graph != nullptr) cudaGraphDestroy(graph);
            throw;
        }
        check_cuda(cudaStreamEndCapture(queue.stream, &graph), "graph");
        const cudaError_t got = cudaGraphInstantiate(&r.exec_, graph, 0);
        cudaGraphDestroy(graph);
        check_cuda(got, "graph");
        return r;
    }
    void launch(const CudaQueue& queue) const {
        check_cuda(cudaGraphLaunch(exec_, queue.stream), "graph");
    }

  private:
    cudaGraphExec_t exec_ = nullptr;
};

/// A stream beside another one, for work that may run meanwhile. Its memory is the other's, and is
/// asked for and given back on the other's stream.
class CudaBranch {
  public:
    CudaBranch() {
        check_cuda(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking), "branch");
        check_cuda(cudaEventCreateWithFlags(&event_, cudaEventDisableTiming), "branch");
    }
    CudaBranch(const CudaBranch&) = delete;
    CudaBranch& operator=(const CudaBranch&) = delete;
    ~CudaBranch() {
        cudaEventDestroy(event_);
        cudaStreamDestroy(stream_);
    }

    /// Returns the branch's queue, for work that follows what is on `from`.
    CudaQueue begin(const CudaQueue& from) {
        from_ = std::make_unique<CudaQueue>(from);
        follow(stream_, from.stream);
        return {stream_, *this, from.idle};
    }
    /// Lets later work of `to` follow the branch's work.
    void end(const CudaQueue& to) const { follow(to.stream, stream_); }

    void* allocate(std::size_t bytes, CudaStream) const {
        void* const p = from_->memory.allocate(bytes, from_->stream);
        follow(stream_, from_->stream);
        return p;
    }
    void release(void* p, CudaStream) const {
        follow(from_->stream, stream_);  // the branch may read it still
        from_->memory.release(p, from_->stream);
    }

  private:
    void follow(CudaStream later, CudaStream earlier) const {
        check_cuda(cudaEventRecord(event_, earlier), "branch");
        check_cuda(cudaStreamWaitEvent(later, event_, 0), "branch");
    }

    cudaStream_t stream_ = nullptr;
    cudaEvent_t event_ = nullptr;
    std::unique_ptr<CudaQueue> from_;
};

/// CUDA's own pool of memory, in the order of the stream.
struct StreamMemory {
    void* allocate(std::size_t bytes, CudaStream stream) {
        void* p = nullptr;
        const cudaError_t got = cudaMallocAsync(&p, bytes, stream);
        if (got == cudaSuccess) return p;
        static_cast<void>(cudaGetLastError());
        std::size_t free = 0, total = 0;
        check_cuda(cudaMemGetInfo(&free, &total), "device memory");
        throw Error("device memory: no room for " + std::to_string(bytes) + " bytes: " +
                    std::to_string(free) + " of " + std::to_string(total) + " are free");
    }
    void release(void* p, CudaStream stream) { static_cast<void>(cudaFreeAsync(p, stream)); }
};

} // namespace rye

#endif
