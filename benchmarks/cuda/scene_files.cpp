// SPDX-License-Identifier: Apache-2.0
// scene_files FOLDER SCENE...: writes the scenes of bench_cuda_raster as .npy files, for programs in
// other languages: FOLDER/SCENE/{means,quats,scales,opacities,colors,viewmats,Ks,size}.npy, in the
// layouts of peers/peers.py. Colours of scenes with harmonics are coefficients, [N, 16, 3].
#include <cstdio>
#include <cstring>
#include <filesystem>

#include <rye/io/npy.hpp>

#include "scenes.hpp"

namespace {

using namespace rye;

void write(const std::filesystem::path& path, const std::vector<Index>& shape,
           const float* numbers) {
    NpyArray a;
    a.item_size = 4;
    a.shape = shape;
    a.bytes.resize(static_cast<std::size_t>(a.size()) * 4);
    std::memcpy(a.bytes.data(), numbers, a.bytes.size());
    write_npy(path, a);
}

void write(const std::filesystem::path& folder, const bench::DeviceScenery& s) {
    std::filesystem::create_directories(folder);
    const Gaussians<float>& g = s.gaussians;
    const Index n = g.count();
    write(folder / "means.npy", {n, 3}, g.mean.data());
    write(folder / "quats.npy", {n, 4}, g.rotation.data());
    write(folder / "scales.npy", {n, 3}, g.scale.data());
    write(folder / "opacities.npy", {n}, g.opacity.data());
    if (s.sh_rest.size() > 0) {
        Columns<float> triples(48, n); // of each basis red, green and blue
        for (Index i = 0; i < n; ++i)
            for (Index c = 0; c < 3; ++c) {
                triples(c, i) = s.sh_constant(c, i);
                for (Index k = 0; k < 15; ++k)
                    triples(3 * (k + 1) + c, i) = s.sh_rest(15 * c + k, i);
            }
        write(folder / "colors.npy", {n, 16, 3}, triples.data());
    } else {
        write(folder / "colors.npy", {n, g.channels()}, g.feature.data());
    }
    std::vector<float> views, ks;
    for (const Pinhole<float>& c : s.cameras) {
        for (Index row = 0; row < 3; ++row) {
            for (Index col = 0; col < 3; ++col)
                views.push_back(c.camera_from_world.rotation(row, col));
            views.push_back(c.camera_from_world.translation[row]);
        }
        for (const float x : {0.0F, 0.0F, 0.0F, 1.0F}) views.push_back(x);
        for (const float x : {c.fx, 0.0F, c.cx, 0.0F, c.fy, c.cy, 0.0F, 0.0F, 1.0F})
            ks.push_back(x);
    }
    const auto cameras = static_cast<Index>(s.cameras.size());
    write(folder / "viewmats.npy", {cameras, 4, 4}, views.data());
    write(folder / "Ks.npy", {cameras, 3, 3}, ks.data());
    const float size[] = {float(s.cameras.front().width), float(s.cameras.front().height)};
    write(folder / "size.npy", {2}, size);
    std::printf("%s: %lld Gaussians\n", s.name.c_str(), static_cast<long long>(n));
}

bench::DeviceScenery scene_of(const std::string& name) {
    if (name == "head10k_c3") return bench::head(10000, 3);
    if (name == "head100k_c3") return bench::head(100000, 3);
    if (name == "head100k_c32") return bench::head(100000, 32);
    if (name == "head300k_c3") return bench::head(300000, 3);
    if (name == "head300k_c32") return bench::head(300000, 32);
    if (name == "scene1m") return bench::frustum(1000000);
    throw Error("scene_files: got the scene '" + name +
                "', expected head10k_c3, head100k_c3, head100k_c32, head300k_c3, head300k_c32 or "
                "scene1m");
}

} // namespace

int main(int argc, char** argv) {
    try {
        if (argc < 3) throw Error("scene_files: expected a folder and scenes");
        for (int i = 2; i < argc; ++i)
            write(std::filesystem::path(argv[1]) / argv[i], scene_of(argv[i]));
    } catch (const std::exception& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
    return 0;
}
