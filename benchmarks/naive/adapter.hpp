// SPDX-License-Identifier: Apache-2.0
/// benchmarks/naive/adapter.hpp: conversion of rye's Gaussians and camera to the yardstick's types.
#pragma once

#include <rye/gaussian/gaussians.hpp>
#include <rye/geometry/camera.hpp>

#include "rasterizer.hpp"

namespace rye::bench {

inline naive::Cloud naive_cloud(const Gaussians<float>& g) {
    const auto copy = [](const Columns<float>& a) {
        return std::vector<float>(a.data(), a.data() + a.size());
    };
    return {copy(g.mean), copy(g.scale), copy(g.rotation), copy(g.opacity), copy(g.feature)};
}

inline naive::Camera naive_camera(const Pinhole<float>& c) {
    naive::Camera out{c.fx, c.fy, c.cx, c.cy, c.near_depth, c.width, c.height, {}, {}};
    for (int i = 0; i < 3; ++i) {
        out.t[i] = c.camera_from_world.translation[i];
        for (int j = 0; j < 3; ++j) out.r[i][j] = c.camera_from_world.rotation(i, j);
    }
    return out;
}

} // namespace rye::bench
