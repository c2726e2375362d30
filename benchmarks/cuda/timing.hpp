// SPDX-License-Identifier: Apache-2.0
/// timing.hpp: times of CUDA graphs, and the file of --json, for the benchmarks of this folder.
#pragma once

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include <rye/backend/cuda/device.hpp>

namespace rye::bench {

/// Milliseconds.
struct Times {
    float median, least, most;
};

/// Times of what f() puts on the stream, captured as a graph after a first call, in which memory
/// grows: 10 launches to warm up, then `count`.
template <class F>
Times graph_times(cudaStream_t stream, const F& f, std::size_t count = 100) {
    f();
    check_cuda(cudaStreamSynchronize(stream), "first call");
    cudaGraph_t graph;
    cudaGraphExec_t exec;
    check_cuda(cudaStreamBeginCapture(stream, cudaStreamCaptureModeThreadLocal), "graph");
    f();
    check_cuda(cudaStreamEndCapture(stream, &graph), "graph");
    check_cuda(cudaGraphInstantiate(&exec, graph, 0), "graph");
    std::vector<cudaEvent_t> events(count + 1);
    for (auto& e : events) check_cuda(cudaEventCreate(&e), "event");
    for (int k = 0; k < 10; ++k) check_cuda(cudaGraphLaunch(exec, stream), "graph");
    check_cuda(cudaEventRecord(events[0], stream), "event");
    for (std::size_t k = 0; k < count; ++k) {
        check_cuda(cudaGraphLaunch(exec, stream), "graph");
        check_cuda(cudaEventRecord(events[k + 1], stream), "event");
    }
    check_cuda(cudaStreamSynchronize(stream), "timed");
    std::vector<float> ms(count);
    for (std::size_t k = 0; k < count; ++k)
        check_cuda(cudaEventElapsedTime(&ms[k], events[k], events[k + 1]), "event");
    for (auto& e : events) check_cuda(cudaEventDestroy(e), "event");
    check_cuda(cudaGraphExecDestroy(exec), "graph");
    check_cuda(cudaGraphDestroy(graph), "graph");
    std::sort(ms.begin(), ms.end());
    return {ms[count / 2], ms.front(), ms.back()};
}

/// Writes rows, objects of JSON with commas between, to FILE of the arguments "--json FILE", if
/// these are all. Returns the exit code of the program.
inline int write_rows(int argc, char** argv, const std::string& rows) {
    if (argc != 3 || std::string(argv[1]) != "--json") return 0;
    std::FILE* const f = std::fopen(argv[2], "w");
    const bool written =
        f != nullptr && std::fprintf(f, "{\"benchmarks\": [\n%s\n]}\n", rows.c_str()) > 0;
    if ((f != nullptr && std::fclose(f) != 0) || !written) {
        std::printf("failed: cannot write %s\n", argv[2]);
        return 1;
    }
    return 0;
}

} // namespace rye::bench
