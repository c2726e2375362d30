// SPDX-License-Identifier: Apache-2.0
// formulas.cu: a kernel for each family of formulas (families.hpp) and scalar. Compiled by nvcc it
// compares what the device computes with what the host does, on seeded inputs; compiled as plain
// C++, where there is no nvcc, it runs the same list of calls on the host alone.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <initializer_list>
#include <string>
#include <vector>

#include <rye/core/random.hpp>

#include "families.hpp"

namespace {

using namespace families;

/// A scalar as the numbers that it consists of.
template <class S>
struct Packed {
    static constexpr int parts = 1;
    RYE_HD static S load(const S* x) { return x[0]; }
    RYE_HD static void store(const S& s, S* x) { x[0] = s; }
};
template <class R>
struct Packed<Dual<R, 1>> {
    static constexpr int parts = 2;
    RYE_HD static Dual<R, 1> load(const R* x) {
        Dual<R, 1> s(x[0]);
        s.d[0] = x[1];
        return s;
    }
    RYE_HD static void store(const Dual<R, 1>& s, R* x) {
        x[0] = s.value;
        x[1] = s.d[0];
    }
};

struct Counts {
    int in, out;
};

/// Inputs and outputs of one evaluation lie one after the other. Gives how many there were.
template <class Family, class S>
RYE_HD Counts evaluate(const real_t<S>* in, real_t<S>* out) {
    using P = Packed<S>;
    S x[Family::inputs], y[Family::outputs];
    for (int k = 0; k < Family::inputs; ++k) x[k] = P::load(in + k * P::parts);
    const Ends<S> ends = Family::evaluate(x, y);
    for (int k = 0; k < Family::outputs; ++k) P::store(y[k], out + k * P::parts);
    return {static_cast<int>(ends.in - x), static_cast<int>(ends.out - y)};
}

template <class Family, class S>
constexpr int numbers_in = Family::inputs* Packed<S>::parts;
template <class Family, class S>
constexpr int numbers_out = Family::outputs* Packed<S>::parts;

constexpr int count = 4096; // evaluations of each kernel

#ifdef __CUDACC__
#define RYE_TEST_KERNEL __global__
#else
#define RYE_TEST_KERNEL
#endif

/// On the host, the same for one i after the other.
template <class Family, class S>
RYE_TEST_KERNEL void kernel([[maybe_unused]] int first, const real_t<S>* in, real_t<S>* out) {
#ifdef __CUDACC__
    const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
#else
    const int i = first;
#endif
    if (i < count)
        evaluate<Family, S>(in + i * numbers_in<Family, S>, out + i * numbers_out<Family, S>);
}

#ifdef __CUDACC__
void check(cudaError_t e, const char* what) {
    if (e == cudaSuccess) return;
    std::printf("%s: %s\n", what, cudaGetErrorString(e));
    std::exit(2);
}

template <class Family, class S>
void on_device(const std::vector<real_t<S>>& in, std::vector<real_t<S>>& out) {
    using R = real_t<S>;
    R *from = nullptr, *to = nullptr;
    check(cudaMalloc(&from, in.size() * sizeof(R)), "cudaMalloc");
    check(cudaMalloc(&to, out.size() * sizeof(R)), "cudaMalloc");
    check(cudaMemcpy(from, in.data(), in.size() * sizeof(R), cudaMemcpyHostToDevice), "copy");
    check(cudaMemset(to, 0xFF, out.size() * sizeof(R)), "cudaMemset"); // NaN
    kernel<Family, S><<<(count + 63) / 64, 64>>>(0, from, to);
    check(cudaGetLastError(), "launch");
    check(cudaMemcpy(out.data(), to, out.size() * sizeof(R), cudaMemcpyDeviceToHost), "kernel");
    check(cudaFree(from), "cudaFree");
    check(cudaFree(to), "cudaFree");
}
#endif

template <class Family>
constexpr double share_apart() {
    if constexpr (requires { Family::apart; })
        return Family::apart;
    else
        return 0;
}

/// How far the numbers of both sides are apart, by the family's tolerance.
struct Comparison {
    double worst = 0;   // of the evaluations that are not apart [epsilon]
    int apart = 0;      // evaluations
    int not_finite = 0; // numbers of the host
    int still = 0;      // outputs that are the same for all inputs
};

template <class R>
Comparison compare(const std::vector<R>& host, const std::vector<R>& device, int width,
                   double tolerance) {
    Comparison c;
    std::vector<double> typical(static_cast<std::size_t>(width));
    for (std::size_t k = 0; k < typical.size(); ++k) {
        bool moves = false;
        double squares = 0;
        for (std::size_t i = k; i < host.size(); i += typical.size()) {
            const double x = static_cast<double>(host[i]);
            c.not_finite += !std::isfinite(x);
            moves = moves || host[i] != host[k];
            squares += x * x;
        }
        typical[k] = std::sqrt(squares / count);
        c.still += !moves;
    }
    const double epsilon = static_cast<double>(std::numeric_limits<R>::epsilon());
    for (std::size_t i = 0; i < host.size(); i += typical.size()) {
        double worst = 0;
        for (std::size_t k = 0; k < typical.size(); ++k) {
            const double a = static_cast<double>(host[i + k]);
            const double b = static_cast<double>(device[i + k]);
            const double size = std::fmax(std::fabs(a), typical[k]);
            const double error = a == b ? 0 : std::fabs(a - b) / (epsilon * size);
            worst = std::isnan(error) ? INFINITY : std::fmax(worst, error);
        }
        if (worst > tolerance)
            ++c.apart;
        else
            c.worst = std::fmax(c.worst, worst);
    }
    return c;
}

/// Runs a family and says how it went; false if it failed.
template <class Family, class S>
bool run(const char* scalar) {
    using R = real_t<S>;
    constexpr int in_width = numbers_in<Family, S>, out_width = numbers_out<Family, S>;
    std::vector<R> in(static_cast<std::size_t>(count) * in_width);
    std::vector<R> host(static_cast<std::size_t>(count) * out_width), device = host;
    const Random random{20241};
    for (std::size_t i = 0; i < in.size(); ++i) in[i] = static_cast<R>(2 * random.uniform(i) - 1);
    Counts counts{};
    for (int i = 0; i < count; ++i)
        counts = evaluate<Family, S>(in.data() + i * in_width, host.data() + i * out_width);
    if (counts.in > Family::inputs || counts.out != Family::outputs) {
        std::printf("%s, %s: reads %d numbers and writes %d, but says %d and %d\n", Family::name,
                    scalar, counts.in, counts.out, Family::inputs, Family::outputs);
        return false;
    }
#ifdef __CUDACC__
    on_device<Family, S>(in, device);
#else
    for (int i = 0; i < count; ++i) kernel<Family, S>(i, in.data(), device.data());
#endif
    const Comparison c = compare(host, device, out_width, Family::ulps);
    const bool good = c.not_finite == 0 && c.apart <= share_apart<Family>() * count;
    std::printf(
        "%-22s %-14s %10.3g epsilon of %6g, apart %d of %d, constant %d of %d, "
        "not finite %d%s\n",
        Family::name, scalar, c.worst, Family::ulps, c.apart, count, c.still, out_width,
        c.not_finite, good ? "" : "  FAILED");
    return good;
}

/// Whether all are good. The braces call them in order, also those after one that is not.
bool all_good(std::initializer_list<bool> results) {
    return std::find(results.begin(), results.end(), false) == results.end();
}

template <class Family>
bool run_float() {
    return run<Family, float>("float");
}
template <class Family>
bool run_real() {
    return all_good({run_float<Family>(), run<Family, double>("double")});
}
template <class Family>
bool run_all() {
    return all_good({run_real<Family>(), run<Family, Dual<float, 1>>("Dual<float, 1>")});
}

} // namespace

int main() {
    const bool good = all_good({
        run_all<Scalars>(),
        run_all<Functions>(),
        run_all<Vectors>(),
        run_all<Rotations>(),
        run_all<Exponentials>(),
        run_all<Harmonics>(),
        run_all<Colours>(),
        run_all<Projection<Antialias::dilate, false>>(),
        run_float<Projection<Antialias::mip, false>>(),
        run_real<Projection<Antialias::dilate, true>>(),
        run_real<Rays<false>>(),
        run_real<Rays<true>>(),
        run_float<Policies>(),
        run_real<Splats<Balanced>>(),
        run_float<Splats<Compatible3dgsFloor>>(),
        run_real<Blending<Balanced>>(),
        run_float<Blending<Compatible3dgsFloor>>(),
        run_all<Influences<SquaredDistance>>(),
        run_all<Influences<EuclideanDistance>>(),
        run_all<Eyes>(),
        run_all<LivingEyes>(),
        run_all<Encodings>(),
        run_all<Activations>(),
        run_all<SsimWindow>(),
        run_all<Corneas>(),
        run_real<Motions>(),
    });
    return good ? 0 : 1;
}
