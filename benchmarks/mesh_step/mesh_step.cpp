// SPDX-License-Identifier: Apache-2.0
// A training step of stage 1 at the sizes of `rye train --preset paper`, without any file: the time
// of its parts, how much of each is networks, and what an OffloadBackend would send and fetch for
// them, all passes taken as the device's.
//     bench_mesh_step [--threads N] [--steps N]
//     bench_mesh_step --precision EDGES   how far a device's products move the surface, by
//     emulation
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>
#include <vector>

#include <rye/avatar/cuda/offload.hpp>
#include <rye/backend/cuda/emulation.hpp>
#include <rye/core/thread_pool.hpp>
#include <rye/splat/lanes.hpp>
#include <rye/train/initialize.hpp>
#include <rye/train/stage_mesh.hpp>

namespace rye::bench {

using Clock = std::chrono::steady_clock;

/// The work of networks: seconds, points, products of two numbers, numbers in and out.
struct Networks {
    double seconds = 0, products = 0, in = 0, out = 0;
};

/// The host's backend, which times its networks.
using Host = XsimdBackend<DefaultArch, ThreadPool::Handle>;
struct Timed : Host {
    Networks* networks = nullptr;
};

inline double macs(const MlpShape& s) {
    double n = 0;
    for (int l = 0; l < s.layers(); ++l) n += double(s.layer_out(l)) * s.fan_in(l);
    return n;
}

} // namespace rye::bench

namespace rye {

template <class T, class A>
Columns<T> mlp_forward(const bench::Timed& b, const Mlp<T, A>& m,
                       const std::type_identity_t<ColumnsView<T>>& points,
                       const std::type_identity_t<VecX<T>>& frame,
                       std::type_identity_t<MlpTrace<T>>* trace) {
    const auto begin = bench::Clock::now();
    const bench::Host& host = b;
    Columns<T> y = mlp_forward<T>(host, m, points, frame, trace);
    const double n = double(points.cols());
    b.networks->seconds += std::chrono::duration<double>(bench::Clock::now() - begin).count();
    b.networks->products += n * bench::macs(m.shape);
    b.networks->in += n * m.shape.point_inputs();
    b.networks->in += trace != nullptr ? bench::macs(m.shape) : 0; // about the parameters
    b.networks->out += n * m.shape.outputs();
    return y;
}

/// Codes and all outputs but one stay on a device.
template <class T, EffectSet E>
Columns<T> signed_distances(const bench::Timed& b, const GuidanceMesh<T, E>& mesh,
                            const AvatarConfig& config, const Columns<T>& points) {
    const auto begin = bench::Clock::now();
    const bench::Host& host = b;
    Columns<T> sdf = signed_distances(host, mesh, config, points);
    b.networks->seconds += std::chrono::duration<double>(bench::Clock::now() - begin).count();
    b.networks->products += double(points.cols()) * bench::macs(mesh.geometry.shape);
    b.networks->in += double(points.size());
    b.networks->out += double(points.cols());
    return sdf;
}

template <class T, class A>
void mlp_vjp(const bench::Timed& b, const Mlp<T, A>& m,
             const std::type_identity_t<MlpPass<T>>& pass,
             const std::type_identity_t<ColumnsView<T>>& g_out,
             const std::type_identity_t<MlpGradient<T, A>>& g) {
    const auto begin = bench::Clock::now();
    const bench::Host& host = b;
    mlp_vjp<T>(host, m, pass, g_out, g);
    const double n = double(g_out.cols());
    b.networks->seconds += std::chrono::duration<double>(bench::Clock::now() - begin).count();
    b.networks->products += 2 * n * bench::macs(m.shape);
    b.networks->in += n * m.shape.outputs();
    b.networks->out += g.points ? n * m.shape.point_inputs() : 0;
    b.networks->out += bench::macs(m.shape); // about their gradient
}

} // namespace rye

namespace {

using namespace rye;
using namespace rye::bench;

/// A part's seconds, and those of its networks.
struct Part {
    double seconds = 0;
    Networks networks;
};

/// The parts of steps, in their order.
struct Parts {
    std::vector<std::pair<std::string, Part>> all;
    Clock::time_point last = Clock::now();
    Networks now;

    void end(const char* name) {
        const auto at = Clock::now();
        auto it = all.begin();
        while (it != all.end() && it->first != name) ++it;
        if (it == all.end()) it = all.insert(all.end(), {name, {}});
        Part& p = it->second;
        p.seconds += std::chrono::duration<double>(at - last).count();
        p.networks.seconds += now.seconds;
        p.networks.products += now.products;
        p.networks.in += now.in;
        p.networks.out += now.out;
        now = {};
        last = Clock::now();
    }
};

/// Landmarks on the front of the unit sphere; 36 to 47 around the eyes.
Columns<float> landmarks() {
    Columns<float> l(3, 66);
    const Random r(7);
    for (Index k = 0; k < 66; ++k) {
        const auto i = static_cast<std::uint64_t>(2 * k);
        double x = 1.2 * (r.uniform(i) - 0.5), y = 1.2 * (r.uniform(i + 1) - 0.5);
        if (k >= 36 && k < 48) {
            x = (k < 42 ? -0.3 : 0.3) + 0.1 * x;
            y = 0.3 + 0.1 * y;
        }
        l.col(k) << float(x), float(y), float(std::sqrt(1 - x * x - y * y));
    }
    return l;
}

LandmarkRoles roles() {
    LandmarkRoles r;
    for (Index k = 0; k < 66; ++k)
        if (k < 36 || k >= 48) r.expression.push_back(k);
    for (Index k = 36; k < 42; ++k) r.eye[1].push_back(k);
    for (Index k = 42; k < 48; ++k) r.eye[0].push_back(k);
    return r;
}

/// A disc of the sphere's size, seen by four cameras; 256 px as the preset has it.
MeshSample<float> sample(int expression, const Columns<float>& neutral) {
    MeshSample<float> s;
    s.drivers.expression = VecX<float>::Constant(expression, 0.1F);
    s.drivers.pose.setConstant(0.05F);
    s.drivers.scale = 1;
    s.drivers.gaze = {Vec3<float>(0.2F, 0.1F, 0.95F).normalized(), Vec3<float>(0, 0, 1)};
    s.landmarks = neutral;
    s.eye_displacement = Columns<float>::Zero(3, 2);
    for (int v = 0; v < 4; ++v) {
        MeshView<float> view;
        const double a = 0.4 * (v - 1.5);
        view.camera = look_at<double>(Vec3<double>(5 * std::sin(a), 0, 5 * std::cos(a)),
                                      Vec3<double>(0, 0, 0), Vec3<double>(0, 1, 0), 0.5, {256, 256})
                          .cast<float>();
        view.truth = Image<float>(256, 256, 3);
        view.mask = view.visible = Columns<float>::Ones(1, view.truth.size());
        for (Index p = 0; p < view.truth.size(); ++p) {
            const double x = double(p % 256) - 128, y = double(p / 256) - 128;
            const bool in = x * x + y * y < 100 * 100;
            view.mask(0, p) = in ? 1.F : 0.F;
            view.truth.pixels.col(p).setConstant(in ? 0.6F : 0.F);
        }
        s.views.push_back(view);
    }
    return s;
}

/// The same network in double.
Mlp<double> in_double(const Mlp<float>& m) {
    Mlp<double> d(m.shape);
    for (std::size_t l = 0; l < m.weight.size(); ++l) {
        d.weight[l] = m.weight[l].cast<double>();
        d.bias[l] = m.bias[l].cast<double>();
    }
    return d;
}

/// Signed distances at the ends of lattice edges that the surface cuts.
struct CutEdges {
    Columns<float> points; ///< 3 x 2 E: ends, one after the other
    Columns<double> truth; ///< 1 x 2 E, of the network in double, before tanh
};

template <class Neutral>
CutEdges cut_edges(const Mlp<float>& geometry, const TetGrid<float>& grid, const Neutral& n,
                   Index count, int frequencies) {
    const SurfaceTopology top = surface_topology<float>(grid.topology, n);
    count = std::min(count, top.vertex_count());
    CutEdges cut{Columns<float>(3, 2 * count), {}};
    for (Index i = 0; i < count; ++i) {
        const Edge& e = top.edges[std::size_t(i * (top.vertex_count() / count))];
        for (int k = 0; k < 2; ++k)
            cut.points.col(2 * i + k) = grid.vertices.col(e[std::size_t(k)]);
    }
    const Columns<double> code = positional_encoding(cut.points.cast<double>(), frequencies);
    cut.truth =
        mlp_forward<double>(ScalarBackend<>{}, in_double(geometry), code, VecX<double>(), nullptr)
            .topRows(1);
    return cut;
}

/// Prints how far `sdf` puts the surface from where the truth has it.
void print_precision(const char* name, const CutEdges& cut, const Columns<float>& sdf,
                     double cell) {
    double worst = 0, squares = 0, placed = 0, most = 0;
    int flips = 0;
    for (Index i = 0; i < sdf.cols(); i += 2) {
        const double a = cut.truth(0, i), b = cut.truth(0, i + 1);
        const double fa = double(sdf(0, i)), fb = double(sdf(0, i + 1));
        placed = std::max({placed, std::abs(fa - a), std::abs(fb - b)});
        if ((fa > 0) == (fb > 0)) {
            ++flips;
            continue;
        }
        const double length = double((cut.points.col(i + 1) - cut.points.col(i)).norm());
        const double gap = std::abs(fa / (fa - fb) - a / (a - b)) * length / cell;
        const double slope = 1 / std::abs(a - b);
        most = std::max(most, std::abs(1 / (std::abs(fa - fb) * slope) - 1));
        worst = std::max(worst, gap);
        squares += gap * gap;
    }
    const double n = double(sdf.cols()) / 2 - flips;
    std::printf("%-12s %12.2e %12.2e %12.2e %12.2e %7d\n", name, placed, std::sqrt(squares / n),
                worst, most, flips);
}

template <int planes>
void print_planes(const char* name, const Mlp<float>& geometry, const CutEdges& cut,
                  int frequencies, double cell) {
    HostMemory memory;
    using Offload = NetworkOffload<EmulatedDevice, MlpTiles<planes, 256, 128>>;
    Offload networks(EmulatedDevice{}, {nullptr, memory}, memory);
    print_precision(name, cut, networks.first_output(Serial{}, geometry, cut.points, frequencies),
                    cell);
}

int option(int argc, char** argv, const std::string& name, int otherwise) {
    for (int i = 1; i + 1 < argc; ++i)
        if (argv[i] == name) return std::atoi(argv[i + 1]);
    return otherwise;
}

} // namespace

int main(int argc, char** argv) {
    const int threads = option(argc, argv, "--threads", 2),
              steps = option(argc, argv, "--steps", 3);
    ThreadPool pool(threads);
    Parts parts;
    const Timed backend{{pool.threads()}, &parts.now};
    AvatarConfig config;
    config.expression = 64;
    using Mesh = GuidanceMesh<float>;
    const Columns<float> neutral = landmarks();
    Mesh mesh = Mesh::init(config, neutral, Random(1));
    pretrain_sphere(backend, mesh, config, {Vec3<float>::Zero(), 1.75F, 60, 1e-3}, Random(2));
    parts.now = {};
    parts.last = Clock::now();
    const TetGrid<float> grid =
        bcc_grid<float>(Vec3<float>::Constant(-1.75F), Vec3<float>::Constant(1.75F), 3.5F / 52);
    if (const int edges = option(argc, argv, "--precision", 0); edges > 0) {
        const double cell = 3.5 / 52;
        const Columns<float> sdf = signed_distances(backend, mesh, config, grid.vertices);
        const CutEdges cut = cut_edges(mesh.geometry, grid, sdf, edges, config.frequencies);
        std::printf("%-12s %12s %12s %12s %12s %7s\n", "products", "sdf, most", "place, rms",
                    "place, most", "1 / slope", "flips");
        print_precision("floats", cut, signed_distances(backend, mesh, config, cut.points), cell);
        print_planes<3>("3 planes", mesh.geometry, cut, config.frequencies, cell);
        print_planes<2>("2 planes", mesh.geometry, cut, config.frequencies, cell);
        print_planes<1>("1 plane", mesh.geometry, cut, config.frequencies, cell);
        return 0;
    }
    const LandmarkRoles who = roles();
    const MeshLossConfig weights;
    const auto probe = [&](const char* name) { parts.end(name); };
    const MeshStage<float, decltype(probe)> stage{{{config, who, false}, weights}, grid, probe};
    const MeshSample<float> shown = sample(config.expression, neutral);
    Adam<Mesh> adam(mesh);
    Mesh grad = zeros_like(mesh);
    MeshTrace<float> trace;
    MeshLosses<float> losses;
    for (int i = 0; i <= steps; ++i) {
        if (i == 1) parts.all.clear(); // the first has all the pages to touch
        parts.last = Clock::now();
        losses = mesh_losses(backend, mesh, stage, shown, trace);
        Mesh::fields([](const std::string&, auto& a) { a.setZero(); }, grad);
        mesh_losses_vjp(backend, mesh, stage, trace, grad);
        adam_step(backend, mesh, grad, adam, [](const std::string&) { return 1e-5; });
        parts.end("optimiser");
    }
    std::printf("lattice %td, touched %td, surface %td vertices, %zu faces, %d threads\n",
                grid.vertices.cols(), trace.neutral.sdf.cols(), losses.vertices,
                trace.neutral.surface.topology.faces.size(), threads);
    std::printf("%-18s %9s %9s %9s %9s %9s %9s\n", "part", "ms", "networks", "the rest", "Gmac",
                "MB in", "MB out");
    Part sum;
    const auto row = [&](const std::string& name, const Part& p) {
        const double n = steps;
        std::printf("%-18s %9.2f %9.2f %9.2f %9.2f %9.2f %9.2f\n", name.c_str(),
                    1e3 * p.seconds / n, 1e3 * p.networks.seconds / n,
                    1e3 * (p.seconds - p.networks.seconds) / n, 1e-9 * p.networks.products / n,
                    4e-6 * p.networks.in / n, 4e-6 * p.networks.out / n);
    };
    for (const auto& [name, p] : parts.all) {
        row(name, p);
        sum.seconds += p.seconds;
        sum.networks.seconds += p.networks.seconds;
        sum.networks.products += p.networks.products;
        sum.networks.in += p.networks.in;
        sum.networks.out += p.networks.out;
    }
    row("all", sum);
}
