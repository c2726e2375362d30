// SPDX-License-Identifier: Apache-2.0
// bench_effects [--avatar FILE | --run DIR [--capture DIR]] [--benchmark_...]
#include <benchmark/benchmark.h>

#include <cstring>
#include <vector>

#include <rye/core/error.hpp>

#include "subject.hpp"

int main(int argc, char** argv) {
    std::vector<char*> rest{argv[0]};
    rye::bench::SubjectOptions& options = rye::bench::subject_options();
    for (int i = 1; i < argc; ++i) {
        std::string* const value = std::strcmp(argv[i], "--run") == 0       ? &options.run
                                   : std::strcmp(argv[i], "--capture") == 0 ? &options.capture
                                   : std::strcmp(argv[i], "--avatar") == 0  ? &options.avatar
                                                                            : nullptr;
        if (value != nullptr && i + 1 < argc)
            *value = argv[++i];
        else
            rest.push_back(argv[i]);
    }
    int count = static_cast<int>(rest.size());
    benchmark::Initialize(&count, rest.data());
    if (benchmark::ReportUnrecognizedArguments(count, rest.data())) return 1;
    try {
        benchmark::AddCustomContext("subject", rye::bench::subject().name);
        benchmark::RunSpecifiedBenchmarks();
    } catch (const rye::Error& e) {
        std::fprintf(stderr, "bench_effects: %s\n", e.what());
        return 2;
    }
    return 0;
}
