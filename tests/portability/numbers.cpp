// SPDX-License-Identifier: Apache-2.0
// numbers.cpp: numerical results of the main kernels on a processor, with a compiler, or with
// another version of a library: lanes against plain loops, and plain loops against double
// precision. Prints the build, each error with its bound, and a digest of the bits of the plain
// loops, which portability.sh compares between processors; built with PLAIN_LOOPS_ONLY, no more
// than these. Exit code 1 if an error exceeds its bound.
#include <rye/rye.hpp>
#include <rye/splat/lanes.hpp>

#include <cstdio>
#include <cstring>
#include <string>

using namespace rye;

namespace {

int failures = 0;
std::uint64_t digest = 0xCBF29CE484222325ULL;  // FNV-1a, 64 bits

template <class T>
void add_to_digest(const Columns<T>& a) {
    const auto* bytes = reinterpret_cast<const unsigned char*>(a.data());
    for (std::size_t i = 0; i < sizeof(T) * static_cast<std::size_t>(a.size()); ++i)
        digest = (digest ^ bytes[i]) * 0x100000001B3ULL;
}

/// The largest difference, relative to the largest number; NaN if there is one.
template <class A, class B>
double error(const Columns<A>& got, const Columns<B>& right) {
    double most = 0, difference = 0;
    for (Index i = 0; i < right.size(); ++i) {
        const auto x = static_cast<double>(got.data()[i]), y = static_cast<double>(right.data()[i]);
        if (!std::isfinite(x) || !std::isfinite(y)) return std::nan("");
        most = std::max(most, std::abs(y));
        difference = std::max(difference, std::abs(x - y));
    }
    return most > 0 ? difference / most : std::nan("");
}

void report(const std::string& what, double worst, double bound) {
    const bool holds = worst <= bound;                     // false for NaN
    std::printf("%-52s %8.1e of %.0e%s\n", what.c_str(), worst, bound, holds ? "" : "  WRONG");
    failures += holds ? 0 : 1;
}

/// Random numbers between two bounds, without functions of the mathematical library.
template <class T>
Columns<T> noise(Index rows, Index columns, std::uint64_t seed, double low, double high) {
    const Random random{seed, 0};
    Columns<T> a(rows, columns);
    for (Index i = 0; i < a.size(); ++i) {
        const auto x = static_cast<float>(random.uniform(static_cast<std::uint64_t>(i)));
        a.data()[i] = static_cast<T>(static_cast<float>(low) + static_cast<float>(high - low) * x);
    }
    return a;
}

template <class T>
struct Picture {
    Columns<T> feature, alpha, depth;
    Gaussians<T> gradient;
};

/// 300 Gaussians on 45 x 37 pixels, so that tiles end within the image, and their gradients.
template <class B, class A, class T>
Picture<T> draw(int channels) {
    Gaussians<T> g(300, channels);
    g.mean = noise<T>(3, 300, 1, -0.9, 0.9);
    g.rotation = noise<T>(4, 300, 2, -1, 1);
    g.scale = noise<T>(3, 300, 3, 0.02, 0.3);
    g.opacity = noise<T>(1, 300, 4, 0.05, 0.98);
    g.feature = noise<T>(channels, 300, 5, -1, 1);
    const auto camera = look_at<T>({0, T(0.25), 4}, {0, 0, 0}, {0, 1, 0}, T(0.5), {45, 37});
    const VecX<T> background = noise<T>(channels, 1, 6, 0, 1);
    const Columns<T> cotangent = noise<T>(channels, 45 * 37, 7, -1, 1);
    const Columns<T> of_alpha = noise<T>(1, 45 * 37, 8, -1, 1);
    const Rasterizer<A> rasterizer;
    const auto raster = rasterizer.forward(B{}, g, camera, background);
    return {raster.feature.pixels, raster.alpha.pixels, raster.depth.pixels,
            rasterizer.vjp(B{}, g, camera, background, raster, cotangent, &of_alpha)};
}

/// The largest error of the arrays of two renders' gradients.
template <class T, class U>
double gradient_error(const Picture<T>& got, const Picture<U>& right) {
    double worst = 0;
    const auto add = [&](double e) { worst = e <= worst ? worst : e; };  // keeps a NaN
    add(error(got.gradient.mean, right.gradient.mean));
    add(error(got.gradient.rotation, right.gradient.rotation));
    add(error(got.gradient.scale, right.gradient.scale));
    add(error(got.gradient.opacity, right.gradient.opacity));
    add(error(got.gradient.feature, right.gradient.feature));
    return worst;
}
template <class T, class U>
double image_error(const Picture<T>& got, const Picture<U>& right) {
    return std::max({error(got.feature, right.feature), error(got.alpha, right.alpha),
                     error(got.depth, right.depth)});
}

/// Values and gradients of a small network, of 37 points.
template <class B, class T>
std::array<Columns<T>, 3> multiply() {
    Mlp<T> mlp({{17, 24, 17, 5}, 4}), gradient(mlp.shape);
    std::uint64_t seed = 20;
    Mlp<T>::fields([&](const std::string&, auto& a) {
        a = noise<T>(a.rows(), a.cols(), seed++, -0.4, 0.4);
    }, mlp);
    const Columns<T> points = noise<T>(13, 37, 40, -1, 1), cotangent = noise<T>(5, 37, 41, -1, 1);
    const VecX<T> frame = noise<T>(4, 1, 42, -1, 1);
    MlpTrace<T> trace;
    std::array<Columns<T>, 3> out;
    out[0] = mlp_forward(B{}, mlp, points, frame, &trace);
    mlp_vjp(B{}, mlp, {points, frame, trace}, cotangent, {gradient, &out[1]});
    out[2] = gradient.weight[0];
    return out;
}
template <class T, class U>
double network_error(const std::array<Columns<T>, 3>& got, const std::array<Columns<U>, 3>& right) {
    return std::max({error(got[0], right[0]), error(got[1], right[1]), error(got[2], right[2])});
}

/// Name of the lanes of this build, or a note if the library has none for it.
template <class Arch>
void compare_lanes() {
    if constexpr (requires { xsimd::batch<float, Arch>::size; }) {
        using Lanes = XsimdBackend<Arch>;
        std::printf("%d lanes of float, %d of double: %s\n",
                    static_cast<int>(xsimd::batch<float, Arch>::size),
                    static_cast<int>(xsimd::batch<double, Arch>::size), Arch::name());
        for (const int channels : {1, 3, 4, 5, 8, 17, 35}) {
            const auto plain = draw<ScalarBackend<>, Exact32, float>(channels);
            const auto lanes = draw<Lanes, Exact32, float>(channels);
            const std::string of = " of " + std::to_string(channels) + " channels, vectors";
            report("image" + of, image_error(lanes, plain), 5e-6);
            report("gradient" + of, gradient_error(lanes, plain), 2e-5);
        }
        report("network, vectors of float",
               network_error(multiply<Lanes, float>(), multiply<ScalarBackend<>, float>()), 1e-5);
        report("network, vectors of double",
               network_error(multiply<Lanes, double>(), multiply<ScalarBackend<>, double>()),
               1e-13);
    } else {
        std::printf("no vectors: xsimd has none for this build\n");
    }
}

} // namespace

int main() {
    std::printf("indices of %d bits, xsimd %d.%d.%d, Eigen %d.%d.%d\n",
                static_cast<int>(8 * sizeof(Index)), XSIMD_VERSION_MAJOR, XSIMD_VERSION_MINOR,
                XSIMD_VERSION_PATCH, EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION,
                EIGEN_MINOR_VERSION);
    const auto plain = draw<ScalarBackend<>, Exact32, float>(5);
    const auto fine = draw<ScalarBackend<>, Exact64, double>(5);
    report("image of 5 channels, plain loops", image_error(plain, fine), 5e-6);
    report("gradient of 5 channels, plain loops", gradient_error(plain, fine), 2e-5);
    const auto network = multiply<ScalarBackend<>, float>();
    report("network, plain loops", network_error(network, multiply<ScalarBackend<>, double>()),
           1e-5);
#if !defined(PLAIN_LOOPS_ONLY)
    compare_lanes<DefaultArch>();
#endif

    add_to_digest(plain.feature);
    add_to_digest(plain.depth);
    add_to_digest(plain.gradient.mean);
    add_to_digest(plain.gradient.rotation);
    add_to_digest(plain.gradient.opacity);
    for (const auto& a : network) add_to_digest(a);
    std::printf("bits of the plain loops: %016llx\n", static_cast<unsigned long long>(digest));
    return failures > 0 ? 1 : 0;
}
