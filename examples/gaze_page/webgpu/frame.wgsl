// SPDX-License-Identifier: Apache-2.0
// frame.wgsl: what all steps of a render share: the camera, the numbers of the accuracy policy
// (rye/splat/accuracy.hpp) and the sizes. Screen positions are offsets from the principal point
// [px]; the camera's frame has x right, y down, z forward. splats.js fills Frame, and puts the
// constants `channels` and `block` before this text.

struct Frame {
    row_x: vec4f,              // rows of camera_from_world, the translation last
    row_y: vec4f,
    row_z: vec4f,
    focal: vec2f,              // [px]
    principal: vec2f,          // [px]
    slope_low: vec2f,          // limits of x / z and y / z inside the Jacobian
    slope_high: vec2f,
    near_depth: f32,           // [world units]
    dilation: f32,             // added to both variances [px^2]
    cut: f32,                  // log2 of alpha_min
    alpha_max: f32,
    stop: f32,                 // transmittance at which a pixel is full
    gaussians: u32,
    width: u32,                // [px]
    height: u32,
    columns: u32,              // tiles of a row
    tiles: u32,
    most: u32,                 // mentions that there is room for
    unused: u32,
}

// A Gaussian as a pixel sees it (rye/splat/falloff.hpp): 2^(log2_opacity - u^2 - v^2) at an offset
// (dx, dy), u = ux dx, v = vx dx + vy dy.
struct Splat {
    x: f32,
    y: f32,
    ux: f32,
    vx: f32,
    vy: f32,
    log2_opacity: f32,
}

// A Gaussian that a tile's list holds: the bits of its depth, which is positive, and its index.
struct Entry {
    depth: u32,
    gaussian: u32,
}

// The same before lists are made.
struct Mention {
    tile: u32,
    depth: u32,
    gaussian: u32,
}

const tile_edge = 16u;         // [px]
