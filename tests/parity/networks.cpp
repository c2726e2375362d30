// SPDX-License-Identifier: Apache-2.0
// networks RESULT: rye's half of networks_torch.py. Runs the encoding, a perceptron, the upsampler
// and Adam in float64 on random numbers, and writes every input, output and gradient.
#include <cstdio>
#include <deque>
#include <exception>

#include <rye/backend/scalar.hpp>
#include <rye/io/safetensors.hpp>
#include <rye/nn/adam.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/nn/mlp.hpp>
#include <rye/nn/upsampler.hpp>

namespace {

using namespace rye;
using Cpu = ScalarBackend<>;

/// Keeps the arrays until they are written.
struct Record {
    std::deque<Columns<double>> arrays;
    std::vector<TensorEntry> entries;

    const Columns<double>& add(const std::string& name, const Columns<double>& a) {
        arrays.push_back(a);
        entries.push_back(tensor_entry(name, arrays.back()));
        return arrays.back();
    }
    const Columns<double>& random(const std::string& name, Index rows, Index cols) {
        const Random r{42, 2 * arrays.size()};
        Columns<double> a(rows, cols);
        for (Index i = 0; i < a.size(); ++i) a(i) = r.normal(static_cast<std::uint64_t>(i));
        return add(name, a);
    }
    template <class P>
    void add_fields(const std::string& prefix, const P& p) {
        detail::nested_fields<P>(
            prefix, [&](const std::string& n, const Columns<double>& a) { add(n, a); }, p);
    }
};

void record_mlp(Record& r) {
    const MlpShape shape{{34, 20, 24, 16, 5}, 7};
    Mlp<double> m = Mlp<double>::init(shape, Random{1, 0}), g(shape);
    r.add_fields("mlp", m);
    const Columns<double>& x = r.random("x", 3, 50);
    const Columns<double> code = positional_encoding(x);
    const VecX<double> frame = r.random("frame", 7, 1);
    MlpTrace<double> trace;
    r.add("y", mlp_forward(Cpu{}, m, code, frame, &trace));
    const Columns<double>& w = r.random("g_y", 5, 50);
    Columns<double> g_code;
    VecX<double> g_frame;
    mlp_vjp(Cpu{}, m, {code, frame, trace}, w, {g, &g_code, &g_frame});
    r.add("g_x", positional_encoding_vjp(code, g_code));
    r.add("g_frame", g_frame);
    r.add_fields("g_mlp", g);
    Adam<Mlp<double>> adam(m);
    for (int step = 0; step < 3; ++step)
        adam_step(Cpu{}, m, g, adam, [](const std::string&) { return 1e-3; });
    r.add_fields("adam_mlp", m);
}

void record_upsampler(Record& r, Normalization norm, bool skip, const std::string& name) {
    const UpsamplerShape shape{5, 4, 2, norm, skip};
    Upsampler<double> u = Upsampler<double>::init(shape, Random{2, 0}), g(shape);
    u.out_weight = r.random(name + ".out", 3, 4);
    r.add_fields(name, u);
    Image<double> in(7, 6, 5);
    in.pixels = r.random(name + ".in", 5, in.size());
    UpsamplerTrace<double> trace;
    r.add(name + ".y", upsampler_forward(Cpu{}, u, in, &trace).pixels);
    Columns<double> g_in;
    upsampler_vjp(Cpu{}, u, in, trace, r.random(name + ".g_y", 3, 16 * in.size()), g, &g_in);
    r.add(name + ".g_in", g_in);
    r.add_fields(name + ".g", g);
}

} // namespace

int main(int argc, char** argv) {
    if (argc != 2) return std::fputs("usage: networks RESULT\n", stderr), 2;
    try {
        Record r;
        record_mlp(r);
        record_upsampler(r, Normalization::instance, false, "published");
        record_upsampler(r, Normalization::none, true, "skip");
        write_safetensors(argv[1], r.entries);
    } catch (const std::exception& e) {
        return std::fprintf(stderr, "%s\n", e.what()), 1;
    }
    return 0;
}
